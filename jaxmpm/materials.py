"""Constitutive laws: (parameters, strain increment, stress, history) -> (stress, history).

A law is a frozen pytree with `p_wave_modulus`, `initial_history` and `update`, see `jaxmpm.types.Material`.
Every parameter is a scalar or one value per particle. Tension is positive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

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


def _add(a: Tensor, b: Tensor) -> Tensor:
    return tuple(x + y for x, y in zip(a, b, strict=True))  # type: ignore[return-value]


@jax.tree_util.register_dataclass
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

    def update(self, strain_increment: Tensor, stress: Tensor, history: None) -> tuple[Tensor, None]:
        """Add the elastic increment."""
        return _add(stress, elastic_increment(self.bulk, self.shear, strain_increment)), None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Softening:
    """Linear loss of strength with plastic shear strain g: S = max(S_0 - modulus g, residual_ratio S_0).

    modulus: Pa per unit engineering shear strain, below the shear modulus. residual_ratio: in [0, 1].
    Source: Jiang et al. (2024), 10.1016/j.compgeo.2024.106413, Eq. 23.
    """

    modulus: Array
    residual_ratio: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class J2:
    """Undrained soil: elastic, yielding where sqrt(J2) reaches the shear strength (Drucker-Prager without friction).

    In plane strain this is Tresca's criterion. bulk, shear: Pa. strength: peak undrained shear strength S_u (Pa).
    softening: None keeps the peak. tension_cutoff: largest mean stress (Pa); None sets no limit.
    The history variable is the accumulated engineering plastic shear strain g (in simple shear, the plastic
    part of gamma), kept only where the soil softens.
    """

    bulk: Array
    shear: Array
    strength: Array
    softening: Softening | None = None
    tension_cutoff: Array | None = None

    @property
    def p_wave_modulus(self) -> Array:
        """K + 4G/3 (Pa)."""
        return self.bulk + 4 * self.shear / 3

    def initial_history(self, particles: Particles) -> Array | None:
        """No plastic strain yet; None without softening."""
        return None if self.softening is None else jnp.zeros_like(particles.mass)

    def update(self, strain_increment: Tensor, stress: Tensor, history: Array | None) -> tuple[Tensor, Array | None]:
        """Elastic predictor and implicit radial return.

        With t the trial sqrt(J2), plastic flow of dg lowers it by G dg, and softening lowers the strength by
        H dg, so that on the sloping branch dg = (t - S(g)) / (G - H), and on the residual one (t - S_r) / G.
        """
        trial = _add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        t = safe_sqrt(second_invariant(deviator(trial)))
        if self.softening is None or history is None:
            strength = self.strength
            yielding = t > strength
        else:
            h = self.softening.modulus
            residual = self.softening.residual_ratio * self.strength
            current = jnp.maximum(self.strength - h * history, residual)
            yielding = t > current
            sloping = (t - current) / (self.shear - h)
            flat = (t - residual) / self.shear
            # Where the sloping branch would end below the residual strength, the flat one gives more flow.
            dg = jnp.where(yielding, jnp.maximum(jnp.minimum(sloping, flat), 0), 0)
            strength = jnp.where(yielding, t - self.shear * dg, current)
            history = history + dg
        scale = jnp.where(yielding, strength / jnp.where(yielding, t, 1.0), 1.0)
        pressure = mean(trial)
        xx, yy, zz, xy, yz, xz = (scale * s for s in deviator(trial))
        if self.tension_cutoff is not None:
            pressure = jnp.minimum(pressure, self.tension_cutoff)
        return (xx + pressure, yy + pressure, zz + pressure, xy, yz, xz), history


def reduce_strength(material: J2, factor: Array) -> J2:
    """Divide peak and residual strength by `factor` (the strength reduction method); the softening modulus stays."""
    return J2(material.bulk, material.shear, material.strength / factor, material.softening, material.tension_cutoff)
