"""The published method's own solver, MPM3D-F90, on the same slope: positions of all particles after a slide.

`python -m benchmarks peer_mpm3d --binary PATH` writes its input, runs it, and runs the same slope here by the same
return mapping: linear and GIMP shape functions, the three schemes, undrained soil and soil with friction. The first is
the published section at half of its strength on cells of 2 m, the second the slope of MPM3D-F90's own example
(`averaged_friction`) on 2.5 m with a quarter of its cohesion, on which it slides. Gravity comes at once; there is no
average of strains and no artificial viscosity. MPM3D-F90 (github.com/xzhang66/MPM3D-F90, commit 4a6275f) has to be
built by its user with two changes. gfortran refuses `if(p_type(i))then` in src/Grid.f90, which means
`if(p_type(i)/=0)then`. The format `3e12.4` of positions in src/DataOut.f90 rounds them to centimetres: make it
`3es24.16`.

    sed -i 's/if(p_type(i))then/if(p_type(i)\\/=0)then/' src/Grid.f90
    sed -i 's/"(3e12.4)"/"(3es24.16)"/' src/DataOut.f90
    make -C make/gnu  # makes make/gnu/mpm3d-f90

Differences are between positions (m) after 1, 2, 4 and 8 s, the largest and the median over particles, where this
solver leaves nodes out that have as little mass as those that MPM3D-F90 leaves out, 1e-5 of a full cell. With its own
floor, 1e-12 of a particle, it moves nodes at the edge of particles that MPM3D-F90 takes as empty: `own_floor_m` is the
largest difference then, and `front_m` the foremost soil beyond the toe. `nudged_m` is by how much this solver differs
from itself, started 1e-13 m to the side: no two programs agree better. With linear functions and USL soil leaves both
solvers, clay between 1 and 2 s, by speeds that let no time pass, and soil with friction before: of such a case the
times before are compared, and `reached_s` is the last of them, 0 for none. Finished rows stay in out/peer_mpm3d.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxmpm as mpm
from benchmarks.measure import ROOT, Refused, Report, code_digest, sources, stored_row
from benchmarks.settings import averaged_friction
from jaxmpm.laws import Law, add, elastic_increment
from jaxmpm.protocols import Kernel, Tensor
from jaxmpm.support.pytrees import pytree
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant


def single(value: float) -> float:
    """A number as MPM3D-F90 reads it, in single precision."""
    return float(np.float32(value))


DENSITY, YOUNG, POISSON, GRAVITY = 2000.0, 1e8, single(0.3), single(9.81)
STRENGTHS = {
    "J2": (0.0, 21e3, 0.0),
    "c-phi": (single(0.3545), single(9.74e3), single(27.48e3)),
    "c-phi, sliding": (single(0.3545), single(9.74e3 / 4), single(27.48e3 / 4)),
}
"""Slope of the cone, its intercept (Pa) and largest mean stress (Pa): half of the published mean strength, the soil of
the solver's own example, and that with a quarter of its cohesion."""
SLOPES = {"J2": (mpm.Slope(), 2.0), "c-phi, sliding": (averaged_friction.SHAPE, 2.5)}
"""The slope of a soil, and its cells (m)."""
KERNELS: dict[str, type[Kernel]] = {"linear": mpm.Linear, "GIMP": mpm.GIMP}


