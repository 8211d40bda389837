"""Retention and relative conductivity of unsaturated soil, its suction stress, and published values by soil class."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.support import check
from jaxmpm.support.check import Limit, above_zero, from_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.text import shown

TAIL = 20.0
"""Suction of Gardner's soil, as a multiple of 1 / alpha, beyond which a power takes the place of the exponential.

Saturation is 2e-9 there, and would soon be less than the smallest number.
"""


class Shape(NamedTuple):
    """What follows from the numbers of a soil alone.

    Args:
        switch: pressure head (m) of the steepest saturation.
        saturation: effective saturation there.
        steepest: slope of saturation there (1/m).
        scale: of saturation, so that it begins with 1.
        entry: of Mualem's factor, so that it begins with 1.
    """

    switch: Array
    saturation: Array
    steepest: Array
    scale: Array
    entry: Array


class Retention(ABC):
    """What the soils share: water content, and the variable in which Newton's method steps.

    Below the head at which saturation rises fastest that variable is saturation, above it is the head. Water content is
    then linear in it where soil is dry and head is where soil is wet, so that a front into dry soil converges.

    Source: Brenner and Cances (2017), doi:10.1137/16M1083414 (parametrisation of Richards' equation).
    """

    conductivity: Array
    porosity: Array
    residual: Array
    anisotropy: Array
    storage: Array

    @abstractmethod
    def shape(self) -> Shape:
        """What follows from the numbers of the soil alone."""

    @abstractmethod
    def curves(self, head: Array, shape: Shape) -> tuple[Array, Array]:
        """Effective saturation, and conductivity over that of saturated soil, at pressure heads (m)."""

    @abstractmethod
    def head_of(self, saturation: Array, shape: Shape) -> Array:
        """Pressure head (m) at effective saturations below 1."""

    @property
    @abstractmethod
    def steepness(self) -> Array:
        """Fall of the logarithm of conductivity per suction (1/m)."""

    def saturation(self, head: ArrayLike) -> Array:
        """Effective saturation from 0 to 1 at pressure heads (m)."""
        return self.curves(jnp.asarray(head), self.shape())[0]

    def relative_conductivity(self, head: ArrayLike) -> Array:
        """Conductivity over that of saturated soil at pressure heads (m)."""
        return self.curves(jnp.asarray(head), self.shape())[1]

    def water_content(self, head: ArrayLike) -> Array:
        """Volume of water per volume of soil at pressure heads (m)."""
        return self.content(self.saturation(head))

    def content(self, saturation: Array) -> Array:
        """Volume of water per volume of soil at effective saturations."""
        return self.residual + (self.porosity - self.residual) * saturation

    def scale(self, head: Array, slope: Array, shape: Shape) -> Array:
        """Change of Newton's variable per change of head, from the slope of saturation there (1/m)."""
        return jnp.where(head < shape.switch, slope / shape.steepest, 1)

    def moved(self, head: Array, saturation: Array, change: Array, shape: Shape) -> Array:
        """Pressure heads (m) after a change (m) of Newton's variable; saturation falls to no less than a fifth."""
        switch, at, steepest, *_ = shape
        dry = head < switch
        reached = jnp.where(dry, saturation + steepest * change, at + steepest * (head + change - switch))
        low = jnp.maximum(reached, 0.2 * jnp.minimum(saturation, at))
        in_head = jnp.where(dry, switch + (reached - at) / steepest, head + change)
        return jnp.where(reached < at, self.head_of(jnp.minimum(low, at), shape), in_head)


@pytree
@dataclass(frozen=True)
class VanGenuchten(Retention):
    """Saturation [1 + (alpha s)^n]^-m at suction s, m = 1 - 1/n, with Mualem's conductivity.

    With an air entry, soil is saturated up to that suction, and both curves are scaled to begin at 1 there. Without one
    the conductivity of soil with n < 2 falls infinitely steeply from saturation.

    Sources: van Genuchten (1980), doi:10.2136/sssaj1980.03615995004400050002x, eqs. 3 and 9; Vogel, van Genuchten and
    Cislerova (2000), doi:10.1016/S0309-1708(00)00037-3; Ippisch, Vogel and Bastian (2006),
    doi:10.1016/j.advwatres.2005.12.011 (air entry).

    Args:
        conductivity: of saturated soil, upright (m/s).
        alpha: (1/m).
        n: above 1.
        porosity: water content of saturated soil.
        residual: water content of dry soil.
        anisotropy: level over upright conductivity.
        air_entry: suction (m) up to which soil stays saturated.
        storage: specific storage (1/m), of soil under positive pressure.
    """

    conductivity: Array
    alpha: Array
    n: Array
    porosity: Array
    residual: Array
    anisotropy: Array
    air_entry: Array
    storage: Array

    DEFAULTS: ClassVar[Mapping[str, float]] = {"residual": 0.0, "anisotropy": 1.0, "air_entry": 0.0, "storage": 1e-5}
    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "conductivity": above_zero("m/s"),
        "alpha": above_zero("1/m"),
        "n": Limit(above=1.0),
        "porosity": Limit(above=0.0, below=1.0),
        "residual": Limit(least=0.0, below=1.0),
        "anisotropy": above_zero(),
        "air_entry": from_zero("m"),
        "storage": from_zero("1/m"),
    }

    def shape(self) -> Shape:
        """What follows from the numbers of the soil alone."""
        m, none = 1 - 1 / self.n, self.air_entry == 0
        saturation, pores = self._unscaled(self.air_entry)
        scale, entry = jnp.where(none, 1, saturation), jnp.where(none, 1, pores)
        suction = jnp.maximum(m ** (1 / self.n) / self.alpha, self.air_entry)
        at, _ = self._unscaled(suction)
        power = (self.alpha * suction) ** self.n
        return Shape(-suction, at / scale, at / scale * m * self.n * power / (1 + power) / suction, scale, entry)

    def _unscaled(self, suction: Array) -> tuple[Array, Array]:
        """Saturation, and Mualem's factor of conductivity, at suctions (m) without an air entry."""
        m = 1 - 1 / self.n
        log = self.n * jnp.log(self.alpha * jnp.maximum(suction, jnp.finfo(suction.dtype).eps / self.alpha))
        rest = jnp.log1p(jnp.exp(-jnp.abs(log)))
        return jnp.exp(-m * (jnp.maximum(log, 0) + rest)), -jnp.expm1(-m * (jnp.maximum(-log, 0) + rest))

    def curves(self, head: Array, shape: Shape) -> tuple[Array, Array]:
        """Effective saturation, and conductivity over that of saturated soil, at pressure heads (m)."""
        saturation, pores = self._unscaled(jnp.maximum(-head, self.air_entry))
        saturation, pores = saturation / shape.scale, pores / shape.entry
        unsaturated = -head > self.air_entry
        return jnp.where(unsaturated, saturation, 1), jnp.where(unsaturated, jnp.sqrt(saturation) * pores**2, 1)

    def head_of(self, saturation: Array, shape: Shape) -> Array:
        """Pressure head (m) at effective saturations below 1."""
        power = jnp.expm1(-jnp.log(saturation * shape.scale) / (1 - 1 / self.n))
        return -(power ** (1 / self.n)) / self.alpha

    @property
    def steepness(self) -> Array:
        """Fall of the logarithm of conductivity per suction (1/m) near its bend."""
        return self.alpha * (2.5 * self.n - 0.5) / 2


