"""Stability on stiff and extreme cases: every row has a measured figure and a bound, none merely "did not crash"."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxmpm as mpm
from benchmarks.measure import Report
from jaxmpm import diagnostics
from jaxmpm.types import Engine

Row = dict[str, Any]
KERNELS = (mpm.GIMP, mpm.Linear, mpm.QuadraticBSpline)
SLOPE = mpm.Slope(crest=10, height=6, run_per_rise=1.0, toe=14, foundation=2)
CLAY = mpm.Soil(young=1e7, strength=20e3, softening_modulus=40e3, tension_cutoff=None)


def row(case: str, figure: float, bound: float, unit: str, *, at_least: bool = False, **more: Any) -> Row:
    """A case passes if its figure is at most the bound (or at least, where that is asked)."""
    passed = (operator.ge if at_least else operator.le)(figure, bound)
    sense = ">=" if at_least else "<="
    return {
        "case": case,
        "figure": float(f"{figure:.4g}"),
        "sense": sense,
        "bound": bound,
        "unit": unit,
        "passed": bool(passed),
        **more,
    }


def total_energy(scene: mpm.Scene, state: mpm.State) -> Array:
    """Kinetic, elastic and potential energy (J)."""
    moving = diagnostics.kinetic_energy(scene, state) + diagnostics.elastic_energy(scene, state)
    return moving + diagnostics.potential_energy(scene, state)


@partial(jax.jit, static_argnames="steps")
def dissipating(scene: mpm.Scene, state: mpm.State, steps: int) -> tuple[mpm.State, Array]:
    """The state after `steps`, and the plastic work on the way (J): strength times plastic shear strain."""

    def one(_: Any, carry: tuple[mpm.State, Array]) -> tuple[mpm.State, Array]:
        old, work = carry
        new = mpm.advance(scene, old, 1)
        law, volume = scene.material, scene.particles.volume * new.volume_ratio
        strength = law.softening.strength(law.strength, new.history)
        return new, work + jnp.sum(volume * strength * (new.history - old.history))

    return jax.lax.fori_loop(0, steps, one, (state, jnp.zeros_like(scene.time_step)))


def energy_row(case: str, scene: mpm.Scene, state: mpm.State, seconds: float, bound: float) -> Row:
    """Energy that is neither kinetic, elastic, potential nor plastic, over what gravity has done."""
    final, plastic = dissipating(scene, state, round(seconds / float(scene.time_step)))
    fallen = -float(diagnostics.potential_energy(scene, final))
    missing = float(total_energy(scene, state) - total_energy(scene, final) - plastic)
    return row(
        f"{case}: energy unaccounted for over work of gravity",
        abs(missing) / fallen,
        bound,
        "1",
        status=mpm.Status(int(final.status)).name,
        kinetic_J=round(float(diagnostics.kinetic_energy(scene, final))),
        plastic_J=round(float(plastic)),
        gravity_J=round(fallen),
        largest_displacement_m=round(float(diagnostics.largest_displacement(final)), 2),
    )


def cfl_rows(quick: bool) -> Iterator[Row]:
    """Largest stable c dt / h of a vibrating bar, beside what lumped hat functions allow in theory: 1."""
    tried = jnp.arange(0.1, 2.01, 0.05)
    for kernel in KERNELS:
        for scheme in mpm.Scheme:
            for particles, shift in ((2, 0.0),) if quick else ((1, 0.0), (2, 0.0), (3, 0.0), (5, 0.0), (2, 1e-3)):
                yield cfl_row(kernel, scheme, particles, shift, tried)


def cfl_row(kernel: Any, scheme: mpm.Scheme, particles: int, shift: float, tried: Array) -> Row:
    """One kernel and scheme; shift: of the particles, in cells, so that some stand near faces."""
    numerics = mpm.Discretisation(1.0, (1.0 / particles,), kernel=kernel, scheme=scheme)
    soil = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.0)
    scene, state = mpm.block((20.0,), soil, numerics, domain=(24.0,), corner=(2.0 + shift,), speed=1e-3)
    wave = np.sqrt(1e6 / 1e3)
    state = replace(state, velocity=1e-3 * jnp.sin(scene.particles.position * 2.1))

    def energy(cfl: Array) -> Array:
        varied = replace(scene, time_step=cfl / wave)
        final = mpm.advance(varied, state, 400)
        return diagnostics.kinetic_energy(varied, final) + diagnostics.elastic_energy(varied, final)

    energies = np.asarray(jax.jit(jax.vmap(energy))(tried))
    stable = energies < 2 * float(diagnostics.kinetic_energy(scene, state))
    count = len(tried) if stable.all() else int(np.argmin(stable))
    largest = float(tried[count - 1]) if count else 0.0
    where = f"{particles} a cell" + (", 1e-3 cells from faces" if shift else "")
    name = f"largest stable CFL, {kernel.__name__} {scheme.name}, {where}"
    return row(name, largest, 0.5, "c dt / h", at_least=True, theory_of_hats=1.0)


def rest_rows(quick: bool) -> Iterator[Row]:
    """Bodies that should stay where they are."""
    for poisson in (0.0, 0.3, 0.49, 0.499):
        scene, state = mpm.column(8.0, mpm.Soil(poisson=poisson, young=1e7), mpm.Discretisation(1.0, (0.5, 0.5)))
        final = mpm.solve(scene, state, t_end=0.5 if quick else 2.0).state
        moved = float(diagnostics.largest_displacement(final))
        yield row(f"column at rest, nu = {poisson}", moved, 1e-3, "m", status=mpm.Status(int(final.status)).name)
    for stiff in (1e8, 1e11):
        yield contrast_row(stiff, 0.02 if quick else 0.1)
    firm = replace(CLAY, strength=200e3)  # as it is, the clay at the foot of the column would yield
    for precise in (False, True):
        with jax.enable_x64(precise):
            scene, state = mpm.column(10.0, firm, mpm.Discretisation(1.0, (0.5,)))
            steps = 10_000 if quick else 1_000_000
            final = jax.jit(mpm.advance)(scene, state, jnp.asarray(steps))
            moved = float(diagnostics.largest_displacement(final))
            yield row(f"{steps:,} steps at rest, {scene.time_step.dtype}", moved, 1e-3, "m")


def contrast_row(stiff: float, seconds: float) -> Row:
    """A stiff upper half on soft ground of E = 1 MPa, at the time step that the stiff half needs."""
    soft = 1e6
    scene, state = mpm.column(
        10.0, mpm.Soil(young=stiff, poisson=0.0), mpm.Discretisation(1.0, (0.5,)), gravity=9.81, at_rest=False
    )
    share = jnp.where(scene.particles.position[0] < 5.0, soft / stiff, 1.0)
    material = replace(scene.material, bulk=scene.material.bulk * share, shear=scene.material.shear * share)
    weight = -20e3 * (10.0 - scene.particles.position[0])
    state = replace(state, stress=state.stress.at[0].set(weight))
    scene = replace(scene, material=material)
    final = mpm.solve(scene, state, t_end=seconds).state
    moved = float(diagnostics.largest_displacement(final))
    name = f"stiff ground of {stiff:g} Pa on 1e6 Pa, at rest {seconds} s"
    return row(name, moved, 2e-2, "m", time_step_s=float(f"{float(scene.time_step):.3g}"))


def slide_rows(quick: bool) -> Iterator[Row]:
    """Collapses: the energy must be accounted for."""
    seconds = 1.0 if quick else 4.0
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    scene, state = mpm.slope(SLOPE, CLAY, numerics, speed=20.0)
    yield energy_row("collapse at R = 2", mpm.reduced(scene, 2.0), state, seconds, 0.05)
    yield energy_row("collapse at R = 5 to the far wall", mpm.reduced(scene, 5.0), state, 2 * seconds, 0.05)
    bare, start = mpm.slope(SLOPE, replace(CLAY, residual_ratio=0.0), numerics, speed=20.0)
    yield energy_row("residual strength 0, R = 2", mpm.reduced(bare, 2.0), start, seconds, 0.05)
    decades = 10 ** np.random.default_rng(0).uniform(1, 7, scene.particles.mass.size)
    yield energy_row("strength over six decades", mpm.with_strength(scene, decades), state, seconds, 0.05)
    for fbar in (False, True):
        incompressible, start = mpm.slope(SLOPE, replace(CLAY, poisson=0.49), replace(numerics, fbar=fbar), speed=20.0)
        name = f"collapse at R = 2, nu = 0.49, F-bar {'on' if fbar else 'off'}"
        yield energy_row(name, mpm.reduced(incompressible, 2.0), start, seconds, 0.05)


def flight_rows(quick: bool) -> Iterator[Row]:
    """Free motion, contact, and particles in awkward places."""
    soil, stiff = (mpm.Soil(unit_weight=9810.0, young=young) for young in (1e6, 1e8))
    fall = 10.0 if quick else 50.0
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    scene, state = mpm.block(
        (2, 2), stiff, numerics, domain=(6, fall + 4), corner=(2, fall), gravity=(0, -9.81), walls="fixed", speed=40.0
    )
    time = float(np.sqrt(2 * fall / 9.81))
    falling = mpm.solve(scene, state, t_end=0.95 * time).state
    speed = 9.81 * int(falling.step) * float(scene.time_step)
    error = float(jnp.max(jnp.abs(falling.velocity[1] / -speed - 1)))
    yield row(f"free fall of {fall:g} m: speed before impact", error, 1e-4, "relative")
    landed = mpm.solve(scene, state, t_end=1.3 * time).state
    gained = float(total_energy(scene, landed) - total_energy(scene, state)) / float(
        jnp.sum(scene.particles.mass) * 9.81 * fall
    )
    status = mpm.Status(int(landed.status)).name
    yield row(f"free fall of {fall:g} m onto rock: energy gained", gained, 0.01, "of the fall", status=status)
    for name, size, spacing, corner in (
        ("a lone particle", 0.5, 0.5, 2.3),
        ("one particle a cell", 2.0, 1.0, 2.3),
        ("particles on nodes and faces", 2.0, 0.5, 2.25),
        ("nodes with 1e-12 of a full mass", 2.0, 0.5, 2.0 - 1e-6),
    ):
        scene, state = mpm.block(
            (size,) * 2,
            soil,
            mpm.Discretisation(1.0, (spacing,) * 2),
            domain=(8, 8),
            corner=(corner,) * 2,
            velocity=(0.7, -0.3),
            speed=2.0,
        )
        final = mpm.advance(scene, state, jnp.asarray(400))
        drift = float(jnp.max(jnp.abs(final.velocity - state.velocity)))
        yield row(f"{name}: change of a uniform velocity in 400 steps", drift / 0.7, 1e-4, "relative")


def agreement_rows(quick: bool) -> Iterator[Row]:
    """One answer in two ways."""
    seconds = 0.5 if quick else 2.0

    def moved(engine: Engine | None, precise: bool, slow: bool = False) -> np.ndarray:
        with jax.enable_x64(precise):
            scene, state = mpm.slope(SLOPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)))
            shaking: Callable[[Array, Array], Array] | None = (
                (lambda x, t: jnp.zeros_like(x).at[0].set(2.0 * jnp.sin(12.0 * t))) if slow else None
            )
            scene = replace(mpm.reduced(scene, 1.0 if slow else 2.0), engine=engine, body_force=shaking)
            return np.asarray(mpm.solve(scene, state, t_end=seconds).state.displacement, float)

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.abs(a - b).max() / np.abs(b).max())

    reference = moved(None, True)
    yield row("float32 against float64, a slide", apart(moved(None, False), reference), 5e-3, "of the displacement")
    one = moved(Engine.NATIVE, True)
    yield row(
        "native against XLA in float64, a slide", apart(one, moved(Engine.XLA, True)), 1e-6, "of the displacement"
    )
    yield row(
        "base shaken at 2 m/s2, float32 against float64",
        apart(moved(None, False, slow=True), moved(None, True, slow=True)),
        5e-3,
        "of the displacement",
    )


def refusal_rows() -> Iterator[Row]:
    """What must end in a clear word."""
    try:
        mpm.slope(SLOPE, replace(CLAY, softening_modulus=5e6), mpm.Discretisation(1.0, (0.5, 0.5)))
        refused = 0.0
    except ValueError as error:
        refused = float("snaps back" in str(error))
    yield row("softening steeper than elastic unloading is refused", refused, 1.0, "1", at_least=True)
    scene, state = mpm.slope(SLOPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)))
    varied, axes = mpm.lanes(scene, strength=jnp.broadcast_to(scene.material.strength, (3,)))
    states = mpm.repeat(state, 3)
    bad = replace(states, velocity=states.velocity.at[1, 0, 7].set(jnp.nan))
    whole, broken = (mpm.solve(varied, s, t_end=0.2, axes=axes) for s in (states, bad))
    pairs = zip(jax.tree.leaves(whole.state), jax.tree.leaves(broken.state), strict=True)
    differing = sum(int(not np.array_equal(np.asarray(a)[[0, 2]], np.asarray(b)[[0, 2]])) for a, b in pairs)
    status = mpm.Status(int(broken.status[1])).name
    step = int(broken.state.step[1])
    yield row("arrays that a failed lane changes in its neighbours", differing, 0, "1", status=status, step=step)


def run(quick: bool) -> Report:
    """All cases; `cases_failed` counts those beyond their bound."""
    rows = [
        *cfl_rows(quick),
        *rest_rows(quick),
        *slide_rows(quick),
        *flight_rows(quick),
        *agreement_rows(quick),
        *refusal_rows(),
    ]
    failed = [r["case"] for r in rows if not r["passed"]]
    return Report({"cases": len(rows), "cases_failed": len(failed), "failed": failed}, rows)