@pytree
@dataclass(frozen=True)
class PublishedCone(Law):
    """Drucker-Prager without dilation as MPM3D-F90 returns to it (M3DM9 of src/Constitution.f90).

    Above the largest mean stress, which is 0 for soil without friction, shear beyond the line through the corner goes
    back to the cone at the mean stress that it has; only the rest is cut off. The law counts as one with friction, so
    that this solver does not close the gaps of clay above rigid ground, which MPM3D-F90 does not know.

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        slope: of sqrt(J2) over the pressure.
        intercept: sqrt(J2) without pressure (Pa).
        cutoff: largest mean stress (Pa).
    """

    bulk: Array
    shear: Array
    slope: Array
    intercept: Array
    cutoff: Array

    FRICTIONAL: ClassVar[bool] = True

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: None, dt: Array | None = None
    ) -> tuple[Tensor, None]:
        """Elastic predictor, then return at constant mean stress, or to the largest."""
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        p, q = mean(trial), safe_sqrt(second_invariant(deviator(trial)))
        largest = jnp.where(self.slope > 0, jnp.minimum(self.cutoff, self.intercept / self.slope), 0.0)
        beyond = p - largest
        corner = self.intercept - self.slope * largest + (jnp.sqrt(1 + self.slope**2) - self.slope) * beyond
        shears = jnp.where(beyond < 0, q > self.intercept - self.slope * p, q > corner)
        ratio = jnp.where(shears, (self.intercept - self.slope * p) / jnp.where(shears, q, 1.0), 1.0)
        kept = jnp.where(shears, p, jnp.minimum(p, largest))
        xx, yy, zz, xy, yz, xz = (ratio * s for s in deviator(trial))
        return (xx + kept, yy + kept, zz + kept, xy, yz, xz), None


@dataclass(frozen=True)
class Case:
    """A slope and how it moves.

    Args:
        kernel: of KERNELS.
        scheme: when the stress is updated.
        soil: of STRENGTHS.
        shape: of the slope.
        cell: m.
        times: at which it is looked at (s), whole multiples of the first.
        step: time step over that in which an elastic wave crosses a cell; a number of single precision.
    """

    kernel: str
    scheme: mpm.Scheme
    soil: str
    shape: mpm.Slope = mpm.Slope()
    cell: float = 2.0
    times: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)
    step: float = 0.5

    @property
    def name(self) -> str:
        """Of the case."""
        return f"{self.kernel}, {self.scheme.name}, {self.soil}"


def start(case: Case) -> tuple[mpm.Scene, mpm.State]:
    """The slope without stress, of the published return mapping."""
    soil = mpm.Soil(strength=1e4, unit_weight=DENSITY * 9.81, young=YOUNG, poisson=POISSON, tension_cutoff=0.0)
    choices = mpm.Discretisation(
        case.cell, (case.cell / 2,) * 2, kernel=KERNELS[case.kernel], scheme=case.scheme, cell_average=False
    )
    scene, _ = mpm.slope(case.shape, soil, choices, gravity=GRAVITY, at_rest=False)
    numbers = (jnp.asarray(n, scene.particles.mass.dtype) for n in STRENGTHS[case.soil])
    scene = replace(scene, material=PublishedCone(scene.material.bulk, scene.material.shear, *numbers))
    return scene, mpm.unstressed(scene)


NUDGE = 1e-13
"""Shift (m) at the start by which a second run shows how rounding grows."""
LIGHTEST = 8e-5
"""Mass of a node of a section that MPM3D-F90 leaves out, over that of a particle: its slice has two nodes in place of
that one, and 1e-5 of a full cell is 4e-5 of a particle."""


def ours(case: Case, nudge: float = 0.0) -> np.ndarray:
    """Positions (times, 2, N) m, by the published solver's time steps.

    Its first step has half of the force, since its velocities belong to the middles of steps, and its later ones are
    the shorter the faster the fastest particle is.

    Args:
        case: to run.
        nudge: of all particles along x at the start (m).
    """
    with jax.enable_x64(True):
        scene, state = start(case)
        state = replace(state, displacement=state.displacement.at[0].add(nudge))
        wave = jnp.sqrt(scene.material.p_wave_modulus / DENSITY)

        def advanced(carry: tuple[mpm.State, Array]) -> tuple[mpm.State, Array]:
            state, time = carry
            gravity = scene.loads.gravity * jnp.where(time > 0, 1.0, 0.5)
            dt = case.step * case.cell / (wave + jnp.max(jnp.abs(state.velocity)))
            pulled = replace(scene, loads=replace(scene.loads, gravity=gravity))
            return mpm.step(pulled, state, dt), time + dt

        @jax.jit
        def moved(carry: tuple[mpm.State, Array], end: Array) -> tuple[mpm.State, Array]:
            return jax.lax.while_loop(lambda carried: carried[1] < end, advanced, carry)

        carry, seen = (state, jnp.zeros(())), []
        for end in case.times:
            carry = moved(carry, jnp.asarray(end))
            seen.append(np.asarray(scene.particles.position + carry[0].displacement))
        return np.array(seen)


