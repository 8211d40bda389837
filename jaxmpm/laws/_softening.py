"""Loss of strength with plastic shear strain or over time, and its gain with the rate of strain.

The plastic shear strain g is engineering strain, sqrt(2 e:e) of the deviatoric plastic part: gamma in simple shear.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from jaxmpm.laws._parameter import Parameter
from jaxmpm.protocols import Tensor
from jaxmpm.support.check import Limit
from jaxmpm.support.pytrees import pytree
from jaxmpm.tensors import deviator, safe_sqrt, second_invariant

RATIO = Parameter(least=0.0, most=1.0)

NEWTON_STEPS = 8
"""From the residual branch Newton's steps fall monotonically to the root of a convex law; 8 reach rounding."""


@pytree
@dataclass(frozen=True)
class Softening:
    """Linear loss of undrained strength: S = max(S_0 - modulus g, residual_ratio S_0).

    Source: Jiang et al. (2024), doi:10.1016/j.compgeo.2024.106413, Eq. 23.

    Args:
        modulus: Pa per unit engineering shear strain, below the shear modulus.
        residual_ratio: residual over peak strength, in [0, 1].
    """

    modulus: Array
    residual_ratio: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "modulus": Parameter(above=0.0, unit="Pa", name="softening_modulus", per_band=True),
        "residual_ratio": RATIO,
    }

    def strength(self, peak: Array, g: Array) -> Array:
        """Strength (Pa) after the plastic shear strain g."""
        return jnp.maximum(peak - self.modulus * g, self.residual_ratio * peak)

    def flow(self, peak: Array, g: Array, trial: Array, shear: Array) -> Array:
        """Increment dg that solves trial - shear dg = S(g + dg), of either sign where the trial does not yield.

        Where the sloping branch would end below the residual strength, the flat one gives more flow. Where strength
        falls faster than the soil unloads, as a rate effect may have it, it falls to the flat one at once.

        Args:
            peak: strength S_0 (Pa).
            g: plastic shear strain before.
            trial: sqrt(J2) of the trial stress (Pa).
            shear: shear modulus (Pa).

        Returns:
            Increment dg.
        """
        stable = ~(shear <= self.modulus)
        sloping = (trial - self.strength(peak, g)) / jnp.where(stable, shear - self.modulus, 1.0)
        flat = (trial - self.residual_ratio * peak) / shear
        return jnp.where(stable, jnp.minimum(sloping, flat), flat)

    def steepest(self, peak: Array) -> Array:
        """Largest loss of strength per unit of g (Pa)."""
        return self.modulus


@pytree
@dataclass(frozen=True)
class ExponentialSoftening:
    """Exponential loss of undrained strength of sensitive clay: S = S_0 (r + (1 - r) exp(-3 g / strain_95)).

    Source: the softening part of Einav and Randolph (2005), doi:10.1002/nme.1350.

    Args:
        residual_ratio: r, remoulded over peak strength, in [0, 1].
        strain_95: plastic shear strain at which 95 % of the loss has happened.
    """

    residual_ratio: Array
    strain_95: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "residual_ratio": RATIO,
        "strain_95": Parameter(above=0.0, per_band=True),
    }

    def strength(self, peak: Array, g: Array) -> Array:
        """Strength (Pa) after the plastic shear strain g."""
        return peak * (self.residual_ratio + (1 - self.residual_ratio) * jnp.exp(-3 * g / self.strain_95))

    def flow(self, peak: Array, g: Array, trial: Array, shear: Array) -> Array:
        """Increment dg that solves trial - shear dg = S(g + dg), by Newton's method from above.

        Args:
            peak: strength S_0 (Pa).
            g: plastic shear strain before.
            trial: sqrt(J2) of the trial stress (Pa).
            shear: shear modulus (Pa).

        Returns:
            Increment dg.
        """
        dg = jnp.maximum((trial - self.residual_ratio * peak) / shear, 0)
        for _ in range(NEWTON_STEPS):
            strength = self.strength(peak, g + dg)
            slope = shear - 3 / self.strain_95 * (strength - self.residual_ratio * peak)
            # Never below 0: soil that does not yield would take exp beyond its range, and its derivative with it.
            dg = jnp.maximum(dg + (trial - shear * dg - strength) / slope, 0)
        return dg

    def steepest(self, peak: Array) -> Array:
        """Largest loss of strength per unit of g (Pa), at g = 0."""
        return 3 * (1 - self.residual_ratio) * peak / self.strain_95


