"""Stress of the particles: as it acts on the grid, and after a step."""

from __future__ import annotations

import operator
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm import tensors
from jaxmpm.equations._maps import Maps
from jaxmpm.laws import (
    at_time,
    elastic_increment,
    elastic_strain,
    excess_pressure,
    frictional,
    logarithmic,
    of_skeleton,
    pressure_left,
    update_with_gap,
    volumetric,
    with_skeleton,
)
from jaxmpm.protocols import Tensor
from jaxmpm.types import Scene, State


def acting_stress(scene: Scene, stress: Array, volume: Array, maps: Maps, excess: Array | None = None) -> Array:
    """Stress components (s, N) that act on the grid, times the current volume (J).

    The mean stress is averaged by the transpose of the strain's average: forces then do the work that the averaged
    strain stores. Without this the energy grows in a long run, and that of clay that softens without bounds. Frictional
    soil under the cell average keeps its local mean stress: a free surface would lose its strength. The excess pressure
    of its water is averaged, which is far stiffer and rings otherwise. If particles have a pore pressure, the total
    stress acts. The pressure falls to 0 as the soil opens: one that stayed would do work
    without bound, and slides exploded.

    Args:
        scene: of the particles.
        stress: components of the state (s, N) Pa.
        volume: current one (N,) m3.
        maps: transfers at the particles.
        excess: that of the state (N,) Pa, see `excess_of`; None without.

    Returns:
        (d (d + 1) / 2, N) J.
    """
    d = scene.grid.dimension
    if scene.loads.pore_pressure is not None:
        effective, share = tensors.expand(stress, d), pressure_left(jnp.log(volume / scene.particles.volume))
        total = tensors.mean(effective) - share * scene.loads.pore_pressure
        stress = tensors.compress(tensors.with_mean(effective, total), d)
    if scene.numerics.fbar:
        specific, full = volume / scene.particles.mass, tensors.expand(stress, d)
        full = tensors.with_mean(full, maps.average(tensors.mean(full) * specific, 0) / specific)
        stress = tensors.compress(full, d)
    if scene.numerics.cell_average and (local := frictional(scene.material)) is not True:
        full = tensors.expand(stress, d)
        mean = tensors.mean(full)
        full = tensors.with_mean(full, jnp.where(local, mean, maps.cell_average(mean, volume)))
        stress = tensors.compress(full, d)
    if excess is not None and scene.numerics.cell_average:
        full = tensors.expand(stress, d)
        mean = tensors.mean(full) + excess - maps.cell_average(excess, volume)
        stress = tensors.compress(tensors.with_mean(full, mean), d)
    # A stack of products, not a product of stacks: XLA on CPU vectorises only the first.
    return jnp.stack([volume * component for component in tensors.rows(tensors.acting(stress, d))])


def excess_of(scene: Scene, state: State) -> Array | None:
    """Change of pore pressure (N,) Pa that the state's stress has in it; None where all soil is drained."""
    excess = excess_pressure(scene.material, state.history, tensors.expand(state.stress, scene.grid.dimension))
    return excess if excess is None or not scene.numerics.finite_strain else excess / state.volume_ratio


def update_stress(scene: Scene, state: State, gradient: Array, dt: Array, maps: Maps) -> State:
    """Stress, history, gap and volume after a step with velocity gradient (d, d, N) 1/s."""
    d = scene.grid.dimension
    strained = (strained_by_logarithms if scene.numerics.finite_strain else strained_by_rates)(
        scene, state, tensors.entries(gradient), dt, maps
    )
    inputs = strained.strain, strained.stress, state.history, dt
    gap, received, volume_ratio = state.gap, None, strained.volume_ratio
    if gap is not None and scene.numerics.gap_average:
        # As the strain is: otherwise loose sand lies for ever beside sand that bears its weight. Clay loses energy.
        # The volume follows: soil that bore pressure in a volume with a gap would be too stiff for its mass.
        averaged = maps.cell_average(gap, scene.particles.volume * state.volume_ratio)
        averaged = jnp.where(frictional(scene.material), averaged, gap)
        received = averaged - gap
        gap, volume_ratio = averaged, volume_ratio * jnp.exp(received)
    law = at_time(scene.material, (state.step + 1) * dt)
    logarithmic = scene.numerics.finite_strain
    stress, history, gap = update_with_gap(law, *inputs, gap=gap, received=received, logarithmic=logarithmic)
    unaveraged = state.unaveraged
    if scene.numerics.nonlocal_passes is not None:
        # The next step's transfers average it: transfers of its own would cost a fifth of a step.
        before = of_skeleton(state.history)
        unaveraged = jax.tree.map(operator.sub, of_skeleton(history), before)
        history = with_skeleton(history, before)
    if scene.numerics.finite_strain:
        # Stored first: otherwise XLA on CPU divides all components in the one loop that computes them.
        components = tensors.compress(tensors.row_by_row(stress), d) / volume_ratio
    else:
        components = tensors.compress(stress, d)
    state = replace(state, stress=components, history=history, unaveraged=unaveraged, gap=gap)
    return replace(state, volume_ratio=volume_ratio)


class Strained(NamedTuple):
    """Arguments of a law in a step, and the new volume.

    Args:
        strain: increment.
        stress: tensor that it is added to (Pa).
        volume_ratio: (N,) current over initial volume.
    """

    strain: Tensor
    stress: Tensor
    volume_ratio: Array


def strained_by_rates(scene: Scene, state: State, entries: list[list[Array]], dt: Array, maps: Maps) -> Strained:
    """Hypoelasticity: the stress rotated by the Jaumann rate, and the strain of the velocity gradient's entries."""
    rotated = tensors.rotate(tensors.expand(state.stress, scene.grid.dimension), entries, dt)
    strain = maps.unlocked(tensors.strain_increment(entries, dt), scene.particles.volume * state.volume_ratio)
    return Strained(strain, rotated, state.volume_ratio * (1 + 3 * tensors.mean(strain)))


def strained_by_logarithms(scene: Scene, state: State, entries: list[list[Array]], dt: Array, maps: Maps) -> Strained:
    """Hyperelasticity: the Kirchhoff stress minus that of the strain increment, and the increment.

    Both add up to the trial stress of Hencky's strain. The change of volume is exact, averaged as the scene requires.

    Args:
        scene: of the particles.
        state: before the step.
        entries: of the velocity gradient, row by row (1/s).
        dt: time step (s).
        maps: transfers at the particles.

    Returns:
        Arguments of the law.
    """
    law = scene.material
    kirchhoff = tensors.expand(state.volume_ratio * state.stress, scene.grid.dimension)
    elastic = elastic_strain(law.bulk, law.shear, kirchhoff)
    strain = tensors.with_mean(tensors.strain_increment(entries, dt), volumetric(entries, dt) / 3)
    strain = maps.unlocked(strain, scene.particles.volume * state.volume_ratio)
    grown = tensors.mean(strain)
    trial = tensors.with_mean(logarithmic(elastic, entries, dt), tensors.mean(elastic) + grown)
    before = tensors.by_component(operator.sub, trial, strain)
    stress = elastic_increment(law.bulk, law.shear, before)
    return Strained(strain, stress, state.volume_ratio * jnp.exp(3 * grown))
