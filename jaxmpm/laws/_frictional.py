"""Soil with cohesion and friction: Drucker-Prager's cone and Mohr-Coulomb's pyramid, with dilation and tension cutoff.

Tension is positive, so the mean stress p of a loaded soil is negative. The history variable is the accumulated
engineering plastic shear strain g; it exists only if the soil softens.
"""

from __future__ import annotations

import enum
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.grid import Particles
from jaxmpm.laws._base import Law
from jaxmpm.laws._parameter import Parameter
from jaxmpm.laws._pyramid import SMALLEST, PyramidLaw, principal_drop
from jaxmpm.laws._softening import FrictionalSoftening
from jaxmpm.laws._spectral import isotropic
from jaxmpm.laws._undrained import add, elastic_increment
from jaxmpm.protocols import Tensor
from jaxmpm.support.check import Limit, from_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import zeros_like
from jaxmpm.tensors import by_component, deviator, mean, row_by_row, safe_sqrt, second_invariant

PARAMETERS = {
    "cohesion": Parameter(least=0.0, unit="Pa", reduced=True),
    "friction": Parameter(least=0.0, below=math.pi / 2, unit="rad", reduced=True),
    "dilation": Parameter(least=-math.pi / 12, below=math.pi / 2, unit="rad", at_most="friction"),
    "tension_cutoff": from_zero("Pa"),
}


class Matching(enum.Enum):
    """Points at which the Drucker-Prager cone meets Mohr-Coulomb's pyramid.

    PLANE_STRAIN matches at failure in plane strain, for any dilation; COMPRESSION at the edges of triaxial compression
    (the outer cone); EXTENSION at those of triaxial extension.
    """

    PLANE_STRAIN = "plane strain"
    COMPRESSION = "compression"
    EXTENSION = "extension"


def cone(matching: Matching, cohesion: Array, friction: Array, dilation: Array) -> tuple[Array, Array, Array]:
    """Parameters of the cone sqrt(J2) + slope p = intercept that matches Mohr-Coulomb's pyramid.

    In plane strain no plastic flow leaves the plane at failure. With the cone's dilation b = sin(psi) D,
    D = 1 / sqrt(1 + sin(psi)^2 / 3), the out-of-plane stress differs by -2/3 b sqrt(J2) from the mean, and the slope is
    sin(phi) / (D + sin(phi) b / 3). Without dilation that is sin(phi), with full dilation the inner cone.

    Sources: edges: de Souza Neto, Peric and Owen (2008), doi:10.1002/9780470694626, Section 6.4; flow at failure: Davis
    (1968), Theories of plasticity and the failure of soil masses.

    Args:
        matching: where cone and pyramid meet.
        cohesion: Pa, () or (N,).
        friction: radians, () or (N,).
        dilation: radians, () or (N,).

    Returns:
        Slope, intercept (Pa) and dilation of the cone.
    """
    sine, dilating = jnp.sin(friction), jnp.sin(dilation)
    if matching is Matching.PLANE_STRAIN:
        d = 1 / jnp.sqrt(1 + dilating**2 / 3)
        scale = 1 / (d + sine * dilating * d / 3)
        return scale * sine, scale * jnp.cos(friction) * cohesion, dilating * d
    sign = -1 if matching is Matching.COMPRESSION else 1
    scale = 2 * jnp.sqrt(3.0).astype(jnp.result_type(sine)) / (3 + sign * sine)
    return (
        scale * sine,
        scale * jnp.cos(friction) * cohesion,
        2 * jnp.sqrt(3.0).astype(jnp.result_type(sine)) * dilating / (3 + sign * dilating),
    )


