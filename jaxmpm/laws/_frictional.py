"""Soil with cohesion and friction: Drucker-Prager's cone and Mohr-Coulomb's pyramid, with dilation and tension cutoff.

Tension is positive, so the mean stress p of a loaded soil is negative. The history variable is the accumulated
engineering plastic shear strain g; it exists only if the soil softens.
"""

from __future__ import annotations

import enum
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from foundation.check import Limit, from_zero
from foundation.pytrees import pytree
from jaxmpm.laws._base import Law
from jaxmpm.laws._parameter import Parameter
from jaxmpm.laws._softening import FrictionalSoftening
from jaxmpm.laws._spectral import isotropic
from jaxmpm.laws._undrained import add, elastic_increment
from jaxmpm.tensors import by_component, deviator, mean, row_by_row, safe_sqrt, second_invariant
from jaxmpm.types import Particles, Tensor

SMALLEST = 1e-6
"""Least sine of friction in the position of the apex, which is then too far out to be reached."""


PARAMETERS = {
    "cohesion": Parameter(least=0.0, unit="Pa", reduced=True),
    "friction": Parameter(least=0.0, below=math.pi / 2, unit="rad", reduced=True),
    "dilation": Parameter(least=0.0, below=math.pi / 2, unit="rad", at_most="friction"),
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
        dilation: angle (radians), at most the friction.
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
    gap_memory: bool = field(default=True, metadata={"static": True, "absent": False})

    def initial_history(self, particles: Particles) -> Array | None:
        """Plastic strain (N,) of 0; None without softening."""
        return None if self.softening is None else jnp.zeros_like(particles.mass)

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
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        slope, intercept, dilation = cone(self.matching, *_strength(self, history))
        p, q = mean(trial), safe_sqrt(second_invariant(deviator(trial)))
        flow = jnp.maximum(q + slope * p - intercept, 0) / (self.shear + self.bulk * slope * dilation)
        largest = intercept / jnp.maximum(slope, SMALLEST)
        if self.tension_cutoff is not None:
            largest = jnp.minimum(largest, self.tension_cutoff)
        on_cone = p - self.bulk * dilation * flow
        cut = on_cone > largest
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
        dilation: angle (radians), at most the friction.
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
    gap_memory: bool = field(default=True, metadata={"static": True, "absent": False})

    def initial_history(self, particles: Particles) -> Array | None:
        """Plastic strain (N,) of 0; None without softening."""
        return None if self.softening is None else jnp.zeros_like(particles.mass)

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


class PyramidLaw(NamedTuple):
    """Parameters of a return to the pyramid, per particle.

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        cohesion: Pa.
        friction: angle (radians).
        dilation: angle (radians).
        tension: largest principal stress (Pa); None without a cutoff.
    """

    bulk: Array
    shear: Array
    cohesion: Array
    friction: Array
    dilation: Array
    tension: Array | None = None


def principal_drop(x1: Array, x2: Array, x3: Array, law: PyramidLaw) -> tuple[Array, Array, Array, Array]:
    """Excess of the principal trial stresses over the pyramid, and the plastic shear strain.

    The pyramid consists of planes, so every set of active planes gives a return in closed form: the main plane, its two
    edges, the apex, and with a cutoff the tension planes and their edges with it. The right return satisfies all planes
    with multipliers of the right sign. The function takes the one that violates these conditions least, so it needs no
    tolerance, and the stress is continuous where regions meet.

    Sources: de Souza Neto, Peric and Owen (2008), doi:10.1002/9780470694626, Section 8.2; several active planes: Koiter
    (1953), doi:10.1090/qam/59769.

    Args:
        x1: largest trial stress (Pa), (N,).
        x2: middle one (Pa), (N,).
        x3: least one (Pa), (N,).
        law: parameters of the return.

    Returns:
        Three differences between trial stress and result (Pa), and the plastic shear strain.
    """
    bulk, shear, cohesion, friction, dilation, tension = law
    s, r = jnp.sin(friction), jnp.sin(dilation)
    a, b = bulk + 4 * shear / 3, bulk - 2 * shear / 3
    limit = 2 * cohesion * jnp.cos(friction)
    apex = cohesion * jnp.cos(friction) / jnp.maximum(s, SMALLEST)
    x = (x1, x2, x3)

    def beyond(y1: Array, y3: Array) -> Array:
        return y1 * (1 + s) - y3 * (1 - s) - limit

    def stress(m1: Any, m2: Any, m3: Any) -> tuple[Any, Any, Any]:
        """Trial stress less the elastic stress of a plastic strain."""
        total = b * (m1 + m2 + m3)
        return tuple(xi - total - 2 * shear * m for xi, m in zip(x, (m1, m2, m3), strict=True))

    def strain(y: Sequence[Any]) -> tuple[Any, Any, Any]:
        """Plastic strain between the trial stress and y."""
        d = [xi - yi for xi, yi in zip(x, y, strict=True)]
        total = sum(d) * b / (3 * bulk)
        return tuple((di - total) / (2 * shear) for di in d)

    # Each return: its stress, and its strains, which must not be negative.
    same = 4 * shear * (1 + s * r) + 4 * b * s * r
    right = 2 * shear * (1 - s) * (1 - r) + 4 * b * s * r
    left = 2 * shear * (1 + s) * (1 + r) + 4 * b * s * r
    f13, f23, f12 = beyond(x1, x3), beyond(x2, x3), beyond(x1, x2)
    main = f13 / same
    returns = [(stress((1 + r) * main, 0, -(1 - r) * main), [main])]
    with_23 = [(same * f - right * g) / (same**2 - right**2) for f, g in ((f13, f23), (f23, f13))]
    returns.append((stress((1 + r) * with_23[0], (1 + r) * with_23[1], -(1 - r) * sum(with_23)), with_23))
    with_12 = [(same * f - left * g) / (same**2 - left**2) for f, g in ((f13, f12), (f12, f13))]
    returns.append((stress((1 + r) * sum(with_12), -(1 - r) * with_12[1], -(1 - r) * with_12[0]), with_12))
    e1, _, e3 = e = strain((apex, apex, apex))
    returns.append(((apex,) * 3, [(1 - r) * sum(e) + 2 * r * e3, (1 + r) * sum(e) - 2 * r * e1]))
    if tension is not None:
        tension = jnp.minimum(tension, apex)
        returns += _cut_off(
            x, tension, (tension * (1 + s) - limit) / (1 - s), a=a, b=b, r=r, stress=stress, strain=strain
        )

    def violation(y: Sequence[Any], multipliers: Sequence[Any]) -> Array:
        high, low = partial(_largest, y), -_largest([-yi for yi in y])
        terms = [beyond(high(), low), y[1] - y[0], y[2] - y[1], *(-2 * shear * m for m in multipliers)]
        return _largest(terms if tension is None else [*terms, high() - tension])

    best: Sequence[Array] = returns[0][0]
    least = violation(*returns[0])
    for y, multipliers in returns[1:]:
        worse = violation(y, multipliers)
        better = worse < least
        best = tuple(jnp.where(better, new, old) for new, old in zip(y, best, strict=True))
        least = jnp.where(better, worse, least)
    elastic = f13 <= 0 if tension is None else (f13 <= 0) & (x1 <= tension)
    drop = [jnp.where(elastic, 0, xi - yi) for xi, yi in zip(x, best, strict=True)]
    m = sum(drop) / 3
    deviatoric = [(d - m) / (2 * shear) for d in drop]
    return drop[0], drop[1], drop[2], safe_sqrt(2 * (deviatoric[0] ** 2 + deviatoric[1] ** 2 + deviatoric[2] ** 2))


def _largest(values: Sequence[Any]) -> Array:
    result = values[0]
    for value in values[1:]:
        result = jnp.maximum(result, value)
    return result


def _cut_off(
    x: Sequence[Array],
    t: Array,
    low: Array,
    *,
    a: Array,
    b: Array,
    r: Array,
    stress: Callable[..., tuple[Any, Any, Any]],
    strain: Callable[..., tuple[Any, Any, Any]],
) -> list[tuple[Any, list[Any]]]:
    """Returns to the tension planes at t, alone and with the pyramid; they intersect it at the least stress `low`."""
    det = a * a - b * b
    one = (x[0] - t) / a
    two = [(a * (x[i] - t) - b * (x[1 - i] - t)) / det for i in (0, 1)]
    returns = [(stress(one, 0, 0), [one]), (stress(*two, 0), two), ((t, t, t), list(strain((t, t, t))))]
    # One tension plane and the main plane: no strain along axis 2.
    first, third = ((a * d - b * c) / det for d, c in ((x[0] - t, x[2] - low), (x[2] - low, x[0] - t)))
    shearing = -third / (1 - r)
    returns.append((stress(first, 0, third), [shearing, first - (1 + r) * shearing]))
    # One tension plane on the edge where the two lesser stresses are equal.
    e = strain((t, low, low))
    pair = [-e[1] / (1 - r), -e[2] / (1 - r)]
    returns.append(((t, low, low), [*pair, e[0] - (1 + r) * sum(pair)]))
    # Two tension planes on the edge where the two greater stresses are equal; shear may go to either.
    e = strain((t, t, low))
    shearing = -e[2] / (1 - r)
    returns.append(((t, t, low), [shearing, e[0], e[1], e[0] + e[1] - (1 + r) * shearing]))
    return returns