@pytree
@dataclass(frozen=True)
class Gardner(Retention):
    """Saturation and relative conductivity exp(-alpha s) at suction s, for which the equation of flow is linear.

    Below a saturation of 2e-9 they fall by a power of the suction.

    Source: Gardner (1958), doi:10.1097/00010694-195804000-00006.

    Args:
        conductivity: of saturated soil, upright (m/s).
        alpha: (1/m).
        porosity: water content of saturated soil.
        residual: water content of dry soil.
        anisotropy: level over upright conductivity.
        storage: specific storage (1/m), of soil under positive pressure.
    """

    conductivity: Array
    alpha: Array
    porosity: Array
    residual: Array
    anisotropy: Array
    storage: Array

    DEFAULTS: ClassVar[Mapping[str, float]] = {"residual": 0.0, "anisotropy": 1.0, "storage": 1e-5}
    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        name: limit for name, limit in VanGenuchten.PARAMETERS.items() if name not in ("n", "air_entry")
    }

    def shape(self) -> Shape:
        """What follows from the numbers of the soil alone."""
        one = jnp.ones_like(self.alpha)
        return Shape(0 * one, one, self.alpha, one, one)

    def curves(self, head: Array, shape: Shape) -> tuple[Array, Array]:
        """Effective saturation, and conductivity over that of saturated soil, at pressure heads (m)."""
        fall = -self.alpha * head
        tail = (jnp.maximum(fall, TAIL) / TAIL) ** -TAIL
        saturation = jnp.where(fall > 0, jnp.exp(-jnp.clip(fall, 0, TAIL)) * tail, 1)
        return saturation, saturation

    def head_of(self, saturation: Array, shape: Shape) -> Array:
        """Pressure head (m) at effective saturations below 1."""
        fall = -jnp.log(saturation)
        return -jnp.where(fall < TAIL, fall, TAIL * jnp.exp(jnp.maximum(fall, TAIL) / TAIL - 1)) / self.alpha

    @property
    def steepness(self) -> Array:
        """Fall of the logarithm of conductivity per suction (1/m)."""
        return self.alpha


