"""Stability cases of undrained soil that slides along ground above which it lies by a share of a cell.

A slab of clay with tied ends, its weight in its stress, is thrown along the ground. Its drag is that of the clay, or of
the contact, on all of its area, at every gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.stability.stability_case import Row, judged, status_of
from jaxmpm.ground import rigid_base

COHESION, SPEED, WEIGHT = 20e3, 3.0, 20e3
FIRST, LAST = 0.05, 0.25
"""Times (s) between which the drag is measured: a wave of shear has gone through the slab before."""

RINGING = 0.2, 1.0
"""The same on a bed of clay, whose upper soil and the slab's lower soil swing against each other for 0.3 s at their
common nodes: the drag of 0.2 s is 1.4 or 0.7 of its mean over periods."""

ERROR = 0.05
"""Largest error of the drag, and of the distance to a stop, as a share."""

SHARED = "known limit: without `bridging` clay in a cell with a gap acts by the share of the cell that it fills"

STICKS = "known limit: half a cell sticks to the nodes of a fixed base at once; an interface has no such layer"

GAPS = (0.0, 0.25, 0.5, 0.75)


def slab(
    ground: str,
    gap: float,
    *,
    cells: int = 8,
    dimension: int = 2,
    offset: float = 0.0,
    bed: float = 1.0,
    bridging: bool = False,
    **soil: Any,
) -> tuple[mpm.Scene, mpm.State]:
    """A slab of clay that moves along the ground at `SPEED`.

    Args:
        ground: "fixed", "interface", "bedrock" (a contact), "stuck bedrock", or "clay" (a bed of four times its
            strength).
        gap: between them, in cells of 1 m.
        cells: thickness of the slab.
        dimension: 2 or 3.
        offset: of the bedrock above the nodes below it, in cells.
        bed: thickness of the bed of clay, in cells.
        bridging: whether shear stress crosses gaps between soils.
        **soil: of the slab, beside its strength.

    Returns:
        Scene and state.
    """
    contact = ground in ("interface", "bedrock")
    clay = mpm.Soil(unit_weight=WEIGHT, young=2e7, poisson=0.49, strength=COHESION, **({"tension_cutoff": 0.0} | soil))
    bed = bed if ground == "clay" else 0.0
    numerics = mpm.Discretisation(1.0, (0.5,) * dimension, cell_average=True, bridging=bridging)
    interface = mpm.Interface(0.0, COHESION) if contact else None
    top = cells + bed
    if dimension == 2:
        shape = mpm.Section([(0, top), (2, top)], interface=interface)
        scene, state = mpm.section(shape, clay, numerics, ends="tied", speed=2 * SPEED)
    else:
        flat = mpm.Raster(np.full((3, 3), top), (0, 0), 1.0)
        scene, state = mpm.terrain(mpm.Terrain(flat, 0.0, interface=interface), clay, numerics, speed=2 * SPEED)
        upright = scene.grid.dimension - 1
        low, high = (wall.index for wall in scene.boundary.walls if wall.axis == 0)
        across = [replace(wall, hold="roller") for wall in scene.boundary.walls if wall.axis == 1]
        floor = [wall for wall in scene.boundary.walls if wall.axis == upright]
        scene = replace(scene, boundary=replace(scene.boundary, walls=(*across, *floor), tied=(low, high)))
    particles = scene.particles
    moves = particles.position[-1] > bed
    if bed:
        strength = jnp.where(moves, COHESION, 4 * COHESION)
        scene, state = mpm.with_soil(scene, state, strength=strength)
    up = jnp.where(moves, gap + offset, 0.0)
    scene = replace(scene, particles=replace(particles, position=particles.position.at[-1].add(up)))
    if ground.endswith("bedrock"):
        base = jax.tree.map(jnp.asarray, rigid_base(scene.grid, lambda *x: np.full(np.shape(x[0]), offset)))
        walls = tuple(wall for wall in scene.boundary.walls if wall.axis != scene.grid.dimension - 1)
        scene = replace(scene, boundary=replace(scene.boundary, walls=walls, base=base))
        if not contact:
            scene = replace(scene, boundary=replace(scene.boundary, base=None, cut=jnp.any(base.normal != 0, axis=1)))
    return scene, replace(state, velocity=state.velocity.at[0].set(jnp.where(moves, SPEED, 0.0)))


def drag_row(ground: str, gap: float, **choices: Any) -> Row:
    """Drag of a slab over cohesion times area."""
    scene, state = slab(ground, gap, **choices)
    mass, dt = jnp.where(state.velocity[0] > 0, scene.particles.mass, 0), float(scene.numerics.time_step)

    def momentum(at: mpm.State) -> float:
        return float(jnp.sum(mass * at.velocity[0]))

    first, last = RINGING if ground == "clay" else (FIRST, LAST)
    start = mpm.advance(scene, state, jnp.asarray(int(first / dt)))
    steps = int((last - first) / dt)
    end = mpm.advance(scene, start, jnp.asarray(steps))
    drag = (momentum(start) - momentum(end)) / (steps * dt * COHESION * 2.0 ** (choices.get("dimension", 2) - 1))
    where = "".join(f", {name} {value:g}" for name, value in choices.items() if name in ("dimension", "offset", "bed"))
    where += ", bridging" * bool(choices.get("bridging"))
    case = f"slab of clay on {ground}, gap {gap:g} of a cell{where}: drag against cohesion times area"
    row = judged(case, abs(drag - 1), ERROR, "relative", status=status_of(end), drag=round(drag, 3))
    return row if row["passed"] or ground != "clay" or choices.get("bridging") else row | {"why": SHARED}


def stop_row(ground: str, cells: int) -> Row:
    """Distance in which a flush slab stops, over v^2 rho t / 2 c."""
    scene, state = slab(ground, 0.0, cells=cells)
    exact = SPEED**2 * WEIGHT / 9.80665 * cells / (2 * COHESION)
    final = mpm.solve(scene, state, t_end=3 * SPEED * WEIGHT / 9.80665 * cells / COHESION).state
    share = float(jnp.mean(final.displacement[0])) / exact
    case = f"flush slab of {cells} cells on {ground}: distance to its stop against v^2 rho t / 2c"
    row = judged(case, abs(share - 1), ERROR, "relative", status=status_of(final), share=round(share, 3))
    return row if row["passed"] or ground != "fixed" else row | {"why": STICKS}


def gap_rows(quick: bool) -> Iterator[Row]:
    """Every ground at every gap; bedrock between and on nodes; and flush slabs to their stop."""
    with jax.enable_x64(True):
        for gap in (0.5,) if quick else GAPS:
            yield drag_row("fixed", gap)
            yield drag_row("interface", gap)
        for gap in () if quick else GAPS:
            yield drag_row("clay", gap)
            yield drag_row("clay", gap, bridging=True)
            for ground in ("bedrock", "stuck bedrock"):
                yield drag_row(ground, gap, offset=-0.4)
        if not quick:
            yield drag_row("clay", 0.25, bed=0.5, bridging=True)
        for ground in ("bedrock",) if quick else ("bedrock", "stuck bedrock"):
            yield drag_row(ground, 0.25, offset=0.4)
        for gap in () if quick else (0.0, 0.5):
            yield drag_row("fixed", gap, dimension=3, cells=4)
            yield drag_row("interface", gap, dimension=3, cells=4)
        for cells in () if quick else (1, 2, 4):
            yield stop_row("fixed", cells)
            yield stop_row("interface", cells)
