"""Dense granular flow: friction that grows with the rate of shear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from jaxmpm.laws._base import Law
from jaxmpm.laws._parameter import Parameter
from jaxmpm.laws._undrained import add, elastic_increment
from jaxmpm.protocols import Tensor
from jaxmpm.support.check import Limit, above_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.tensors import absent, by_component, deviator, mean, row_by_row, safe_sqrt, second_invariant, with_mean

ANGLE = Parameter(least=0.0, below=math.pi / 2, unit="rad", reduced=True)


@pytree
@dataclass(frozen=True)
class MuI(Law):
    """Dry grains with the friction mu(I) = mu_s + (mu_2 - mu_s) / (1 + I_0 / I), elastic below it.

    I = g_dot d sqrt(rho_s / p) is the inertial number of the plastic shear rate g_dot. sqrt(J2) is at most mu(I) p,
    with p the pressure; flow keeps its volume. Grains bear no tension: they come apart, and bear pressure again where
    the gap has closed, as for `J2` with a tension cutoff of 0.

    Sources: Jop, Forterre and Pouliquen (2006), doi:10.1038/nature04801, Eqs. 1 and 2; the implicit step in closed
    form: Dunatunga and Kamrin (2015), doi:10.1017/jfm.2015.383, Section 3.

    Every parameter is a number or one value per particle (N,).

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        static_friction: arctan mu_s, at rest (radians).
        dynamic_friction: arctan mu_2, of infinitely fast flow (radians), at least the static one.
        inertial_number: I_0, at which friction is half way between both.
        grain_size: diameter d (m).
        grain_density: rho_s of the solid (kg/m3).
        gap_memory: whether a gap closes before the grains bear pressure; static.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "static_friction": ANGLE,
        "dynamic_friction": ANGLE,
        "inertial_number": Parameter(above=0.0),
        "grain_size": above_zero("m"),
        "grain_density": above_zero("kg/m3"),
    }
    FRICTIONAL: ClassVar[bool] = True

    bulk: Array
    shear: Array
    static_friction: Array
    dynamic_friction: Array
    inertial_number: Array
    grain_size: Array
    grain_density: Array
    gap_memory: bool = field(default=True, metadata={"static": True})

    @property
    def tension_cutoff(self) -> float:
        """Largest mean stress, 0 (Pa)."""
        return 0.0

    def stands_to(self, slope: float) -> Array:
        """Reduction factor at which grains stand no more on a plane of a slope (rise over run).

        They flow in plane strain, with p across it, whatever the stress along the plane is, where mu_s is less than the
        sine of its angle (Rankine). A flow along it, in which p is normal to it, rests where mu_s exceeds the tangent.
        """
        return jnp.tan(self.static_friction) * math.hypot(1, slope) / slope

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: None, dt: Array | None = None
    ) -> tuple[Tensor, None]:
        """Elastic predictor and implicit radial return.

        With t the trial sqrt(J2) and y the result, the rate g_dot = (t - y) / (G dt) makes y = mu(I) p a quadratic
        equation, of which y is the lesser root.

        Args:
            strain_increment: tensor, tension positive.
            stress: tensor (Pa).
            history: None.
            dt: duration of the increment (s).

        Returns:
            Stress (Pa) and None.

        Raises:
            ValueError: If there is no dt.
        """
        if dt is None:
            raise ValueError("friction that depends on the rate needs the time step: call update(..., dt)")
        trial = row_by_row(add(stress, elastic_increment(self.bulk, self.shear, strain_increment)))
        pressure, t = jnp.maximum(-mean(trial), 0), safe_sqrt(second_invariant(deviator(trial)))
        least, most = (jnp.tan(angle) * pressure for angle in (self.static_friction, self.dynamic_friction))
        # The rate at which I is I_0, times G dt.
        half = self.inertial_number * self.shear * dt * safe_sqrt(pressure / self.grain_density) / self.grain_size
        total, product = most + t + half, most * t + least * half
        yielding = ~(t <= least)
        root = safe_sqrt(jnp.where(yielding, total**2 - 4 * product, 1.0))
        y = jnp.where(yielding, 2 * product / jnp.where(yielding, total + root, 1.0), t)
        scale = jnp.where(yielding, y / jnp.where(yielding, t, 1.0), 1.0)
        reduced = by_component(lambda s: s if absent(s) else scale * s, deviator(trial))
        return with_mean(reduced, -pressure), None
