"""Stability on stiff and extreme cases: every row has a measured figure and a bound, none merely "did not crash".

A row passes if its figure keeps its bound and its lane did not break off. `unaccounted for` is the work of gravity and
body forces less what kinetic, elastic, dissipated and damping energy hold. Rows that fail are listed in `failed`;
where that is a known limit of a method, `why` names it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
import kl
from benchmarks.measure import Report
from benchmarks.stability.stability_case import (
    CLAY,
    CLOSED,
    NUMERICS,
    SLOPE,
    Row,
    energy_row,
    judged,
    status_of,
)
from benchmarks.stability.stability_cfl import KERNELS, cfl_rows
from benchmarks.stability.stability_flight import flight_rows
from benchmarks.stability.stability_gap import gap_rows
from benchmarks.stability.stability_rigid import sliding_rows, spinning_rows
from cooperative.scene._campaign import BAND
from jaxmpm import diagnostics
from jaxmpm.transfer import p2g

INTERFACE = 0.147
"""Share of the soft half's settlement that its uppermost of five cells has: what is lost at most where boxes of stiff
particles reach into that cell and average its strain, the more the greater the contrast."""


def rest_rows(quick: bool) -> Iterator[Row]:
    """Bodies that should stay where they are, or come to rest where theory has it."""
    for poisson in (0.3, 0.499) if quick else (0.0, 0.3, 0.49, 0.499):
        yield settlement_row(f"settlement, nu = {poisson}", mpm.Soil(poisson=poisson, young=1e7), 1.0)
    for stiff in (1e9,) if quick else (1e6, 1e8, 1e9, 1e10, 1e11):
        soil = mpm.Soil(unit_weight=20e3, young=stiff, poisson=0.0)
        name = f"settlement, upper half of E = {stiff:g} Pa on 1e6 Pa"
        yield settlement_row(name, soil, 1e6 / stiff, gravity=0.05, bound=0.01 if stiff < 1e10 else INTERFACE)
    firm = replace(CLAY, strength=200e3)  # as it is, the clay at the foot of the column would yield
    for precise in (False, True):
        with jax.enable_x64(precise):
            scene, state = mpm.column(10.0, firm, mpm.Discretisation(1.0, (0.5,) if quick else (0.5, 0.5)))
            steps = 10_000 if quick else 1_000_000
            final = jax.jit(mpm.advance)(scene, state, jnp.asarray(steps))
            drift = float(diagnostics.largest_displacement(final))
            name = f"drift in {steps:,} steps at rest, {scene.numerics.time_step.dtype}"
            yield judged(name, drift, 1e-3, "m", status=status_of(final))


def settlement_row(case: str, soil: mpm.Soil, soft: float, *, gravity: float = 0.981, bound: float = 0.01) -> Row:
    """A column whose lower half has `soft` times the stiffness comes to rest, damped, under a gravity set on at once.

    Theory: in uniaxial strain the top sinks by the integral of stress over p-wave modulus. Gravity is small, so that
    strains are (to 1e-3).
    """
    height = 10.0
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    scene, state = mpm.column(height, soil, numerics, gravity=gravity, at_rest=False)
    lower = scene.particles.position[1] < height / 2
    share = jnp.where(lower, soft, 1.0)
    material = replace(scene.material, bulk=scene.material.bulk * share, shear=scene.material.shear * share)
    modulus = float(scene.material.p_wave_modulus)
    density = soil.unit_weight / 9.81
    half = density * gravity * height**2 / 8 / modulus
    expected = half + 3 * half / soft
    # Critically damped in its first mode, whose frequency is near sqrt(g / settlement).
    scene = replace(
        scene,
        material=material,
        numerics=replace(scene.numerics, damping=jnp.sqrt(4 * gravity / expected).astype(state.velocity.dtype)),
    )
    seconds = 12 * float(np.sqrt(expected / gravity))
    final = mpm.solve(scene, state, t_end=seconds).state
    top = scene.particles.position[1] > height - 0.5
    distance = -float(jnp.mean(final.displacement[1], where=top))
    # The uppermost particles stand a quarter of a metre below the top, which hardly matters.
    return judged(
        f"{case}: against theory",
        abs(distance / expected - 1),
        bound,
        "relative",
        status=status_of(final),
        settlement_m=float(f"{distance:.4g}"),
        time_step_s=float(f"{float(scene.numerics.time_step):.3g}"),
        steps=int(final.step),
    )


def collapse_rows(quick: bool) -> Iterator[Row]:
    """Slides under every kernel and scheme, and of soils beyond what is sensible: the energy must be accounted for."""
    seconds = 1.0 if quick else 4.0

    def collapse(name: str, soil: mpm.Soil = CLAY, reduction: float = 2.0, shape: mpm.Slope = SLOPE, **choices: Any):
        scene, state = mpm.slope(shape, soil, replace(NUMERICS, **choices), speed=20.0)
        # A strength per particle, so that the cases share their compiled program.
        strength = jnp.broadcast_to(scene.material.strength / reduction, scene.particles.mass.shape)
        return energy_row(name, mpm.with_soil(scene, state, strength=strength)[0], state, seconds, CLOSED)

    yield collapse("collapse at R = 2")
    # At a wall that stands nearer to the toe it splashes out of the grid, two metres above the crest.
    yield collapse("collapse at R = 5 to the far wall", reduction=5.0, shape=replace(SLOPE, toe=20))
    # What has hardly any strength splashes, at a near wall to above the crest and out of the grid: room for it.
    room = SLOPE if quick else replace(SLOPE, toe=54)
    clay = replace(CLAY, softening_length=BAND * SLOPE.height)
    length = mpm.cell_independent(NUMERICS, clay).internal_length
    for reduction, shape in ((2.0, SLOPE), (5.0, room)):
        name = f"collapse at R = {reduction:g}, default settings of scenes"
        yield collapse(name, clay, reduction, shape, cell_average=True, internal_length=length)
    yield collapse("residual strength 0", replace(CLAY, residual_ratio=0.0), shape=room)
    for fbar in (True,) if quick else (False, True):
        yield collapse(f"nu = 0.499, F-bar {'on' if fbar else 'off'}", replace(CLAY, poisson=0.499), fbar=fbar)
    yield from uneven_rows(quick, seconds)
    if quick:
        return
    for kernel in KERNELS:
        for scheme in (mpm.Scheme.MUSL, mpm.Scheme.USF):
            yield collapse(f"collapse at R = 2, {kernel.__name__} {scheme.name}", kernel=kernel, scheme=scheme)
    for cfl in (0.1, 0.9):
        yield collapse(f"collapse at R = 2, CFL {cfl}", cfl=cfl)
    yield collapse("collapse at R = 2, one particle a cell", spacing=(1.0, 1.0))
    yield collapse("collapse at R = 2, damping 0.5 1/s", damping=0.5)
    yield collapse("collapse at R = 2, plastic strain averaged over 1.5 m", internal_length=1.5)
    usl = [(f"{kernel.__name__} USL", {"kernel": kernel, "scheme": mpm.Scheme.USL}) for kernel in KERNELS]
    apic: dict[str, Any] = {"kernel": mpm.QuadraticBSpline, "apic": True, "flip": 0.0}
    for name, choices in (*usl, ("APIC", apic), ("5 % PIC", {"flip": 0.95})):
        row = collapse(f"collapse at R = 2, {name}", **choices)
        size = row["figure"] if row["figure"] is not None else float("nan")
        made = -size if row["sign"] == "lost" else size
        case = f"collapse at R = 2, {name}, which dissipates by design: energy made"
        answer = judged(case, made, CLOSED, row["unit"], **{key: row[key] for key in list(row)[6:]})
        if not answer["passed"]:
            answer["why"] = "known limit: nearly empty nodes have no bounded velocity with hats; MUSL maps them again"
        yield answer
    yield long_runout_row()


def uneven_rows(quick: bool, seconds: float) -> Iterator[Row]:
    """Strengths that vary as no grid can resolve."""
    scene, state = mpm.slope(SLOPE, CLAY, NUMERICS, speed=20.0)
    particles = scene.particles
    decades = 10 ** np.random.default_rng(0).uniform(1, 7, particles.mass.size)
    yield energy_row(
        "strength over six decades between neighbours",
        mpm.with_soil(scene, state, strength=decades)[0],
        state,
        seconds,
        CLOSED,
    )
    for length in (0.3,) if quick else (0.3, 3.0):
        kinds = (kl.Exponential(length),) * 2
        field = kl.expand(kinds, origin=(0, 0), extent=(SLOPE.length, SLOPE.foundation + SLOPE.height), modes=2000)
        xi = kl.latin_hypercube(jax.random.key(1), 1, field.modes)
        strength = kl.Lognormal(mean=10e3, cov=1.0).transform(kl.field_at(field, xi, particles.position))[0]
        name = f"lognormal strength of COV 1.0, correlated over {length:g} m in cells of 1 m"
        varied = mpm.with_soil(scene, state, strength=strength)[0]
        row = energy_row(name, varied, state, seconds, CLOSED)
        yield row | {"strength_from_Pa": round(float(strength.min())), "to_Pa": round(float(strength.max()))}


def long_runout_row() -> Row:
    """R = 5 with a run-out of more than 100 m, into a wall."""
    shape = mpm.Slope(crest=30, height=12, run_per_rise=2.0, toe=104, foundation=2)
    soil = mpm.Soil(young=2e7, strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
    scene, state = mpm.slope(shape, soil, NUMERICS, speed=30.0)
    scene = mpm.reduced(scene, 5.0)
    row = energy_row("R = 5, run-out to a wall 104 m from the toe", scene, state, 30.0, CLOSED)
    final = mpm.solve(scene, state, t_end=30.0).state
    front = float(jnp.max(diagnostics.position(scene, final)[0] + 0.25)) - shape.toe_x
    distance = scene.particles.position[1] > shape.foundation
    reach = float(jnp.max(jnp.where(distance, diagnostics.position(scene, final)[0], 0))) + 0.25 - shape.toe_x
    return row | {"front_m": round(front, 1), "reach_of_the_slope_m": round(reach, 1)}


def shaking_rows(quick: bool) -> Iterator[Row]:
    """Shaking at the base, in the frame of the base: a column against its modal sum, and a slope's energy."""
    height, amplitude, pulse = 20.0, 1.0, 12.0
    soil = mpm.Soil(young=1e7, poisson=0.0)
    scene, state = mpm.column(height, soil, mpm.Discretisation(0.5, (0.25,)), gravity=0.0, at_rest=False)
    loads = replace(scene.loads, body_force=lambda x, t: jnp.full_like(x, amplitude) * jnp.sin(pulse * t))
    scene = replace(scene, loads=loads)
    wave = np.sqrt(1e7 / (20e3 / 9.81))
    times = np.linspace(0, 3.0, 31)[1:]
    result = mpm.solve(scene, state, t_end=3.0, snapshots=times.tolist())
    z = np.asarray(scene.particles.position[0])
    k = (2 * np.arange(200)[:, None] + 1) * np.pi / (2 * height)
    errors, size = [], 0.0
    for snapshot in result.snapshots:
        t, omega = int(snapshot.step) * float(scene.numerics.time_step), k * wave
        modal = amplitude / (omega**2 - pulse**2) * (np.sin(pulse * t) - pulse / omega * np.sin(omega * t))
        exact = np.sum(2 / (height * k) * np.sin(k * z) * modal, axis=0)
        errors.append(np.abs(np.asarray(snapshot.displacement[0]) - exact).max())
        size = max(size, np.abs(exact).max())
    yield judged("column shaken at its base against the modal sum", max(errors) / size, 0.02, "of the largest motion")
    scene, state = mpm.slope(SLOPE, CLAY, NUMERICS, speed=20.0)
    loads = replace(scene.loads, body_force=lambda x, t: jnp.zeros_like(x).at[0].set(3.0 * jnp.sin(12.0 * t)))
    scene = replace(scene, loads=loads)
    yield energy_row("slope shaken at its base by 3 m/s2", scene, state, 1.0 if quick else 4.0, CLOSED)