AnySoil = TypeVar("AnySoil", VanGenuchten, Gardner)

CARSEL_PARRISH: Mapping[str, tuple[float, float, float, float, float]] = {
    "sand": (0.045, 0.43, 14.5, 2.68, 712.8),
    "loamy sand": (0.057, 0.41, 12.4, 2.28, 350.2),
    "sandy loam": (0.065, 0.41, 7.5, 1.89, 106.1),
    "loam": (0.078, 0.43, 3.6, 1.56, 24.96),
    "silt": (0.034, 0.46, 1.6, 1.37, 6.00),
    "silt loam": (0.067, 0.45, 2.0, 1.41, 10.80),
    "sandy clay loam": (0.100, 0.39, 5.9, 1.48, 31.44),
    "clay loam": (0.095, 0.41, 1.9, 1.31, 6.24),
    "silty clay loam": (0.089, 0.43, 1.0, 1.23, 1.68),
    "sandy clay": (0.100, 0.38, 2.7, 1.23, 2.88),
    "silty clay": (0.070, 0.36, 0.5, 1.09, 0.48),
    "clay": (0.068, 0.38, 0.8, 1.09, 4.80),
}
"""Mean residual water content, porosity, alpha (1/m), n and conductivity (cm/day) of the soil classes of the USDA.

Source: Carsel and Parrish (1988), doi:10.1029/WR024i005p00755.
"""

STEEP = 2.0
"""Value of n below which the conductivity of van Genuchten's soil needs an air entry."""

USUAL_AIR_ENTRY = 0.02
"""Suction (m) at air entry of soil classes with n < 2, as Vogel et al. (2000) propose."""


def van_genuchten(**values: ArrayLike) -> VanGenuchten:
    """Soil of van Genuchten, checked.

    Args:
        **values: the fields of `VanGenuchten`, each a number or one a cell; residual, anisotropy, air_entry and
            storage have the defaults 0, 1, 0 m and 1e-5 1/m.

    Returns:
        The soil.

    Raises:
        ValueError: If a value is missing, unknown or outside its limit.
    """
    return _checked(VanGenuchten, values)


def gardner(**values: ArrayLike) -> Gardner:
    """Soil of Gardner, checked.

    Args:
        **values: the fields of `Gardner`, each a number or one a cell; residual, anisotropy and storage have the
            defaults 0, 1 and 1e-5 1/m.

    Returns:
        The soil.

    Raises:
        ValueError: If a value is missing, unknown or outside its limit.
    """
    return _checked(Gardner, values)