def deck(case: Case) -> str:
    """MPM3D-F90's input: the slope as a slice, one cell wide between smooth walls, with two particles across it.

    With GIMP the solver holds the two outermost planes of nodes of a wall, so that a cell lies beyond it.
    """
    with jax.enable_x64(True):
        scene, _ = start(case)
        x, z = np.asarray(scene.particles.position)
    beyond = case.cell if case.kernel == "GIMP" else 0.0
    top = case.shape.foundation + case.shape.height + 2 * case.cell
    slope, intercept, cutoff = STRENGTHS[case.soil]
    mass = DENSITY * case.cell**3 / 8
    lines = [
        "mpm3d *** slope",
        "nbco 1",
        "nbbo 1",
        f"nbmp {2 * x.size}",
        "nmat 1",
        f"spx {-beyond:.9g} {case.shape.length + beyond:.9g}",
        f"spy {-beyond:.9g} {case.cell + beyond:.9g}",
        f"spz {-beyond:.9g} {top:.9g}",
        f"dcell {case.cell:.9g}",
        f"dtscale {case.step:.9g}",
        f"endtime {case.times[-1]:.9g}",
        f"outtime {case.times[0]:.9g}",
        f"rpttime {case.times[-1]:.9g}",
        *(["gimp"] if case.kernel == "GIMP" else []),
        f"{case.scheme.name.lower()} on",
        "jaum on",
        "bulk 0.0 0.0",
        "tecp",
        "outr epef",
        "fixed 2 2 2 2 1 0",
        "material",
        f"1 dpm {DENSITY:.9g} {YOUNG:.9g} {POISSON:.9g} {slope:.9g} {intercept:.9g} 0.0 {cutoff:.9g}",
        f"particle point 1 {2 * x.size}",
    ]
    places = itertools.product(zip(x, z, strict=True), (case.cell / 4, 3 * case.cell / 4))
    lines += [f"{n} 1 {mass:.9g} {a:.9g} {y:.9g} {b:.9g}" for n, ((a, b), y) in enumerate(places, 1)]
    return "\n".join([*lines, "load", f"grav 1 0.0 0.0 {-GRAVITY:.9g}", "endl", "endi", ""])


LONGEST = 30.0
"""Seconds that MPM3D-F90 has for a case, of which it takes some five."""


def theirs(case: Case, binary: Path) -> np.ndarray:
    """Positions (times, 2, N) m by MPM3D-F90, up to the last of the times that it reaches with all particles.

    Raises:
        Refused: If there is no such program, or it does not print these positions.
    """
    program = binary.resolve()
    if not program.is_file() or not os.access(program, os.X_OK):
        raise Refused(f"{binary} is no program: give the one that MPM3D-F90's makefile makes")
    run = partial(subprocess.run, capture_output=True, text=True, errors="replace", timeout=LONGEST)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "slope.mpm").write_text(deck(case))
        answer = Path(folder) / "slope_anim.dat"
        try:
            done = run([program, "slope.mpm"], cwd=folder)
        except subprocess.TimeoutExpired:
            earlier = case.times[:-1]
            return theirs(replace(case, times=earlier), binary) if earlier else np.empty((0, 2, 0))
        if done.returncode or not answer.is_file():
            raise Refused(f"{binary} ended with {done.returncode} on {case.name}: {done.stdout[-300:].strip()}")
        seen = pictures(answer.read_text(errors="replace"))
    looked_at = [seen[round(time / case.times[0])] for time in case.times]
    whole = list(itertools.takewhile(lambda picture: picture.shape == seen[0].shape, looked_at))
    return np.array(whole).reshape(len(whole), *seen[0].shape)