@pytree
@dataclass(frozen=True)
class DruckerPrager(Law):
    """Elastic soil that yields on a cone matched to Mohr-Coulomb.

    Every parameter is a number or one value per particle (N,).

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        cohesion: Pa.
        friction: angle (radians).
        dilation: angle (radians), at most the friction; below 0 soil contracts as it is sheared.
        softening: loss of strength with plastic strain; None for none.
        tension_cutoff: largest mean stress (Pa); None for that of the cone's apex.
        matching: where the cone meets the pyramid; static.
        gap_memory: as for `J2`; static.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = PARAMETERS
    FRICTIONAL: ClassVar[bool] = True

    bulk: Array
    shear: Array
    cohesion: Array
    friction: Array
    dilation: Array
    softening: FrictionalSoftening | None = None
    tension_cutoff: Array | None = None
    matching: Matching = field(default=Matching.PLANE_STRAIN, metadata={"static": True})
    gap_memory: bool = field(default=True, metadata={"static": True})

    def stands_to(self, slope: float) -> Array | None:
        """Reduction factor at which soil without cohesion stands no more on a plane of a slope (rise over run).

        None with cohesion, and of a cone that meets the pyramid elsewhere than in plane strain.
        """
        alike = self.matching is Matching.PLANE_STRAIN
        return None if not alike or np.any(self.cohesion) else jnp.tan(self.friction) / slope

    def initial_history(self, particles: Particles) -> Array | None:
        """Plastic strain (N,) of 0; None without softening."""
        return None if self.softening is None else zeros_like(particles.mass)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Array | None, dt: Array | None = None
    ) -> tuple[Tensor, Array | None]:
        """Elastic predictor, then return to the cone, or to the corner or cap where the mean stress is cut off.

        Args:
            strain_increment: tensor, tension positive.
            stress: tensor (Pa).
            history: (N,) plastic shear strain, or None.
            dt: not used.

        Returns:
            Stress (Pa) and history.
        """
        trial = row_by_row(add(stress, elastic_increment(self.bulk, self.shear, strain_increment)))
        slope, intercept, dilation = cone(self.matching, *_strength(self, history))
        p, q = mean(trial), safe_sqrt(second_invariant(deviator(trial)))
        flow = jnp.maximum(q + slope * p - intercept, 0) / (self.shear + self.bulk * slope * dilation)
        largest = intercept / jnp.maximum(slope, SMALLEST)
        if self.tension_cutoff is not None:
            largest = jnp.minimum(largest, self.tension_cutoff)
        on_cone = p - self.bulk * dilation * flow
        cut = ~(on_cone <= largest)  # also where a number is NaN, which so reaches the stress
        mean_stress = jnp.where(cut, largest, on_cone)
        shear_stress = jnp.where(
            cut, jnp.minimum(q, jnp.maximum(intercept - slope * largest, 0)), q - self.shear * flow
        )
        scale = jnp.where(q > 0, shear_stress / jnp.where(q > 0, q, 1), 1)
        xx, yy, zz, xy, yz, xz = (scale * s for s in deviator(trial))
        result = row_by_row((xx + mean_stress, yy + mean_stress, zz + mean_stress, xy, yz, xz))
        if history is None:
            return result, None
        return result, history + (q - shear_stress) / self.shear


@pytree
@dataclass(frozen=True)
class MohrCoulomb(Law):
    """Elastic soil that yields on Mohr-Coulomb's pyramid, non-associated, with a cutoff of principal tension.

    Every parameter is a number or one value per particle (N,).

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        cohesion: Pa.
        friction: angle (radians).
        dilation: angle (radians), at most the friction; below 0 soil contracts as it is sheared.
        softening: loss of strength with plastic strain; None for none.
        tension_cutoff: largest principal stress (Pa), with associated flow; None for that of the apex.
        gap_memory: as for `J2`, of soil that opens along all axes; static.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = PARAMETERS
    FRICTIONAL: ClassVar[bool] = True

    bulk: Array
    shear: Array
    cohesion: Array
    friction: Array
    dilation: Array
    softening: FrictionalSoftening | None = None
    tension_cutoff: Array | None = None
    gap_memory: bool = field(default=True, metadata={"static": True})

    def stands_to(self, slope: float) -> Array | None:
        """Reduction factor at which soil without cohesion stands no more on a plane of a slope (rise over run)."""
        return None if np.any(self.cohesion) else jnp.tan(self.friction) / slope

    def initial_history(self, particles: Particles) -> Array | None:
        """Plastic strain (N,) of 0; None without softening."""
        return None if self.softening is None else zeros_like(particles.mass)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Array | None, dt: Array | None = None
    ) -> tuple[Tensor, Array | None]:
        """Elastic predictor, then return to the pyramid in principal stresses: see `principal_drop`.

        Args:
            strain_increment: tensor, tension positive.
            stress: tensor (Pa).
            history: (N,) plastic shear strain, or None.
            dt: not used.

        Returns:
            Stress (Pa) and history.
        """
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        law = PyramidLaw(self.bulk, self.shear, *_strength(self, history), tension=self.tension_cutoff)
        law = jax.tree.map(lambda p: jnp.asarray(p, jnp.result_type(self.bulk)), law)
        drop, g = isotropic(principal_drop, trial, law)
        result = row_by_row(by_component(operator.sub, trial, drop))
        return result, None if history is None else history + g


def _strength(material: DruckerPrager | MohrCoulomb, history: Array | None) -> tuple[Array, Array, Array]:
    peak = material.cohesion, material.friction, material.dilation
    return peak if material.softening is None or history is None else material.softening.strength(*peak, history)
