"""Soil of effective stress whose water neither leaves nor enters while it strains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Particles
from jaxmpm.laws._base import stiffened
from jaxmpm.laws._gap import remembers_gap, update_with_gap
from jaxmpm.laws._parameter import Declared, Parameter, declared, with_parameters
from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.support.check import Limit
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import zeros_like
from jaxmpm.tensors import mean, with_mean

Skeleton = TypeVar("Skeleton", bound=Material)

PRESSURE_GOES = (0.05, 0.1)
"""Growth of the soil's volume, as a logarithm, from which on and up to which its own pore pressure falls to 0."""

DRAINED = -1.0
"""Pore pressure at rest (Pa) of soil above the water, in `Saturated`."""

B_VALUE = Parameter(least=0.0, below=1.0)


def pressure_left(growth: Array) -> Array:
    """Share of the pore pressure at rest that opened soil retains.

    Args:
        growth: of its volume, as a logarithm (N,).

    Returns:
        (N,) from 0 to 1.
    """
    first, last = PRESSURE_GOES
    return jnp.clip((last - growth) / (last - first), 0, 1)


class Sealed(NamedTuple):
    """History of saturated soil.

    Args:
        strain: history of its skeleton's law.
        growth: of its volume and so of its water since it was at rest (N,), as a logarithm.
    """

    strain: History
    growth: Array


