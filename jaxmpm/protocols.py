"""What a scene may be made of: shape functions, a law, water, and motion of the base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, Self, TypeAlias

from jax import Array

from jaxmpm.grid import Particles
from jaxmpm.support.check import Limit

Component: TypeAlias = Array | float
"""A component of a tensor; one that the dimension cannot have is the number 0.0, which vanishes in the program."""


Tensor: TypeAlias = tuple[Component, Component, Component, Component, Component, Component]
"""Symmetric tensor as its six components (xx, yy, zz, xy, yz, xz); a component absent in 1D or 2D is 0.0."""


History: TypeAlias = Any
"""History of a law: an array (N,) or a pytree of them, of the law's own kind; None for a law without."""


class Kernel(Protocol):
    """Shape functions of the nodes around a particle: static, so a frozen dataclass of hashable values.

    A function reaches at most one and a half cells from its node, and those of the three nodes around a particle add up
    to 1.
    """

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> Kernel:
        """The kernel for particles this far apart along each axis (m)."""

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        """Value and derivative (1/m) of a node's function at r = (x - x_node) / cell along an axis; cell in m."""

    def deviation(self, cell: float) -> float:
        """Standard deviation (m) of the Gaussian over which mapping to the grid and back spreads a value; cell in m."""


class Material(Protocol):
    """A constitutive law: a frozen pytree of parameters, each a number or one value per particle (N,).

    The protocol names all members that the package uses; `Law` is a base class with what most laws share.
    """

    @property
    def PARAMETERS(self) -> Mapping[str, Limit]:
        """Class variable: limits of the parameters by name; parameters that are not named may have any finite value.

        A `Limit`, or a `Parameter` if strength reduction, a campaign or the thickness of shear bands affect it.
        """

    @property
    def FRICTIONAL(self) -> bool:
        """Whether strength depends on the mean stress, which F-bar would average; of most laws a class variable."""

    @property
    def bulk(self) -> Array:
        """Elastic bulk modulus K (Pa), for the initial stress and the elastic energy."""

    @property
    def shear(self) -> Array:
        """Elastic shear modulus G (Pa), for the initial stress and the elastic energy."""

    @property
    def p_wave_modulus(self) -> Array:
        """Modulus of the fastest elastic wave (Pa), K + 4G/3 of an isotropic law: it sets the time step."""

    @property
    def steepest_softening(self) -> Array | None:
        """Largest loss of strength per unit of plastic shear strain (Pa), below G; None without softening."""

    def initial_history(self, particles: Particles) -> History:
        """History of undisturbed particles: an array (N,) or a pytree of them; None for a law without."""

    def history_at_rest(self, history: History, stress: Tensor) -> History:
        """The initial history of soil at rest under a stress (Pa); the same for a law without memory of it.

        It is traced, as `update` is: compute with `jax.numpy`.
        """

    def reduced(self, factor: Array) -> Self:
        """The law with its strength divided by `factor`: peak, residual, and the tangent of friction."""

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: History, dt: Array | None = None
    ) -> tuple[Tensor, History]:
        """Stress and history after a strain increment.

        Tensors have six components (xx, yy, zz, xy, yz, xz), tension positive; absent ones are the number 0.0.

        Args:
            strain_increment: tensor, shear components tensorial.
            stress: tensor (Pa).
            history: of the law.
            dt: duration of the increment (s), which rate-dependent laws need.

        Returns:
            Stress (Pa) and history.
        """


class PrescribedWater(Protocol):
    """Prescribed water in the ground, a frozen pytree: `WaterTable`, `WaterSurface`, or a user's own."""

    def push(self, position: Array) -> Array:
        """Force per volume -grad u (d, N) N/m3 of the pore pressure u at positions (d, N) m."""

    def pressure(self, position: Array) -> Array:
        """That pore pressure u (N,) Pa, for exports alone: a run does without it."""


class PrescribedMotion(Protocol):
    """Motion of the base, a frozen pytree: `BaseMotion`, or a user's own."""

    @property
    def duration(self) -> Array:
        """Time at which it ends (s)."""

    def at(self, time: Array) -> Array:
        """Acceleration (d,) m/s2 at a time (s)."""
