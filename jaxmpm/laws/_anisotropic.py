"""Undrained clay whose strength depends on the direction of shearing, and which hardens from its stress at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Particles
from jaxmpm.laws._base import Law
from jaxmpm.laws._parameter import Parameter
from jaxmpm.laws._undrained import add, elastic_increment
from jaxmpm.protocols import Tensor
from jaxmpm.support.check import Limit
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import zeros_like
from jaxmpm.tensors import (
    CARRIED,
    absent,
    by_component,
    deviator,
    mean,
    placed,
    row_by_row,
    safe_sqrt,
    second_invariant,
    with_mean,
)

ROUNDS = 12
"""Rounds of the search for the hardening of a step: each takes Newton's step, or halves the bracket."""

SHEARS_OF_VERTICAL = (4, 5)
"""Components yz and xz, which shear horizontal planes."""


class Mobilisation(NamedTuple):
    """History of anisotropic undrained clay.

    Args:
        strain: engineering plastic shear strain (N,).
        rest: components of the deviatoric stress at rest, each (N,) Pa: those that a state has.
    """

    strain: Array
    rest: tuple[Array, ...]


@pytree
@dataclass(frozen=True)
class AnisotropicUndrained(Law):
    """Undrained clay with a strength each for active, direct simple and passive shearing in plane strain.

    It has the strengths and the hardening of NGI-ADP. With the vertical z, the deviator s - (1 - k) s_rest - k a, whose
    shear on horizontal planes is scaled by r = (active + passive) / (2 simple), yields where its sqrt(J2) is
    k (active + passive) / 2. a is the deviator that carries half the difference of active and passive. The mobilised
    share k = 2 sqrt(g / failure_strain) / (1 + g / failure_strain) grows from 0 at the stress at rest to 1 at the
    plastic shear strain g of failure_strain. A stress at rest beyond the strength counts as one at it. So the
    clay yields from its stress at rest on, and fails in plane strain at the active, direct simple and passive
    strengths.

    It differs from NGI-ADP in three ways: one failure_strain serves all directions, the criterion is that of Mises,
    which gives sqrt(3) / 2 (active + passive) + active - passive for q in triaxial compression, and flow has the
    direction of the scaled deviator. The axes of anisotropy stay upright.

    Sources: Grimstad, Andresen and Jostad (2012), doi:10.1002/nag.1016, Sections 2 and 3.

    Every parameter is a number or one value per particle (N,).

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        active: undrained strength where the vertical stress grows (Pa).
        simple: strength in direct simple shear (Pa).
        passive: strength where the vertical stress falls (Pa).
        failure_strain: engineering plastic shear strain at which the strength is mobilised.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "active": Parameter(above=0.0, unit="Pa", name="active_strength", reduced=True),
        "simple": Parameter(above=0.0, unit="Pa", name="simple_strength", reduced=True),
        "passive": Parameter(above=0.0, unit="Pa", name="passive_strength", reduced=True),
        "failure_strain": Parameter(above=0.0),
    }

    bulk: Array
    shear: Array
    active: Array
    simple: Array
    passive: Array
    failure_strain: Array

    def initial_history(self, particles: Particles) -> Mobilisation:
        """Soil without plastic strain and without shear at rest."""
        none = zeros_like(particles.mass)
        return Mobilisation(none, (none,) * len(CARRIED[len(particles.position)]))

    def history_at_rest(self, history: Mobilisation, stress: Tensor) -> Mobilisation:
        """The deviatoric stress at rest, where the mobilised share is 0."""
        shearing = deviator(stress)
        kept = CARRIED[_dimension(history)]
        return history._replace(rest=tuple(jnp.broadcast_to(shearing[k], history.strain.shape) for k in kept))

    def stiffened(self, bulk: Array, shear: Array, pressure: Array) -> AnisotropicUndrained:
        """The clay with other moduli (Pa), which fails at the strain that they give its strength."""
        return replace(self, bulk=bulk, shear=shear, failure_strain=self.simple / shear)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Mobilisation, dt: Array | None = None
    ) -> tuple[Tensor, Mobilisation]:
        """Elastic predictor, and return along the scaled deviator to the share that its own flow mobilises.

        The unknown is x = sqrt(g / failure_strain), at most 1. Where 1 is not enough the clay is perfectly plastic.

        Args:
            strain_increment: tensor, tension positive.
            stress: total, tensor (Pa).
            history: mobilisation so far.
            dt: not used.

        Returns:
            Stress (Pa) and history.
        """
        trial = row_by_row(add(stress, elastic_increment(self.bulk, self.shear, strain_increment)))
        carried = CARRIED[_dimension(history)]
        rest = placed(zip(carried, history.rest, strict=True))
        before = jnp.minimum(safe_sqrt(history.strain / self.failure_strain), 1)
        upright = 0 if len(carried) == len(CARRIED[1]) else 2
        step = _Step(deviator(trial), self._borne(rest, upright), self, before, upright)
        yielding = ~(step.excess(before)[0] >= 1)
        x = jnp.where(yielding, _root(step), before)
        share, flow = step.excess(x)
        share, pressure = jnp.where(yielding, share, 1.0), mean(trial)
        deviatoric = by_component(
            lambda s, o: s if absent(s) else o + share * (s - o), step.trial, step.offset(mobilised(x))
        )
        result = row_by_row(with_mean(deviatoric, pressure))
        return result, history._replace(strain=history.strain + jnp.where(yielding, jnp.maximum(flow, 0), 0.0))

    def _failure_centre(self, upright: int) -> Tensor:
        """Deviator (Pa) in the middle between the active and the passive strength."""
        half = (self.active - self.passive) / 3
        return placed((i, -2 * half if i == upright else half) for i in range(3))

    def _size(self, deviatoric: Tensor) -> Array:
        """sqrt(J2) of a deviator (Pa) whose shear on horizontal planes is scaled."""
        ratio = (self.active + self.passive) / (2 * self.simple)
        pairs = ((s, i in SHEARS_OF_VERTICAL and not absent(s)) for i, s in enumerate(deviatoric))
        return safe_sqrt(second_invariant([ratio * s if on_horizontal else s for s, on_horizontal in pairs]))

    def _borne(self, rest: Tensor, upright: int) -> Tensor:
        """The deviator at rest (Pa) that the full strength bears, towards its middle from one that it does not bear.

        From beyond the strength less hardening would be a way out, so that the hardening of a step had two solutions.
        """
        centre, strength = self._failure_centre(upright), (self.active + self.passive) / 2
        beyond = by_component(lambda s, o: s if absent(s) else s - o, rest, centre)
        size = self._size(beyond)
        borne = size <= strength
        share = jnp.where(borne, 1.0, strength / jnp.where(borne, 1.0, size))
        return by_component(lambda s, o, r: r if absent(r) else o + share * s, beyond, centre, rest)


def _dimension(history: Mobilisation) -> int:
    return next(d for d, carried in CARRIED.items() if len(carried) == len(history.rest))


def mobilised(x: Array) -> Array:
    """Mobilised share of the strength at x = sqrt(g / failure_strain), at most 1."""
    return 2 * x / (1 + x * x)


class _Step(NamedTuple):
    """Trial deviator, deviator at rest (Pa), the law, x before the step, and the component of vertical stress."""

    trial: Tensor
    rest: Tensor
    law: AnisotropicUndrained
    before: Array
    upright: int

    def offset(self, k: Array) -> Tensor:
        """Centre of the criterion at the mobilised share k."""
        failed = self.law._failure_centre(self.upright)
        return by_component(lambda s, o: s if absent(s) else (1 - k) * s + k * o, self.rest, failed)

    def excess(self, x: Array) -> tuple[Array, Array]:
        """Share of the trial deviator from the centre that the criterion leaves, and the plastic shear strain then.

        The share is 1 within the criterion, where the strain goes on below 0, so that a root has no kink beside it.
        """
        k, law = mobilised(x), self.law
        from_centre = by_component(lambda s, o: s if absent(s) else s - o, self.trial, self.offset(k))
        t, size = law._size(from_centre), k * (law.active + law.passive) / 2
        none, within = t == 0, t <= size
        unscaled = jnp.where(none, 1.0, safe_sqrt(second_invariant(from_centre)) / jnp.where(none, 1.0, t))
        share = jnp.where(within, 1.0, size / jnp.where(within, 1.0, t))
        return share, (t - size) * unscaled / law.shear

    def residual(self, x: Array) -> Array:
        """Flow to the criterion at x, less the flow that mobilises x, over failure_strain."""
        return self.excess(x)[1] / self.law.failure_strain - (x * x - self.before**2)


def _root(step: _Step) -> Array:
    """Root x of the step's residual, which is above 0 at x before; 1 where it is above 0 there, too.

    Newton's steps stay within a bracket, which halves where they would leave it. The derivative is that of the implicit
    equation.
    """
    fixed = jax.tree.map(lambda leaf: leaf if isinstance(leaf, float | int) else jax.lax.stop_gradient(leaf), step)

    def narrowed(_: int, bracket: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, x = bracket
        value, slope = jax.jvp(fixed.residual, (x,), (jnp.ones_like(x),))
        low, high = jnp.where(value > 0, x, low), jnp.where(value > 0, high, x)
        newton = x - value / jnp.where(slope == 0, 1, slope)
        return low, high, jnp.where((newton >= low) & (newton <= high), newton, (low + high) / 2)

    low = jnp.broadcast_to(fixed.before, jnp.shape(fixed.trial[0]))
    one = jnp.ones_like(low)
    *_, x = jax.lax.fori_loop(0, ROUNDS, narrowed, (low, one, low))
    beyond = fixed.residual(one) > 0
    _, slope = jax.jvp(fixed.residual, (x,), (one,))
    return jnp.where(beyond, 1.0, x - step.residual(x) / jnp.where(slope == 0, 1, slope))