def awkward_rows(quick: bool) -> Iterator[Row]:
    """Particles in awkward positions: a uniform motion stays uniform, and a vibration keeps its energy."""
    soil = mpm.Soil(unit_weight=9810.0, young=1e6)
    for kernel in KERNELS[:1] if quick else KERNELS:
        for name, size, spacing, corner in (
            ("a lone particle", 0.5, 0.5, 2.3),
            ("one particle a cell", 2.0, 1.0, 2.3),
            ("particles on nodes and faces", 2.0, 0.5, 2.25),
            ("nodes with 1e-12 of a full mass", 2.0, 0.5, 2.0 - 1e-6 if kernel is mpm.GIMP else 2.25 - 1e-6),
        ):
            numerics = mpm.Discretisation(1.0, (spacing,) * 2, kernel=kernel)
            scene, state = mpm.block((size,) * 2, soil, numerics, domain=(8, 8), corner=(corner,) * 2, speed=2.0)
            case = f"{name}, {kernel.__name__}"
            uniform = jnp.asarray([[0.7], [-0.3]]) * jnp.ones_like(scene.particles.mass)
            final = mpm.advance(scene, replace(state, velocity=uniform), jnp.asarray(400))
            drift = float(jnp.max(jnp.abs(final.velocity - uniform)))
            row = judged(f"{case}: change of a uniform velocity in 400 steps", drift / 0.7, 1e-4, "relative")
            if "on nodes" in name and kernel is mpm.Linear:
                row["why"] = "known limit: a hat that is 0 at a particle has a slope there, an empty node no velocity"
            yield row
            if size == spacing:
                continue
            middle = corner + size / 2
            state = replace(state, velocity=0.1 * (scene.particles.position - middle))
            start = float(diagnostics.kinetic_energy(scene, state))
            seconds = 400 * float(scene.numerics.time_step)
            row = energy_row(f"{case}, vibrating", scene, state, seconds, CLOSED, over=start)
            if not row["passed"] and kernel is mpm.Linear:
                row["why"] = "known limit: particles that cross faces under hats feel their slope jump"
            yield row


