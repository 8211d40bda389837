"""What the stability cases share: a row with its verdict, and a run whose energy is itemised."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

import jaxmpm as mpm
from jaxmpm import diagnostics, equations, pytree, tensors

Row = dict[str, Any]
CLOSED = 0.02
"""Share of the work done to which the energy must close."""
SLOPE = mpm.Slope(crest=10, height=6, run_per_rise=1.0, toe=14, foundation=2)
CLAY = mpm.Soil(young=1e7, strength=20e3, softening_modulus=40e3, tension_cutoff=0.0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))


def judged(case: str, figure: float, bound: float, unit: str, *, at_least: bool = False, **more: Any) -> Row:
    """A case passes if its figure is at most the bound (or at least, where that is asked).

    A figure that is not finite never passes, and is given as None.
    """
    passed = (operator.ge if at_least else operator.le)(figure, bound)
    return {
        "case": case,
        "figure": float(f"{figure:.3g}") if math.isfinite(figure) else None,
        "sense": ">=" if at_least else "<=",
        "bound": bound,
        "unit": unit,
        "passed": bool(passed),
        **more,
    }


def status_of(state: mpm.State) -> str:
    """Name of the status of one lane."""
    return mpm.Status(int(state.status)).name


@pytree
@dataclass(frozen=True)
class Metered(mpm.laws.Law):
    """A law with linear elasticity, and with it what it dissipates per initial volume (J/m3).

    The mean of a step's two stresses does work on its strain (exact while elastic, second order in the step on the
    yield surface); what of it is not stored is dissipated, as is what a sudden loss of strength takes from the store.
    With finite strains the law is given Kirchhoff stress, which does its work per initial volume.
    """

    law: Any
    finite_strain: bool = field(metadata={"static": True})

    @property
    def bulk(self) -> Array:
        """Bulk modulus (Pa)."""
        return self.law.bulk

    @property
    def shear(self) -> Array:
        """Shear modulus (Pa)."""
        return self.law.shear

    def initial_history(self, particles: mpm.Particles) -> Any:
        """The law's history, nothing dissipated, no change of volume."""
        return self.law.initial_history(particles), jnp.zeros_like(particles.mass), jnp.ones_like(particles.mass)

    def update(self, strain_increment: Any, stress: Any, history: Any, dt: Array | None = None) -> tuple[Any, Any]:
        """The law's update, its dissipation counted."""
        inner, dissipated, volume_ratio = history
        new, inner = self.law.update(strain_increment, stress, inner, dt)
        middle = tuple((old + after) / 2 for old, after in zip(stress, new, strict=True))
        stored = elastic_density(self.bulk, self.shear, new) - elastic_density(self.bulk, self.shear, stress)
        if not self.finite_strain:
            volume_ratio = volume_ratio * (1 + 3 * tensors.mean(strain_increment))
        return new, (inner, dissipated + volume_ratio * (contraction(middle, strain_increment) - stored), volume_ratio)


def contraction(a: Any, b: Any) -> Array:
    """Double contraction a:b of two symmetric tensors."""
    normal = sum(x * y for x, y in zip(a[:3], b[:3], strict=True))
    return normal + 2 * sum(x * y for x, y in zip(a[3:], b[3:], strict=True))


def elastic_density(bulk: Array, shear: Array, stress: Any) -> Array:
    """Elastic energy per volume (J/m3)."""
    pressure = tensors.mean(stress)
    return pressure**2 / (2 * bulk) + tensors.second_invariant(tensors.deviator(stress)) / (2 * shear)


@pytree
@dataclass(frozen=True)
class Energies:
    """Where the energy of a run went (J): what is stored at its end less at its start, what is spent, what came in.

    The work of the ground that bodies rest on is none where walls hold velocities at 0. Its traction across gaps to
    undrained soil (`jaxmpm.equations.closed`) is friction, which acts on soil that moves, and so is that across gaps
    between soils (`jaxmpm.equations.bridged`).
    """

    kinetic: Array
    elastic: Array
    plastic: Array
    damping: Array
    ground: Array
    gravity: Array
    body_force: Array

    @property
    def unaccounted(self) -> Array:
        """Work done less energy found: what the method loses (above 0) or makes (below)."""
        spent = self.kinetic + self.elastic + self.plastic + self.damping + self.ground
        return self.gravity + self.body_force - spent

    def items(self) -> Row:
        """For a row of a table, in kJ."""
        kilojoules = {f"{name}_kJ": float(f"{float(value) / 1e3:.4g}") for name, value in vars(self).items()}
        return {name: value for name, value in kilojoules.items() if value}


