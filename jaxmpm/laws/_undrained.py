"""Constitutive laws: (parameters, strain increment, stress, history) -> (stress, history).

A law is a frozen pytree with `p_wave_modulus`, `initial_history` and `update`, see `jaxmpm.types.Material`. For
strength reduction it also has `reduced`, and STRENGTH, the names of the parameters that this changes.
Every parameter is a scalar or one value per particle. Tension is positive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from foundation.pytrees import pytree
from jaxmpm.laws._softening import ExponentialSoftening, RateEffect, Softening
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant
from jaxmpm.types import Particles, Tensor


def elastic_increment(bulk: Array, shear: Array, strain_increment: Tensor) -> Tensor:
    """Stress increment (Pa) of isotropic linear elasticity, K tr(de) I + 2 G dev(de)."""
    volumetric = bulk * 3 * mean(strain_increment)
    xx, yy, zz, xy, yz, xz = deviator(strain_increment)
    twice: Any = 2 * shear
    return (
        twice * xx + volumetric,
        twice * yy + volumetric,
        twice * zz + volumetric,
        twice * xy,
        twice * yz,
        twice * xz,
    )


def add(a: Tensor, b: Tensor) -> Tensor:
    """Sum of two tensors."""
    return tuple(x + y for x, y in zip(a, b, strict=True))  # type: ignore[return-value]


@pytree
@dataclass(frozen=True)
class Elastic:
    """Isotropic linear (hypo)elasticity. bulk, shear: moduli K and G (Pa)."""

    bulk: Array
    shear: Array

    @property
    def p_wave_modulus(self) -> Array:
        """K + 4G/3 (Pa)."""
        return self.bulk + 4 * self.shear / 3

    def initial_history(self, particles: Particles) -> None:
        """Elasticity has no history."""

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: None, dt: Array | None = None
    ) -> tuple[Tensor, None]:
        """Add the elastic increment."""
        return add(stress, elastic_increment(self.bulk, self.shear, strain_increment)), None


@pytree
@dataclass(frozen=True)
class J2:
    """Undrained soil: elastic, yielding where sqrt(J2) reaches the shear strength (Drucker-Prager without friction).

    In plane strain this is Tresca's criterion. bulk, shear: Pa. strength: peak undrained shear strength S_u (Pa).
    softening: None keeps the peak. tension_cutoff: largest mean stress (Pa); None sets no limit.
    rate: how strength rises with the rate of shear; None is rate-independent.
    The history variable is the accumulated engineering plastic shear strain g (in simple shear, the plastic
    part of gamma), kept only where the soil softens.
    """

    STRENGTH: ClassVar = ("strength",)

    bulk: Array
    shear: Array
    strength: Array
    softening: Softening | ExponentialSoftening | None = None
    tension_cutoff: Array | None = None
    rate: RateEffect | None = None

    @property
    def p_wave_modulus(self) -> Array:
        """K + 4G/3 (Pa)."""
        return self.bulk + 4 * self.shear / 3

    def initial_history(self, particles: Particles) -> Array | None:
        """No plastic strain yet; None without softening."""
        return None if self.softening is None else jnp.zeros_like(particles.mass)

    def reduced(self, factor: Array) -> J2:
        """Peak and residual strength divided by `factor`; the softening modulus stays."""
        return replace(self, strength=self.strength / factor)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Array | None, dt: Array | None = None
    ) -> tuple[Tensor, Array | None]:
        """Elastic predictor and implicit radial return.

        With t the trial sqrt(J2), plastic flow of dg lowers it by G dg: the softening law solves t - G dg = S(g + dg).
        A rate factor on S divides t and G there.
        """
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        t = safe_sqrt(second_invariant(deviator(trial)))
        rate: Any = 1.0
        if self.rate is not None:
            if dt is None:
                raise ValueError("a rate effect needs the time step: call update(..., dt)")
            rate = self.rate.factor(strain_increment, dt)
        if self.softening is None or history is None:
            strength = self.strength * rate
            yielding = t > strength
        else:
            current = self.softening.strength(self.strength, history) * rate
            yielding = t > current
            flow = self.softening.flow(self.strength, history, t / rate, self.shear / rate)
            dg = jnp.where(yielding, jnp.maximum(flow, 0), 0)
            strength = jnp.where(yielding, t - self.shear * dg, current)
            history = history + dg
        scale = jnp.where(yielding, strength / jnp.where(yielding, t, 1.0), 1.0)
        pressure = mean(trial)
        xx, yy, zz, xy, yz, xz = (scale * s for s in deviator(trial))
        if self.tension_cutoff is not None:
            pressure = jnp.minimum(pressure, self.tension_cutoff)
        return (xx + pressure, yy + pressure, zz + pressure, xy, yz, xz), history


def reduce_strength(material: Any, factor: Array) -> Any:
    """The strength reduction method: a law's peak and residual strength, tan(phi) too, divided by `factor`."""
    return material.reduced(factor)