def _checked(kind: type[AnySoil], values: Mapping[str, ArrayLike]) -> AnySoil:
    names = [field.name for field in fields(kind)]
    numbers = {**kind.DEFAULTS, **values}
    if unknown := numbers.keys() - set(names):
        raise ValueError(f"{', '.join(sorted(unknown))}: {kind.__name__} has {', '.join(names)}")
    if missing := [name for name in names if name not in numbers]:
        raise ValueError(f"{kind.__name__} lacks {', '.join(missing)}: give a number or one a cell")
    for name, limit in kind.PARAMETERS.items():
        check.within(name, numbers[name], limit)
    dtype = jnp.result_type(float, *(value for value in numbers.values() if hasattr(value, "dtype")))
    soil = kind(**{name: jnp.asarray(numbers[name], dtype) for name in names})
    check.require(
        soil.residual < soil.porosity,
        f"residual = {shown(numbers['residual'])} is no less than porosity = {shown(numbers['porosity'])}: give less "
        "water to dry soil than to saturated soil",
    )
    return soil


def soil_class(name: str, **values: ArrayLike) -> VanGenuchten:
    """Soil of a textural class, by the means of Carsel and Parrish (1988).

    Args:
        name: "sand", "loamy sand", "sandy loam", "loam", "silt", "silt loam", "sandy clay loam", "clay loam",
            "silty clay loam", "sandy clay", "silty clay" or "clay".
        **values: fields of `VanGenuchten` to take in place of those of the class.

    Returns:
        The soil, with an air entry of 0.02 m where n is below 2.

    Raises:
        ValueError: If there is no such class, or a value is outside its limit.
    """
    if name not in CARSEL_PARRISH:
        raise ValueError(f"soil class {shown(name)}: give one of {', '.join(CARSEL_PARRISH)}")
    residual, porosity, alpha, n, per_day = CARSEL_PARRISH[name]
    parameters: dict[str, ArrayLike] = {"residual": residual, "porosity": porosity, "alpha": alpha, "n": n}
    parameters |= {"conductivity": per_day / 100 / 86400, "air_entry": USUAL_AIR_ENTRY if n < STEEP else 0.0}
    return van_genuchten(**{**parameters, **values})


def zoned(soils: Sequence[AnySoil], number: np.ndarray) -> AnySoil:
    """One soil with the values of several, each in its cells.

    Args:
        soils: all of one class.
        number: of the soil of each cell, an array of the cells' shape.

    Returns:
        A soil whose fields have that shape.

    Raises:
        ValueError: If the soils are of several classes, or a number names none.
    """
    if len(kinds := {type(soil) for soil in soils}) != 1:
        raise ValueError(f"soils of {', '.join(sorted(kind.__name__ for kind in kinds))}: give soils of one class")
    number = np.asarray(number)
    if number.size and not 0 <= number.min() <= number.max() < len(soils):
        raise ValueError(f"number = {number.min()} to {number.max()}: give 0 to {len(soils) - 1}, one of the soils")
    return jax.tree.map(lambda *values: jnp.stack(values)[number], *soils)


def suction_stress(soil: Retention, head: ArrayLike, unit_weight: ArrayLike = WATER_WEIGHT) -> Array:
    """Stress that water adds to the skeleton: effective stress is total stress plus it, tension positive.

    It is the pore pressure times the effective saturation, so that the full pressure acts below the water table and
    suction holds the grains together above it.

    Sources: Lu and Likos (2004), Unsaturated Soil Mechanics; Lu, Godt and Wu (2010), doi:10.1029/2009WR008646, eq. 7.

    Args:
        soil: with its retention.
        head: pressure head (m), below 0 under suction.
        unit_weight: of water (N/m3).

    Returns:
        Pa, positive under pressure, which lowers compression, and negative under suction, which adds to it.
    """
    return jnp.asarray(unit_weight) * jnp.asarray(head) * soil.saturation(head)


def moist_weight(soil: Retention, head: ArrayLike, dry: ArrayLike, water: ArrayLike = WATER_WEIGHT) -> Array:
    """Unit weight of soil with the water that it holds.

    Args:
        soil: with its retention.
        head: pressure head (m).
        dry: unit weight without water (N/m3).
        water: unit weight of water (N/m3).

    Returns:
        N/m3.
    """
    return jnp.asarray(dry) + jnp.asarray(water) * soil.water_content(head)
