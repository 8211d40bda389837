"""Shared part of most constitutive laws: isotropic elasticity, and None for everything optional."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self, TypeVar

import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Particles
from jaxmpm.laws._parameter import with_parameters, with_strength_divided
from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.support.check import Limit, above_zero

Kind = TypeVar("Kind", bound=Material)

MODULI = {"bulk": above_zero("Pa"), "shear": above_zero("Pa")}


class Law:
    """Base of a law with isotropic elasticity, without history, strength, friction or softening.

    A law derives from it, is a frozen dataclass decorated with `pytree` that has the moduli `bulk` and `shear` (Pa),
    and has an `update`. It overrides whatever else it has. PARAMETERS declares the law's own numbers besides the
    moduli. See `Material` for every member.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = MODULI
    FRICTIONAL: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        if wrong := {"LIMITS", "STRENGTH"} & vars(cls).keys():
            raise ValueError(f"{cls.__name__} has {min(wrong)}: declare its numbers in PARAMETERS, as Parameter")
        cls.PARAMETERS = {**MODULI, **cls.PARAMETERS}

    @property
    def p_wave_modulus(self: Material) -> Array:
        """K + 4G/3 (Pa)."""
        return self.bulk + 4 * self.shear / 3

    @property
    def steepest_softening(self) -> Array | None:
        """None: the law does not soften."""
        return None

    def initial_history(self, particles: Particles) -> History:
        """None: the law has no history."""
        return None

    def history_at_rest(self, history: History, stress: Tensor) -> History:
        """The history unchanged: the law does not remember the stress at rest."""
        return history

    def reduced(self, factor: Array) -> Self:
        """The law with parameters declared as `reduced` divided by `factor`; ValueError if there are none."""
        return with_strength_divided(self, factor)


def reduce_strength(material: Kind, factor: Array) -> Kind:
    """Divide a law's peak and residual strength, tan(phi) included, by a factor: the strength reduction method.

    Args:
        material: a law, whose parameters are numbers or one value per particle (N,).
        factor: () reduction factor above 0.

    Returns:
        The law with reduced strength.

    Raises:
        ValueError: If the law has no strength.
    """
    return material.reduced(factor)


def stiffened(material: Kind, bulk: Array, shear: Array, pressure: Array) -> Kind:
    """A law with other moduli and the same strength, by which a limit load is found.

    A law whose strains at failure follow from other numbers than the moduli has a method of this name and these
    arguments, which scales them too.

    Args:
        material: a law with parameters `bulk` and `shear`.
        bulk: () or (N,) bulk modulus (Pa).
        shear: () or (N,) shear modulus (Pa).
        pressure: () or (N,) mean stress of the deepest soil (Pa), at which a stiffness that grows with stress is these.

    Returns:
        The law.
    """
    if hasattr(material, "stiffened"):
        return material.stiffened(bulk, shear, pressure)
    return with_parameters(material, {"bulk": bulk, "shear": shear})


def snaps_back(material: Material) -> Array | None:
    """Whether strength falls at least as steeply as the soil unloads elastically.

    Args:
        material: a law.

    Returns:
        () bool, None for a law that does not soften.
    """
    steepest = material.steepest_softening
    return None if steepest is None else jnp.any(steepest >= material.shear)