@pytree
@dataclass(frozen=True)
class Saturated:
    """Soil of effective stress with water in its voids that neither leaves nor enters: undrained.

    Water resists a change of the soil's volume with the modulus K B / (1 - B), K the bulk modulus of the skeleton.
    So its pressure changes by B times a change of the mean total stress of an elastic skeleton, and rises by B K d as
    the skeleton contracts by d under shear: du = B (dp + K d). The law's stress is the effective stress of
    the skeleton less the change of pore pressure since the soil was at rest, so that what acts on the grid is total
    stress. The skeleton bears what its law allows, so that water bears at most the whole mean stress: soil without
    cohesion is then liquefied.

    Water bears no tension. As soil opens, the pressure that it carries falls to 0 and no further, and rises again once
    the soil has closed. Soil above the water is drained.

    Sources: Skempton (1954), doi:10.1680/geot.1954.4.4.143 (B, and pressure by shear); Bishop and Hight (1977),
    doi:10.1680/geot.1977.27.3.369 (B of elastic skeleton and water).

    Args:
        law: of the skeleton, in effective stress.
        b_value: Skempton's B, a number or one value per particle (N,), from 0 (drained) to below 1. The time step
            falls with sqrt(1 - B) as B comes near 1.
        pore_pressure: at rest (N,) Pa, that the soil carries along: 0 where all of it belongs to the place, as below a
            table; below 0 above the water. None for soil that is all saturated, whose water bears any tension, as under
            the back pressure of a laboratory.

    Example:
        >>> import jaxmpm as mpm
        >>> sand = mpm.laws.MohrCoulomb(1e7, 6e6, cohesion=0.0, friction=0.6, dilation=-0.05)
        >>> law = mpm.laws.Saturated(sand, b_value=0.95)
        >>> test = mpm.laws.element_test(law, "triaxial drained", pressure=100e3, strain=0.02)  # cell pressure held
        >>> bool(law.excess_pressure(test.history)[-1] > 50e3)
        True
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"b_value": B_VALUE}

    law: Material
    b_value: Array
    pore_pressure: Array | None = None

    @property
    def FRICTIONAL(self) -> bool:
        """Whether the strength of the skeleton depends on its mean stress."""
        return self.law.FRICTIONAL

    @property
    def bulk(self) -> Array:
        """Elastic bulk modulus of the skeleton (Pa)."""
        return self.law.bulk

    @property
    def shear(self) -> Array:
        """Elastic shear modulus (Pa)."""
        return self.law.shear

    @property
    def water_modulus(self) -> Array:
        """Rise of pressure per loss of volume (Pa), K B / (1 - B), 0 where soil is drained."""
        modulus = self.law.bulk * self.b_value / (1 - self.b_value)
        return modulus if self.pore_pressure is None else jnp.where(self.pore_pressure < 0, 0, modulus)

    @property
    def p_wave_modulus(self) -> Array:
        """That of skeleton and water together (Pa)."""
        return self.law.p_wave_modulus + self.water_modulus

    @property
    def steepest_softening(self) -> Array | None:
        """That of the skeleton (Pa)."""
        return self.law.steepest_softening

    def initial_history(self, particles: Particles) -> Sealed:
        """That of the skeleton, and no growth."""
        return Sealed(self.law.initial_history(particles), zeros_like(particles.mass))

    def history_at_rest(self, history: Sealed, stress: Tensor) -> Sealed:
        """That of the skeleton under its stress at rest (Pa)."""
        return history._replace(strain=self.law.history_at_rest(history.strain, stress))

    def reduced(self, factor: Array) -> Self:
        """The law with the strength of its skeleton divided by `factor`."""
        return replace(self, law=self.law.reduced(factor))

    def stiffened(self, bulk: Array, shear: Array, pressure: Array) -> Self:
        """The law with other moduli (Pa) of its skeleton, see `jaxmpm.laws.stiffened`."""
        return replace(self, law=stiffened(self.law, bulk, shear, pressure))

    def excess_pressure(self, history: Sealed) -> Array:
        """Change of pore pressure since the soil was at rest, beside the share that opening soil loses of it.

        Args:
            history: of the law.

        Returns:
            (N,) Pa.
        """
        excess = -self.water_modulus * history.growth
        if self.pore_pressure is None:
            return excess
        return jnp.maximum(excess, -pressure_left(history.growth) * jnp.maximum(self.pore_pressure, 0))

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Sealed, dt: Array | None = None
    ) -> tuple[Tensor, Sealed]:
        """Stress and history after a strain increment, whose trace is the increase of volume.

        Args:
            strain_increment: tensor, tension positive.
            stress: tensor (Pa).
            history: of the law.
            dt: duration of the increment (s), for the skeleton's law.

        Returns:
            Stress (Pa) and history.
        """
        return update_with_gap(self, strain_increment, stress, history, dt, gap=None)[:2]


def _is_sealed(part: object) -> bool:
    return isinstance(part, Sealed)


def of_skeleton(history: History) -> History:
    """The history of the soil's skeleton, without the growth of its water.

    Args:
        history: of the law of a scene.

    Returns:
        That of the skeleton's law, itself where soil is drained.
    """
    return jax.tree.map(lambda part: part.strain if _is_sealed(part) else part, history, is_leaf=_is_sealed)


def with_skeleton(history: History, skeleton: History) -> History:
    """The history with another history of the skeleton.

    Args:
        history: of the law of a scene.
        skeleton: of the structure that `of_skeleton` gives of it.

    Returns:
        History.
    """

    def replaced(part: History, new: History) -> History:
        return part._replace(strain=new) if _is_sealed(part) else new

    return jax.tree.map(replaced, history, skeleton, is_leaf=_is_sealed)


def saturated(law: Skeleton, b_value: ArrayLike | None) -> Skeleton | Saturated:
    """The law of soil with a B-value, or of drained soil.

    Args:
        law: of the skeleton.
        b_value: None for drained soil.

    Returns:
        `Saturated`, or the law itself.
    """
    return law if b_value is None else Saturated(law, jnp.asarray(b_value, jnp.result_type(law.bulk)))


@singledispatch
def flooded(law: Any, pressure: Array) -> Any:
    """The law with the pore pressure at rest, from which its water starts.

    Args:
        law: a law.
        pressure: at rest (N,) Pa, see `Saturated`.

    Returns:
        The law, itself where it is drained.
    """
    return law


@flooded.register
def _(law: Saturated, pressure: Array) -> Saturated:
    return replace(law, pore_pressure=pressure)


@singledispatch
def drained(law: Any) -> Any:
    """The law whose water leaves and enters at once: with a B-value of 0, and its history of the same structure.

    Args:
        law: a law.

    Returns:
        The law, itself where it is drained.
    """
    return law


@drained.register
def _(law: Saturated) -> Saturated:
    return replace(law, b_value=jnp.zeros_like(law.b_value))


@singledispatch
def excess_pressure(law: Any, history: History, like: Tensor) -> Array | None:
    """Change of pore pressure since the soil was at rest.

    Args:
        law: of the scene.
        history: of the state.
        like: tensor of its dimension and precision.

    Returns:
        (N,) Pa; None where all soil is drained.
    """
    return None


@excess_pressure.register
def _(law: Saturated, history: Sealed, like: Tensor) -> Array:
    return law.excess_pressure(history)


@remembers_gap.register
def _(law: Saturated) -> bool:
    return remembers_gap(law.law)


@update_with_gap.register
def _(
    law: Saturated,
    strain: Tensor,
    stress: Tensor,
    history: Sealed,
    dt: Array | None,
    *,
    gap: Array | None,
    received: Array | None = None,
    logarithmic: bool = False,
) -> tuple[Tensor, Sealed, Array | None]:
    effective = with_mean(stress, mean(stress) + law.excess_pressure(history))
    effective, skeleton, gap = update_with_gap(
        law.law, strain, effective, history.strain, dt, gap=gap, logarithmic=logarithmic
    )
    increase = 3 * mean(strain)
    growth = history.growth + (increase if logarithmic else jnp.log1p(increase))
    history = Sealed(skeleton, growth if received is None else growth + received)
    return with_mean(effective, mean(effective) - law.excess_pressure(history)), history, gap


@declared.register
def _(law: Saturated) -> dict[str, Declared]:
    return {**declared(law.law), "b_value": Declared("b_value", B_VALUE, law.b_value)}


@with_parameters.register
def _(law: Saturated, values: Mapping[str, ArrayLike]) -> Saturated:
    skeleton = {name: value for name, value in values.items() if name != "b_value"}
    water: dict[str, Any] = {name: value for name, value in values.items() if name == "b_value"}
    return replace(law, law=with_parameters(law.law, skeleton), **water)
