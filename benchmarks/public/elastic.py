"""A cantilever that bends far under its own weight, and CB-Geo's small cases with exact answers."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxmpm as mpm
from benchmarks.accuracy import earthquakes
from benchmarks.public.rows import Row, row
from jaxmpm.laws import Law, element_test

Made = Callable[[], list[Row]]


def cases(data: Path, quick: bool) -> dict[str, Made]:
    """The cases by name."""
    cells = CELLS[:1] if quick else CELLS
    made: dict[str, Made] = {f"cantilever {c}": partial(cantilever, data, c, c == cells[-1]) for c in cells}
    return made | {"cbgeo": partial(cbgeo, data, 0.25 if quick else 0.125)}


CELLS = (0.25, 0.125)
"""Of the cantilever (m), 4 and 8 over its height."""


@mpm.pytree
@dataclass(frozen=True)
class NeoHookean(Law):
    """Compressible neo-Hookean elasticity: J stress = G (b - 1) + (K - 2 G / 3) ln J.

    b follows from the stress, which a step has rotated, and the volume ratio J, the law's history.
    Source: Bonet and Wood (2008), 10.1017/CBO9780511755446, Section 6.4.3.
    """

    bulk: Array
    shear: Array

    def initial_history(self, particles: mpm.Particles) -> Array:
        """Volume ratio (N,) of undeformed soil."""
        return jnp.ones_like(particles.volume)

    def update(self, strain_increment: Any, stress: Any, history: Array, dt: Array | None = None) -> tuple[Any, Array]:
        """Stress and volume ratio after a strain increment."""
        lame, unit = self.bulk - 2 * self.shear / 3, jnp.eye(3)[..., None]
        before, f = _matrix(stress, history), unit + _matrix(strain_increment, history)
        b = unit + (history * before - lame * jnp.log(history) * unit) / self.shear
        b = jnp.einsum("ijn,jkn,lkn->iln", f, b, f)
        ratio = history * jnp.linalg.det(jnp.moveaxis(f, -1, 0))
        after = (self.shear * (b - unit) + lame * jnp.log(ratio) * unit) / ratio
        at = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
        return tuple(c if isinstance(c, float) else after[ij] for c, ij in zip(stress, at, strict=True)), ratio


def _matrix(tensor: Any, like: Array) -> Array:
    """(3, 3, N) of a tensor's six components."""
    xx, yy, zz, xy, yz, xz = (jnp.broadcast_to(jnp.asarray(c, like.dtype), like.shape) for c in tensor)
    return jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def cantilever(data: Path, cell: float, finest: bool) -> list[Row]:
    """Lowest point and return of the lower right corner of a beam that lets its weight act at once.

    The fibre that is stretched most doubles its length. USL and four particles along each axis of a cell keep it whole;
    with MUSL, or with two particles, it tears. The corner's motion is extrapolated from the four particles next to it.
    """
    start = time.perf_counter()
    setup = json.loads((data / "cantilever" / "setup.json").read_text())
    length, height = setup["geometry"]["length_m"], setup["geometry"]["height_m"]
    soil, gravity, t_end = setup["soil"], 9.8, setup["time_s"]
    with jax.enable_x64(True):
        scene, state = mpm.block(
            (length, height),
            mpm.Soil(unit_weight=9.81 * soil["density_kg_m3"], young=soil["young_modulus_Pa"], poisson=soil["poisson"]),
            mpm.Discretisation(cell, (cell / 4,) * 2, scheme=mpm.Scheme.USL, cell_average=False),
            domain=(length + 1, height + 5),
            corner=(0.0, 4.0),
            gravity=(0.0, -gravity),
            speed=10.0,
        )
        clamp = mpm.Wall(0, "low", round(-scene.grid.origin[0] / cell), "fixed")
        law = NeoHookean(scene.material.bulk, scene.material.shear)
        scene = replace(scene, boundary=replace(scene.boundary, walls=(clamp,)), material=law)
        state = mpm.unstressed(scene)
        times = np.arange(0.02, t_end, 0.02)
        ended = mpm.solve(scene, state, t_end=t_end, snapshots=times.tolist()).raise_if_failed()
    x, z = np.asarray(scene.particles.position)
    right, low = np.unique(x)[:-3:-1], np.unique(z)[:2]
    corner = [int(np.flatnonzero((x == a) & (z == b))[0]) for a in right for b in low]
    weights = np.outer((1.5, -0.5), (1.5, -0.5)).ravel()
    ours = np.array([0.0, *(weights @ np.asarray(one.displacement[1])[corner] for one in ended.snapshots)])
    at = np.array([0.0, *(float(one.step) for one in ended.snapshots)]) * float(scene.numerics.time_step)
    t, u = np.loadtxt(data / "cantilever" / "FEM_cantilever_beam.csv", delimiter=",", skiprows=1).T
    apart = float(np.sqrt(np.mean((np.interp(t, at, ours) - u)[t <= at[-1]] ** 2)))
    lowest = int(ours.argmin())
    back = lowest + int(ours[lowest:].argmax())
    theirs = int(u.argmin())
    theirs_back = theirs + int(u[theirs:].argmax())

    def one(quantity: str, ours: float, theirs: float, **more: Any) -> Row:
        return row("cantilever, FEM", quantity, ours, theirs, start, cell=cell, finest=finest, **more)

    return [
        one("lowest tip (m)", ours[lowest], u[theirs], figure="cantilever_tip_error"),
        one("its time (s)", at[lowest], t[theirs]),
        one("highest return (m)", ours[back], u[theirs_back], difference=ours[back] - u[theirs_back]),
        one("rms of the curve (m)", apart, 0.0, difference=apart),
    ]