@jax.jit
def metered_run(scene: mpm.Scene, state: mpm.State, steps: int) -> tuple[mpm.State, Energies]:
    """The state after `steps`, and where the energy went on the way."""
    scene = replace(scene, material=Metered(scene.material, scene.numerics.finite_strain))
    fresh = mpm.unstressed(scene)
    state = replace(state, history=(state.history, *fresh.history[1:]), unaveraged=fresh.unaveraged)
    m, dt = scene.particles.mass, scene.numerics.time_step

    def one(_: Any, carry: tuple[mpm.State, Array, Array, Array]) -> tuple[mpm.State, Array, Array, Array]:
        old, damped, pushed, ground = carry
        if not scene.numerics.finite_strain:
            # What closes a gap is no strain of the law, which so does not know its volume.
            old = replace(old, history=(*old.history[:2], old.volume_ratio))
        new = mpm.advance(scene, old, 1)
        if equations.undrained(scene) is not False:
            ground = ground + work_across_gaps(scene, old)
        if scene.numerics.damping is not None:
            halves = diagnostics.kinetic_energy(scene, old) + diagnostics.kinetic_energy(scene, new)
            damped = damped + dt * scene.numerics.damping * halves
        if scene.loads.body_force is not None:
            push = scene.loads.body_force(scene.particles.position, old.step * dt)
            pushed = pushed + jnp.sum(m * push * (new.displacement - old.displacement))
        return new, damped, pushed, ground

    zero = jnp.zeros_like(dt)
    final, damped, pushed, ground = jax.lax.fori_loop(0, steps, one, (state, zero, zero, zero))
    dissipated = final.history[1] if final.unaveraged is None else final.history[1] + final.unaveraged[1]
    energies = Energies(
        kinetic=centred_kinetic(scene, final) - centred_kinetic(scene, state),
        elastic=diagnostics.elastic_energy(scene, final) - diagnostics.elastic_energy(scene, state),
        plastic=jnp.sum(scene.particles.volume * dissipated),
        damping=damped,
        ground=ground,
        gravity=-diagnostics.potential_energy(scene, final),
        body_force=pushed,
    )
    return final, energies


def work_across_gaps(scene: mpm.Scene, state: mpm.State) -> Array:
    """Energy (J) that traction across gaps takes from soil in the next step."""
    dt, maps = scene.numerics.time_step, equations.Maps(scene, equations.grid_position(scene, state))
    nodal = equations.particles_to_grid(scene, state, dt, maps)
    volume = scene.particles.volume * state.volume_ratio
    acting, d = equations.acting_stress(scene, state.stress, volume, maps), scene.grid.dimension
    levels = equations.by_levels(scene, volume, acting)
    sums = maps.to_grid(None, acting, levels)
    stress, shears = sums[:, :d], equations.sheared(scene) is not False
    gap = equations.gaps(scene, nodal.mass[:, 0]) if shears else None
    force = stress if levels is None else equations.bridged(scene, sums[:, d:], stress, gap)
    if shears:
        force = equations.closed(scene, gap, force, nodal.undrained)
    traction = force - stress
    before, after = equations.nodal_velocity(nodal), equations.move_grid(scene, nodal, state.step * dt, dt).velocity
    return -dt / 2 * jnp.sum(traction * (before + after))


def centred_kinetic(scene: mpm.Scene, state: mpm.State) -> Array:
    """Kinetic energy (J) at the time of the stress, where velocities are half a step apart from it.

    The step is a leapfrog: its velocities belong to the middle between two stresses (USF: to the time of the stress to
    first order). The product of the velocities before and after is what is conserved with the elastic energy.
    """
    if scene.numerics.scheme is mpm.Scheme.USF:
        return diagnostics.kinetic_energy(scene, state)
    after = mpm.step(scene, state, scene.numerics.time_step)
    return 0.5 * jnp.sum(scene.particles.mass * jnp.sum(state.velocity * after.velocity, axis=0))


def energy_row(
    case: str, scene: mpm.Scene, state: mpm.State, seconds: float, bound: float, *, over: float | None = None
) -> Row:
    """Energy unaccounted for over the work done, or over the energy `over` (J); a lane that broke off fails."""
    final, energies = metered_run(scene, state, round(seconds / float(scene.numerics.time_step)))
    share = float(energies.unaccounted) / (over or float(energies.gravity + energies.body_force))
    broken = int(final.status) > mpm.Status.DECIDED
    return judged(
        f"{case}: energy unaccounted for",
        float("nan") if broken else abs(share),
        bound,
        "of the work done" if over is None else "of the energy at the start",
        status=status_of(final),
        sign="lost" if share > 0 else "made",
        largest_displacement_m=round(float(diagnostics.largest_displacement(final)), 2),
        **energies.items(),
    )
