"""Undrained and elastic soil.

A law is a function (parameters, strain increment, stress, history) -> (stress, history); `jaxmpm.Material` names its
members. Every parameter is a number or one value per particle (N,). Tension is positive.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import singledispatch
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Particles
from jaxmpm.laws._base import Law
from jaxmpm.laws._parameter import Parameter
from jaxmpm.laws._softening import ExponentialSoftening, LossInTime, RateEffect, Softening
from jaxmpm.protocols import Component, Tensor
from jaxmpm.support.check import Limit, from_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import zeros_like
from jaxmpm.tensors import absent, by_component, deviator, mean, row_by_row, safe_sqrt, second_invariant


def elastic_increment(bulk: Array, shear: Array, strain_increment: Tensor) -> Tensor:
    """Stress increment of isotropic linear elasticity, K tr(de) I + 2 G dev(de).

    Args:
        bulk: modulus K (Pa).
        shear: modulus G (Pa).
        strain_increment: tensor de.

    Returns:
        Tensor (Pa).
    """
    volumetric = bulk * 3 * mean(strain_increment)
    xx, yy, zz, xy, yz, xz = deviator(strain_increment)
    twice: Component = 2 * shear
    return (
        twice * xx + volumetric,
        twice * yy + volumetric,
        twice * zz + volumetric,
        twice * xy,
        twice * yz,
        twice * xz,
    )


def elastic_strain(bulk: Array, shear: Array, stress: Tensor) -> Tensor:
    """Strain of isotropic linear elasticity under a stress: the inverse of `elastic_increment`.

    Args:
        bulk: modulus K (Pa).
        shear: modulus G (Pa).
        stress: tensor (Pa).

    Returns:
        Strain tensor.
    """
    volumetric = mean(stress) / (3 * bulk)
    xx, yy, zz, xy, yz, xz = by_component(lambda s: s if absent(s) else s / (2 * shear), deviator(stress))
    return (xx + volumetric, yy + volumetric, zz + volumetric, xy, yz, xz)


def add(a: Tensor, b: Tensor) -> Tensor:
    """Sum of two tensors.

    Args:
        a: six components.
        b: six components.

    Returns:
        Tensor.
    """
    return by_component(operator.add, a, b)


@pytree
@dataclass(frozen=True)
class Elastic(Law):
    """Isotropic linear (hypo)elasticity.

    Args:
        bulk: modulus K (Pa).
        shear: modulus G (Pa).
    """

    bulk: Array
    shear: Array

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: None, dt: Array | None = None
    ) -> tuple[Tensor, None]:
        """The stress with the elastic increment added."""
        return add(stress, elastic_increment(self.bulk, self.shear, strain_increment)), None


@pytree
@dataclass(frozen=True)
class J2(Law):
    """Undrained soil: elastic, yielding where sqrt(J2) reaches the shear strength (Drucker-Prager without friction).

    In plane strain this is Tresca's criterion. The history variable is the accumulated engineering plastic shear strain
    g (in simple shear, the plastic part of gamma); it exists only if the soil softens. Strength reduction divides the
    peak and with it the residual strength; the softening modulus stays.

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        strength: peak undrained shear strength S_u (Pa).
        softening: loss of strength with plastic strain; None for none.
        tension_cutoff: largest mean stress (Pa); None sets no limit.
        rate: gain of strength with the rate of shear; None for none.
        gap_memory: whether soil that the cutoff has opened closes its gap before it bears pressure, see
            `jaxmpm.laws.update_with_gap`; static.
        viscosity: Bingham's plastic viscosity eta (Pa s): at yield sqrt(J2) is S_u + eta times the rate of g. None for
            none.
        loss: of strength over time, for which `at_time` gives the law of a step; None for none.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "strength": Parameter(above=0.0, unit="Pa", reduced=True),
        "tension_cutoff": from_zero("Pa"),
        "viscosity": from_zero("Pa s"),
    }

    bulk: Array
    shear: Array
    strength: Array
    softening: Softening | ExponentialSoftening | None = None
    tension_cutoff: Array | None = None
    rate: RateEffect | None = None
    gap_memory: bool = field(default=True, metadata={"static": True})
    viscosity: Array | None = None
    loss: LossInTime | None = None

    def initial_history(self, particles: Particles) -> Array | None:
        """Plastic strain (N,) of 0; None without softening."""
        return None if self.softening is None else zeros_like(particles.mass)

    @property
    def steepest_softening(self) -> Array | None:
        """Largest loss of strength per unit of plastic shear strain (Pa); None without softening."""
        return None if self.softening is None else self.softening.steepest(self.strength)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Array | None, dt: Array | None = None
    ) -> tuple[Tensor, Array | None]:
        """Elastic predictor and implicit radial return.

        With t the trial sqrt(J2), plastic flow of dg lowers it by G dg; the softening law solves t - G dg = S(g + dg).
        A rate factor on S divides t and G there. A viscosity adds eta dg / dt to the right side, that is eta / dt to G.

        Args:
            strain_increment: tensor, tension positive.
            stress: tensor (Pa).
            history: (N,) plastic shear strain, or None.
            dt: duration of the increment (s); a rate effect and a viscosity need it.

        Returns:
            Stress (Pa) and history.

        Raises:
            ValueError: If there is a rate effect or a viscosity, and no dt, or strength is lost over time.
        """
        if self.loss is not None:
            raise ValueError("strength is lost over time: update the law of that time, at_time(law, time)")
        # Stored first: XLA on CPU would compute it anew for every use.
        trial = row_by_row(add(stress, elastic_increment(self.bulk, self.shear, strain_increment)))
        t = safe_sqrt(second_invariant(deviator(trial)))
        rate: Component = 1.0
        resistance = self.shear
        if self.rate is not None or self.viscosity is not None:
            if dt is None:
                effect = "viscosity" if self.rate is None else "rate effect"
                raise ValueError(f"a {effect} needs the time step: call update(..., dt)")
            rate = 1.0 if self.rate is None else self.rate.factor(strain_increment, dt)
            resistance = self.shear if self.viscosity is None else self.shear + self.viscosity / dt
        if self.softening is None or history is None:
            strength = self.strength * rate
            yielding = ~(t <= strength)  # also where the strength is NaN, which so reaches the stress
            if self.viscosity is not None:
                strength = t - self.shear / resistance * (t - strength)
        else:
            current = self.softening.strength(self.strength, history) * rate
            yielding = ~(t <= current)
            flow = self.softening.flow(self.strength, history, t / rate, resistance / rate)
            dg = jnp.where(yielding, jnp.maximum(flow, 0), 0)
            strength = jnp.where(yielding, t - self.shear * dg, current)
            history = history + dg
        scale = jnp.where(yielding, strength / jnp.where(yielding, t, 1.0), 1.0)
        pressure = mean(trial)
        xx, yy, zz, xy, yz, xz = (scale * s for s in deviator(trial))
        if self.tension_cutoff is not None:
            pressure = jnp.minimum(pressure, self.tension_cutoff)
        return (xx + pressure, yy + pressure, zz + pressure, xy, yz, xz), history


@singledispatch
def at_time(law: Any, time: Array) -> Any:
    """The law with the strength that it has at a time; laws that lose none over time are unchanged.

    Args:
        law: a law.
        time: since the start of the run (s).

    Returns:
        A law that loses no strength over time.
    """
    return law


@at_time.register
def _(law: J2, time: Array) -> J2:
    return law if law.loss is None else replace(law, strength=law.strength * law.loss.share(time), loss=None)
