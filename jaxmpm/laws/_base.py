"""What most constitutive laws share: isotropic elasticity, and nothing that is not asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from foundation.check import Limit, above_zero
from jaxmpm.laws._parameter import with_strength_divided
from jaxmpm.types import Material, Particles, Tensor

MODULI = {"bulk": above_zero("Pa"), "shear": above_zero("Pa")}


class Law:
    """Base of a law with the moduli `bulk` and `shear` (Pa), no history, no strength, no friction, no softening.

    A law derives from it, is a frozen dataclass decorated with `pytree`, and writes `update`; what else it has it
    writes over. PARAMETERS declares the law's own numbers, besides the moduli. See `Material` for every member.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = MODULI
    FRICTIONAL: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        if wrong := {"LIMITS", "STRENGTH"} & vars(cls).keys():
            raise ValueError(f"{cls.__name__} has {min(wrong)}: declare its numbers in PARAMETERS, as Parameter")
        cls.PARAMETERS = {**MODULI, **cls.PARAMETERS}

    @property
    def p_wave_modulus(self) -> Array:
        """K + 4G/3 (Pa)."""
        law: Any = self
        return law.bulk + 4 * law.shear / 3

    @property
    def steepest_softening(self) -> Array | None:
        """None: the law does not soften."""
        return None

    def initial_history(self, particles: Particles) -> Any:
        """None: the law has no history."""
        return None

    def reduced(self, factor: Array) -> Any:
        """The parameters declared as `reduced`, divided by `factor`; ValueError where there are none."""
        return with_strength_divided(self, factor)

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Any, dt: Array | None = None
    ) -> tuple[Tensor, Any]:
        """Stress (Pa) and history after a strain increment within dt (s): what a law must write."""
        raise NotImplementedError(f"{type(self).__name__} has no `update`: write one, see jaxmpm.Material")


def reduce_strength(material: Material, factor: Array) -> Any:
    """The strength reduction method: a law's peak and residual strength, tan(phi) too, divided by `factor`.

    Raises ValueError for a law without strength.
    """
    return material.reduced(factor)


def snaps_back(material: Material) -> Array | None:
    """Whether strength falls as steeply as the soil unloads elastically, or steeper; None without softening."""
    steepest = material.steepest_softening
    return None if steepest is None else jnp.any(steepest >= material.shear)