def cbgeo(data: Path, cell: float) -> list[Row]:
    """CB-Geo's block on an incline, bar, column and uniaxial element, against the exact answers.

    Args:
        data: folder.
        cell: of the block's grid (m); the block is 1 m high.
    """
    cases = json.loads((data / "cbgeo" / "cases.json").read_text())
    with jax.enable_x64(True):
        return [*block(cases, cell), *bar(cases), *column(cases), *uniaxial(cases)]


def _exact(what: str, ours: float, theirs: float, start: float, cell: float | None = None) -> Row:
    return row(f"CB-Geo, {what}", "exact", ours, theirs, start, cell=cell, figure="exact_error_max", finest=True)


def block(cases: dict[str, Any], cell: float) -> list[Row]:
    """The travel of a stiff block down an incline."""
    start, case = time.perf_counter(), cases["sliding_block_2d"]
    t_end = case["asserted_after_step_99000"]["time_s"]
    scene, state = earthquakes.block(
        cell, 1e8, tilt=math.radians(case["incline_deg"]), friction=case["friction"], scheme=mpm.Scheme.MUSL
    )
    ended = mpm.solve(scene, state, t_end=t_end).raise_if_failed()
    seconds = float(ended.state.step) * float(scene.numerics.time_step)
    exact = case["exact"]["a_m_s2"] * seconds**2 / 2
    return [_exact("travel of a block (m)", float(ended.state.displacement[0].mean()), exact, start, cell)]


def bar(cases: dict[str, Any]) -> list[Row]:
    """The stress of a bar whose end force grows over half a second, at the times that CB-Geo asserts.

    The end force acts on the last particle, and the stress is the mean over the cells that it does not act on. As in
    the source velocities are those of the grid (PIC), which damps the bar's vibration: the stress is the static one at
    the last two times, and carries inertia of 1 % at the first two, where CB-Geo's particles stand beside it.
    """
    start, case = time.perf_counter(), cases["uniaxial_traction_2d_nodal_forces"]
    length, cell = case["bar_m"][0], case["bar_m"][0] / case["cells"]
    spacing, density = cell / 4, case["density_kg_m3"]

    def pull(position: Array, t: Array) -> Array:
        last = position[0] > length - spacing
        return jnp.where(last, jnp.minimum(t / 0.5, 1) / (spacing * density), 0)[None]

    soil = mpm.Soil(unit_weight=9.81 * density, young=case["young_modulus_Pa"], poisson=0.0)
    scene, state = mpm.bar(length, soil, mpm.Discretisation(cell, (spacing,), cfl=0.316, flip=0.0), velocity=0.0)
    scene = replace(scene, loads=replace(scene.loads, body_force=pull))
    inside = np.asarray(scene.particles.position[0]) < length - cell
    steps = [int(name.split()[1]) for name in case["asserted_sigma_xx_Pa"]]
    times = [case["step_s"] * n for n in steps]
    ended = mpm.solve(scene, state, t_end=1.0, snapshots=times).raise_if_failed()
    rows = []
    for (name, asserted), t, one in zip(case["asserted_sigma_xx_Pa"].items(), times, ended.snapshots, strict=True):
        stress = float(np.asarray(one.stress[0])[inside].mean())
        what = f"stress of a bar at {t:g} s (Pa)"
        if t > 0.7:
            rows.append(_exact(what, stress, 1.0, start, cell))
        else:
            rows.append(
                row(
                    f"CB-Geo, {what}", f"middle of their particles, {name}", stress, sum(asserted) / 2, start, cell=cell
                )
            )
    return rows


def column(cases: dict[str, Any]) -> list[Row]:
    """The stress of a column after a tenth of a second at rest: its lowest and highest particle."""
    start, case = time.perf_counter(), cases["hydrostatic_column_2d"]
    height, cell = case["box_m"]["height_particles"], 0.004
    soil = mpm.Soil(unit_weight=9.81 * case["density_kg_m3"], young=case["young_modulus_Pa"], poisson=case["poisson"])
    scene, state = mpm.column(height, soil, mpm.Discretisation(cell, (cell / 2,) * 2), gravity=case["g_m_s2"])
    ended = mpm.solve(scene, state, t_end=case["step_s"] * case["steps"]).raise_if_failed()
    z, stress = np.asarray(scene.particles.position[1]), np.asarray(ended.state.stress[2])
    lowest, highest = stress[z == z.min()].mean(), stress[z == z.max()].mean()
    exact = case["exact"]
    return [
        _exact("column, lowest particle (Pa)", lowest, exact["sigma_yy_bottom_particle_Pa"], start, cell),
        _exact("column, highest particle (Pa)", highest, exact["sigma_yy_top_particle_Pa"], start, cell),
    ]


def uniaxial(cases: dict[str, Any]) -> list[Row]:
    """The stress of one element that is compressed along one axis, the others free."""
    start, case = time.perf_counter(), cases["uniaxial_stress_2d_3d"]
    soil = mpm.Soil(young=case["young_modulus_Pa"], poisson=case["poisson"], unusual=True)
    strain = -case["top_speed_m_s"] * case["step_s"] * case["steps"] / case["box_m"]
    law = soil.material(np.dtype(float), 1.0)
    tested = element_test(law, "triaxial drained", pressure=0.0, strain=strain, steps=case["steps"])
    answer = -float(tested.vertical_stress[-1])
    return [_exact("uniaxial stress (Pa)", answer, case["asserted"]["sigma_yy_Pa"], start)]