def agreement_rows(quick: bool) -> Iterator[Row]:
    """One answer in two ways; and mass."""
    seconds = 0.5 if quick else 4.0

    def slide(engine: mpm.Engine | None, precise: bool) -> np.ndarray:
        with jax.enable_x64(precise):
            scene, state = mpm.slope(SLOPE, CLAY, NUMERICS)
            scene = mpm.reduced(replace(scene, numerics=replace(scene.numerics, engine=engine)), 2.0)
            return np.asarray(mpm.solve(scene, state, t_end=seconds).state.displacement, float)

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.abs(a - b).max() / np.abs(b).max())

    reference = slide(mpm.Engine.XLA, True)
    unit = "of the largest displacement"
    yield judged(f"float32 against float64, a slide of {seconds:g} s", apart(slide(None, False), reference), 1e-2, unit)
    yield judged(
        f"native against XLA in float64, a slide of {seconds:g} s", apart(slide(None, True), reference), 1e-6, unit
    )
    scene, state = mpm.slope(SLOPE, CLAY, NUMERICS, speed=20.0)
    final = mpm.solve(mpm.reduced(scene, 5.0), state, t_end=seconds).state
    m = scene.particles.mass
    nodal = p2g(scene.grid, scene.numerics.kernel, diagnostics.position(scene, final), m[None], None)
    error = abs(float(jnp.sum(nodal) / jnp.sum(m)) - 1)
    yield judged("mass on the grid against mass of the particles, collapsed at R = 5", error, 1e-5, "relative")


