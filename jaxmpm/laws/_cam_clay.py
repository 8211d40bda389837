"""Modified Cam Clay: clay whose strength and volume follow from its effective stress and the largest that it has borne.

Signs in this module's formulas are those of critical state soil mechanics: the mean effective stress p and volumetric
strains are positive in compression.
"""

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
from jaxmpm.support.check import Limit, above_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import zeros_like
from jaxmpm.tensors import absent, by_component, deviator, mean, row_by_row, safe_sqrt, second_invariant

NEWTON_STEPS = 10
"""Newton's steps of a return; steps of an explicit scheme need three, strains of a hundredth at once eight."""


class Consolidation(NamedTuple):
    """History of Modified Cam Clay.

    Args:
        vertical: vertical effective stress of the soil at rest (N,) Pa, positive in compression.
        mean: its mean effective stress (N,) Pa, positive in compression.
        compaction: plastic volumetric strain since then (N,), positive in compression.
    """

    vertical: Array
    mean: Array
    compaction: Array


STIFFER = 8.0
"""Stiffness at which a limit load is sought, over that of soil that does not harden: near failure strains multiply."""


@pytree
@dataclass(frozen=True)
class ModifiedCamClay(Law):
    """Clay that yields on the ellipse q^2 / M^2 + p (p - p_c) = 0 with associated flow, and hardens with its volume.

    p_c at rest is that of virgin soil under ocr times the vertical stress at rest, with a horizontal stress of
    1 - sin(phi) of it, and at least the mean stress at rest. Plastic strain multiplies it by
    exp(compaction / (compression - swelling)). So soil that elastic loading by gravity has sheared beyond its strength
    yields from the first step on. Bulk modulus K = p / swelling and the shear modulus follow the mean stress; Poisson's
    ratio is constant. Stress is effective. The return is implicit, and M is the same in compression and extension.

    Sources: Roscoe and Burland (1968), On the generalized stress-strain behaviour of wet clay; Muir Wood (1990),
    doi:10.1017/CBO9781139878272, Chapter 5; implicit return: Borja and Lee (1990), doi:10.1016/0045-7825(90)90152-C.

    Every parameter is a number or one value per particle (N,).

    Args:
        bulk: largest elastic bulk modulus (Pa), that of soil under a mean stress of bulk times swelling and more; it
            limits the time step.
        shear: shear modulus at that bulk modulus (Pa); their ratio is kept.
        compression: slope lambda* of the virgin line, volumetric strain per ln p.
        swelling: slope kappa* of the swelling lines, likewise, below the compression.
        critical_state: M, q / p at the critical state.
        ocr: overconsolidation ratio, the largest vertical effective stress so far over that at rest.
        least_pressure: mean stress (Pa) below which stiffness and p_c do not fall, as at a free surface.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "compression": Parameter(above=0.0),
        "swelling": Parameter(above=0.0, at_most="compression"),
        "critical_state": Parameter(above=0.0, most=3.0, reduced=True),
        "ocr": Parameter(least=1.0),
        "least_pressure": above_zero("Pa"),
    }
    FRICTIONAL: ClassVar[bool] = True

    bulk: Array
    shear: Array
    compression: Array
    swelling: Array
    critical_state: Array
    ocr: Array
    least_pressure: Array

    def initial_history(self, particles: Particles) -> Consolidation:
        """Soil without stress at rest and without plastic strain."""
        none = zeros_like(particles.mass)
        return Consolidation(none, none, none)

    def history_at_rest(self, history: Consolidation, stress: Tensor) -> Consolidation:
        """The vertical and the mean stress at rest, from which p_c follows with the law's own numbers."""
        upright = 0 if absent(stress[5]) else 2  # in 1D the axis is that of gravity
        vertical, middle = (
            jnp.broadcast_to(jnp.maximum(-component, 0), history.mean.shape)
            for component in (stress[upright], mean(stress))
        )
        return history._replace(vertical=vertical, mean=middle)

    def stiffened(self, bulk: Array, shear: Array, pressure: Array) -> ModifiedCamClay:
        """The clay with STIFFER times these moduli (Pa) from a mean stress `pressure` (Pa) on, compression to match.

        At the critical state neither shows, and so long as the clay hardens its limit load is that of the critical
        state.
        """
        swelling = pressure / (STIFFER * bulk)
        moduli = {"bulk": STIFFER * bulk, "shear": STIFFER * shear}
        return replace(self, swelling=swelling, compression=2 * swelling, **moduli)

    def preconsolidation(self, history: Consolidation) -> Array:
        """Size p_c of the ellipse (N,) Pa."""
        m = self.critical_state
        sine = 3 * m / (6 + m)
        p, q = 1 - 2 * sine / 3, sine  # of virgin soil, over its vertical stress
        at_rest = jnp.maximum(self.ocr * history.vertical * (p + (q / m) ** 2 / p), history.mean)
        at_rest = jnp.maximum(at_rest, self.least_pressure)
        hardened = at_rest * jnp.exp(history.compaction / (self.compression - self.swelling))
        return jnp.maximum(hardened, self.least_pressure)

    def bulk_modulus(self, pressure: Array, compaction: Array | float = 0.0) -> Array:
        """Elastic bulk modulus (N,) Pa at a mean stress (Pa), its mean over a further volumetric strain."""
        middle = jnp.maximum(pressure, self.least_pressure) / self.swelling * (1 + compaction / (2 * self.swelling))
        return jnp.clip(middle, self.least_pressure / self.swelling, self.bulk)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Consolidation, dt: Array | None = None
    ) -> tuple[Tensor, Consolidation]:
        """Elastic predictor, and implicit return to the ellipse, which grows or shrinks meanwhile.

        Args:
            strain_increment: tensor, tension positive.
            stress: effective, tensor (Pa).
            history: consolidation so far.
            dt: not used.

        Returns:
            Stress (Pa) and history.
        """
        bulk = self.bulk_modulus(-mean(stress), -3 * mean(strain_increment))
        shear = bulk * (self.shear / self.bulk)
        trial = row_by_row(add(stress, elastic_increment(bulk, shear, strain_increment)))
        p, q = -mean(trial), safe_sqrt(3 * second_invariant(deviator(trial)))
        size, m = self.preconsolidation(history), self.critical_state
        elastic = (q / m) ** 2 + p * (p - size) <= 0
        ellipse = Ellipse(
            *(p / size, q / (m * size), 6 * shear / (bulk * m**2), bulk / size * (self.compression - self.swelling))
        )
        # Soil that does not yield stands in for itself with a stress on its ellipse, so that derivatives stay finite.
        safe = ellipse._replace(p=jnp.where(elastic, 1.0, ellipse.p), q=jnp.where(elastic, 0.0, ellipse.q))
        flow, growth = returned(safe)
        after = jnp.where(elastic, p, size * (safe.p + flow * jnp.exp(growth)) / (1 + 2 * flow))
        scale = jnp.where(elastic, 1.0, 1 / (1 + safe.stiffer * flow))
        xx, yy, zz, xy, yz, xz = by_component(lambda s: s if absent(s) else scale * s, deviator(trial))
        result = row_by_row((xx - after, yy - after, zz - after, xy, yz, xz))
        return result, history._replace(compaction=history.compaction + jnp.where(elastic, 0.0, (p - after) / bulk))