@pytree
@dataclass(frozen=True)
class LossInTime:
    """Loss of undrained strength over time, whatever the strain: S = S_0 (1 - (1 - r) t / duration), at least r S_0.

    Sand that liquefies under shaking loses strength so: Seed (1979), doi:10.1680/geot.1979.29.3.215.

    Args:
        residual_ratio: r, strength that stays over strength at the start, in [0, 1].
        duration: of the loss, which begins with the run (s).
    """

    residual_ratio: Array
    duration: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "residual_ratio": RATIO,
        "duration": Parameter(above=0.0, unit="s", name="loss_time"),
    }

    def share(self, time: Array) -> Array:
        """Share of the strength that is left after a time of the run (s)."""
        return 1 - (1 - self.residual_ratio) * jnp.minimum(time / self.duration, 1)


@pytree
@dataclass(frozen=True)
class RateEffect:
    """Gain of strength with the rate of the total engineering shear strain.

    Source: Einav and Randolph (2005), doi:10.1002/nme.1350.

    Args:
        coefficient: relative gain per tenfold rate above the reference.
        reference_rate: rate up to which there is none (1/s).
    """

    coefficient: Array
    reference_rate: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "coefficient": Parameter(least=0.0, name="rate_coefficient"),
        "reference_rate": Parameter(above=0.0, unit="1/s"),
    }

    def factor(self, strain_increment: Tensor, dt: Array) -> Array:
        """Strength over that at the reference rate, for a strain increment within dt (s)."""
        rate = 2 * safe_sqrt(second_invariant(deviator(strain_increment))) / dt
        return 1 + self.coefficient * jnp.log(jnp.maximum(rate / self.reference_rate, 1)) / math.log(10)


class Decay(enum.Enum):
    """Form in which cohesion and friction decay from peak to residual over a plastic shear strain."""

    LINEAR = "linear"
    EXPONENTIAL = "exponential"


@pytree
@dataclass(frozen=True)
class FrictionalSoftening:
    """Cohesion, friction and dilation that decay with plastic shear strain, dilation to 0.

    A step takes the strength at its start.

    Args:
        cohesion: residual one (Pa).
        friction: residual angle (radians).
        strain: plastic shear strain at which LINEAR ends, and at which EXPONENTIAL, exp(-3 g/strain), has done 95 %.
        decay: form of the loss; static.
    """

    cohesion: Array
    friction: Array
    strain: Array
    decay: Decay = field(default=Decay.LINEAR, metadata={"static": True})

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "cohesion": Parameter(least=0.0, unit="Pa", name="residual_cohesion", reduced=True, at_most="cohesion"),
        "friction": Parameter(
            least=0.0, below=math.pi / 2, unit="rad", name="residual_friction", reduced=True, at_most="friction"
        ),
        "strain": Parameter(above=0.0, name="softening_strain", per_band=True),
    }

    def strength(self, cohesion: Array, friction: Array, dilation: Array, g: Array) -> tuple[Array, Array, Array]:
        """Cohesion (Pa), friction and dilation (rad) after the plastic shear strain g, from their peak values."""
        share = (
            jnp.exp(-3 * g / self.strain) if self.decay is Decay.EXPONENTIAL else jnp.maximum(1 - g / self.strain, 0)
        )
        return (
            self.cohesion + (cohesion - self.cohesion) * share,
            self.friction + (friction - self.friction) * share,
            dilation * share,
        )