def pictures(text: str) -> list[np.ndarray]:
    """Positions (2, N) m of each picture in MPM3D-F90's file for Tecplot, of one of both particles across the slice.

    Raises:
        Refused: If the file has four digits a number, as the solver's own format gives.
    """
    seen = []
    for zone in text.split("ZONE")[1:]:
        table = [line.split() for line in zone.splitlines()[1:] if line.strip()]
        if len(table[0][0]) < 20:
            raise Refused(
                f"x = {table[0][0]} has too few digits to compare: build MPM3D-F90 with the format 3es24.16 in "
                "src/DataOut.f90, see `benchmarks/public/peer_mpm3d.py`"
            )
        seen.append(np.array([[float(row[0]), float(row[2])] for row in table[::2]]).T)
    return seen


def compared(case: Case, there: np.ndarray) -> dict[str, Any]:
    """Differences from positions of MPM3D-F90 (times, 2, N) m, and both fronts beyond the toe at the end (m)."""
    case = replace(case, times=case.times[: len(there)])
    displacement = ours(case)
    with patch("jaxmpm.equations._maps.MASS_FLOOR", LIGHTEST):
        here, nudged = ours(case), ours(case, NUDGE)
    apart = np.linalg.norm(here - there, axis=1)

    def front(at: np.ndarray) -> float:
        return float(at[0][at[1] > case.shape.foundation].max()) - case.shape.toe_x

    return {
        "case": case.name,
        "reached_s": case.times[-1],
        "largest_m": apart.max(axis=1).tolist(),
        "median_m": np.median(apart, axis=1).tolist(),
        "nudged_m": np.linalg.norm(nudged - here, axis=1).max(axis=1).tolist(),
        "own_floor_m": np.linalg.norm(displacement - there, axis=1).max(axis=1).tolist(),
        "front_m": front(displacement[-1]),
        "their_front_m": front(there[-1]),
    }


def beside(case: Case, binary: Path) -> dict[str, Any]:
    """The row of a case that both solvers run; its name alone where MPM3D-F90 reaches none of its times."""
    there = theirs(case, binary)
    return compared(case, there) if len(there) else {"case": case.name, "reached_s": 0.0}


def run(quick: bool, binary: Path | None = None) -> Report:
    """All cases; `quick` one second of each."""
    if binary is None:
        raise Refused(f"MPM3D-F90 is not part of this project: give --binary PATH, and build it as {__file__} says")
    make = partial(Case, times=(1.0,)) if quick else Case
    choices = itertools.product(KERNELS, mpm.Scheme, SLOPES)
    cases = [make(kernel, scheme, soil, *SLOPES[soil]) for kernel, scheme, soil in choices]
    folder = ROOT / "out" / "peer_mpm3d" / code_digest(str(binary.resolve()), *sources(run, averaged_friction))
    ends = list(enumerate(cases[0].times))
    rows = [
        stored_row(folder, f"{case.name} {case.times[-1]:g} {case.step:g}", partial(beside, case, binary))
        for case in cases
    ]
    if not any(row["reached_s"] for row in rows):
        raise Refused(f"{binary} reaches {cases[0].times[0]:g} s of no case in {LONGEST:g} s: build it with -O2")
    largest = {
        f"position_difference_max_m_at_{t:g}_s": max(row["largest_m"][n] for row in rows if row["reached_s"] >= t)
        for n, t in ends
    }
    return Report({"position_difference_max_m": max(largest.values()), **largest}, rows)