class Ellipse(NamedTuple):
    """Trial stress over the size of the ellipse before, and the moduli of a return.

    Args:
        p: mean trial stress over p_c.
        q: deviatoric trial stress over M p_c.
        stiffer: 6 G / (K M^2).
        hardening: K (compression - swelling) / p_c.
    """

    p: Array
    q: Array
    stiffer: Array
    hardening: Array


def returned(ellipse: Ellipse) -> tuple[Array, Array]:
    """Plastic multiplier times K, and logarithm of the growth of p_c, of the return to an ellipse.

    Newton's method solves both equations together, from the ellipse before. The derivative is that of one more step at
    the solution, which is the derivative of the implicit equations.

    Args:
        ellipse: trial stress and moduli.

    Returns:
        Multiplier and logarithm (N,).
    """
    fixed = jax.lax.stop_gradient(ellipse)

    def closer(_: int, at: tuple[Array, Array]) -> tuple[Array, Array]:
        flow, growth = _newton(fixed, *at)
        return jnp.maximum(flow, 0), growth

    none = jnp.zeros_like(fixed.p)
    flow, growth = jax.lax.fori_loop(0, NEWTON_STEPS, closer, (none, none))
    return _newton(ellipse, flow, growth, at=fixed)


def _newton(ellipse: Ellipse, flow: Array, growth: Array, at: Ellipse | None = None) -> tuple[Array, Array]:
    """A step from (flow, growth), with the slopes of `at`, by default of `ellipse`."""

    def residuals(ellipse: Ellipse, flow: Array, growth: Array) -> tuple[Array, Array]:
        size, wide = jnp.exp(growth), 1 + 2 * flow
        p, q = (ellipse.p + flow * size) / wide, ellipse.q / (1 + ellipse.stiffer * flow)
        return q * q + p * (p - size), growth - flow * (2 * ellipse.p - size) / (ellipse.hardening * wide)

    p0, q0, stiffer, hardening = ellipse if at is None else at
    size, wide, soft = jnp.exp(growth), 1 + 2 * flow, 1 + stiffer * flow
    p, q = (p0 + flow * size) / wide, q0 / soft
    p_flow, p_growth, over = (size - 2 * p) / wide, flow * size / wide, 2 * p0 - size
    yield_flow = -2 * stiffer * q * q / soft + (2 * p - size) * p_flow
    yield_growth = (2 * p - size) * p_growth - p * size
    hard_flow, hard_growth = -over / (hardening * wide**2), 1 + flow * size / (hardening * wide)
    off, grown = residuals(ellipse, flow, growth)
    determinant = yield_flow * hard_growth - yield_growth * hard_flow
    return (
        flow - (off * hard_growth - grown * yield_growth) / determinant,
        growth - (yield_flow * grown - hard_flow * off) / determinant,
    )