def refusal_rows() -> Iterator[Row]:
    """What must end in a clear word."""
    refused = 0
    cases: list[dict[str, Any]] = [
        {"softening_modulus": 5e6},
        {"softening_modulus": None, "strain_95": 1e-3},
        {"softening_length": 1e-3},
    ]
    for soil in cases:
        try:
            mpm.slope(SLOPE, replace(CLAY, **soil), NUMERICS)
        except ValueError as error:
            refused += "snaps back" in str(error)
    name = "softening steeper than elastic unloading (linear, exponential, by its length) refused by name"
    yield judged(name, refused, len(cases), "cases", at_least=True)

    scene, state = mpm.slope(SLOPE, CLAY, NUMERICS)
    varied, axes = mpm.run.lanes(scene, strength=jnp.broadcast_to(scene.material.strength, (5,)))
    states = mpm.run.repeat(state, 5)
    velocity = states.velocity.at[1, 0, 7].set(jnp.nan).at[2, 0, 7].set(1.2 / float(scene.numerics.time_step))
    outside = states.displacement.at[3, 1, 7].set(1e3)
    bad = replace(states, velocity=velocity, displacement=outside)
    whole, broken = (mpm.solve(varied, s, t_end=0.2, axes=axes) for s in (states, bad))
    pairs = zip(jax.tree.leaves(whole.state), jax.tree.leaves(broken.state), strict=True)
    differing = sum(int(not np.array_equal(np.asarray(a)[[0, 4]], np.asarray(b)[[0, 4]])) for a, b in pairs)
    yield judged("arrays of its neighbours that a lane that breaks off changes", differing, 0, "arrays")
    expected = [mpm.Status.NOT_FINITE, mpm.Status.TIME_STEP_TOO_LARGE, mpm.Status.OUTSIDE_GRID]
    wrong = sum(
        int(status != required or step != 1)
        for status, step, required in zip(broken.status[1:4], broken.state.step[1:4], expected, strict=True)
    )
    yield judged("lanes that broke off without the right status and step", wrong, 0, "of 3 lanes")


def run(quick: bool) -> Report:
    """All cases; `cases_failed` counts those beyond their bound."""
    rows = [
        *cfl_rows(quick),
        *rest_rows(quick),
        *collapse_rows(quick),
        *shaking_rows(quick),
        *sliding_rows(quick),
        *spinning_rows(quick),
        *gap_rows(quick),
        *flight_rows(quick),
        *awkward_rows(quick),
        *agreement_rows(quick),
        *refusal_rows(),
    ]
    failed = [row["case"] for row in rows if not row["passed"]]
    return Report({"cases": len(rows), "cases_failed": len(failed), "failed": failed}, rows)
