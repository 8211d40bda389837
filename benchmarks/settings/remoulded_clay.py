"""A dam of remoulded clay that is let go, here and by shallow-water theory.

The dam is 15 m long and 5 m high, on a base that its strength holds, under water as the slope of `sensitive_clay`.
Shallow-water theory takes one velocity over the depth and the strength as what the base resists. Its equations are
solved by finite volumes (Harten, Lax and van Leer 1983, 10.1137/1025002). What they leave without inertia is a
parabola.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.runout_slides import Slide
from jaxmpm import Settle, solve

LENGTH, HEIGHT, STRENGTH, DENSITY, GRAVITY = 15.0, 5.0, 1500.0, 2150.0, 5.247
END = 90.0
"""Length of the base (m)."""


def dam(cell: float, viscosity: float | None = None) -> Slide:
    """The dam once it rests.

    Args:
        cell: edge of the cells (m).
        viscosity: of Bingham (Pa s), None for none.
    """
    soil = mpm.Soil(
        strength=STRENGTH, unit_weight=DENSITY * 9.81, young=25e6, poisson=0.3, tension_cutoff=0.0, viscosity=viscosity
    )
    choices = mpm.Discretisation(cell, (cell / 2,) * 2, cell_average=True)
    scene, state = mpm.block(
        (LENGTH, HEIGHT), soil, choices, domain=(END, HEIGHT + 2 * cell), corner=(0.0, 0.0), gravity=(0.0, -GRAVITY),
        walls="roller", speed=float(np.sqrt(2 * GRAVITY * HEIGHT)),
    )  # fmt: skip
    walls = tuple(replace(w, hold="fixed") if (w.axis, w.side) == (1, "low") else w for w in scene.boundary.walls)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls))
    ended = solve(scene, state, t_end=40.0, rules=[Settle()]).raise_if_failed()
    return Slide(scene, ended.state, LENGTH, cell, HEIGHT / 10)


def shallow_water(cell: float, t_end: float, strength: float = STRENGTH) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the flow along the base.

    Args:
        cell: edge of the cells (m).
        t_end: time since the dam was let go (s).
        strength: which the base resists with (Pa).

    Returns:
        Centres (n,) of the cells and depths (n,), m.
    """
    x = (np.arange(round(END / cell)) + 0.5) * cell
    depth, flux, time = np.where(x < LENGTH, HEIGHT, 0.0), np.zeros(x.size), 0.0
    dry = 1e-6 * HEIGHT
    while time < t_end:
        velocity = np.where(depth > dry, flux / np.maximum(depth, dry), 0.0)
        h, v = np.pad(depth, 1, mode="edge"), np.pad(velocity, 1, mode="edge")
        v[[0, -1]] *= -1  # walls at both ends
        wave = np.sqrt(GRAVITY * h)
        dt = min(0.4 * cell / float((np.abs(v) + wave).max()), t_end - time)
        flow = np.stack([h * v, h * v**2 + GRAVITY * h**2 / 2])
        # The front of a wave onto a dry bed moves at the velocity plus twice the wave's.
        low = np.minimum(np.where(h[:-1] > dry, v[:-1] - wave[:-1], v[1:] - 2 * wave[1:]), v[1:] - wave[1:])
        high = np.maximum(np.where(h[1:] > dry, v[1:] + wave[1:], v[:-1] + 2 * wave[:-1]), v[:-1] + wave[:-1])
        low, high = np.minimum(low, 0), np.maximum(high, 0)
        jump = np.stack([np.diff(h), np.diff(h * v)])
        between = (high * flow[:, :-1] - low * flow[:, 1:] + low * high * jump) / np.maximum(high - low, dry)
        # No clay passes between cells that rest, which the scheme's own diffusion would let creep.
        push = DENSITY * GRAVITY * np.abs(np.diff(h**2)) / (2 * cell)
        between[0, (v[:-1] == 0) & (v[1:] == 0) & (push <= strength)] = 0.0
        depth, flux = np.stack([depth, flux]) - dt / cell * np.diff(between)
        resisted = strength / DENSITY * dt
        flux = np.where(depth > dry, np.sign(flux) * np.maximum(np.abs(flux) - resisted, 0), 0.0)
        time += dt
    return x, depth


def parabola() -> float:
    """Length (m) of the dam's clay once it has stopped without inertia: the base holds its pressure everywhere."""
    steepness = 2 * STRENGTH / (DENSITY * GRAVITY)
    return float((1.5 * LENGTH * HEIGHT) ** (2 / 3) / steepness ** (1 / 3))


def by_theory() -> list[dict[str, Any]]:
    """Fronts of the dam by theory, with inertia and without: where a tenth of its height is left, and the foremost."""
    x, depth = shallow_water(0.05, 20.0)
    stops, steepness = parabola(), 2 * STRENGTH / (DENSITY * GRAVITY)
    fronts = {
        "shallow water": [float(x[depth > least].max()) for least in (HEIGHT / 10, HEIGHT / 500)],
        "shallow water, no inertia": [stops - (HEIGHT / 10) ** 2 / steepness, stops],
    }
    return [row(by, None, *(front - LENGTH for front in pair)) for by, pair in fronts.items()]


def row(by: str, cell: float | None, runout: float, foremost: float) -> dict[str, Any]:
    """Fronts from the dam's face (m)."""
    return {"dam": by, "cell_m": cell, "runout_m": round(runout, 2), "runout_foremost_m": round(foremost, 2)}


def of_dam(cell: float, viscosity: float | None) -> dict[str, Any]:
    """The row of the dam on cells of this size (m)."""
    slide = dam(cell, viscosity)
    foremost = float((slide.scene.particles.position[0] + slide.state.displacement[0]).max()) + cell / 4 - LENGTH
    name = "remoulded clay" if viscosity is None else f"viscosity of {viscosity:g} Pa s"
    return row(name, cell, slide.row()["front_m"], foremost)
