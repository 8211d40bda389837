"""A law alone: the laboratory's tests on one element of soil, without a grid."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Particles
from jaxmpm.laws._gap import remembers_gap, update_with_gap
from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.support import check
from jaxmpm.support.pytrees import pytree
from jaxmpm.tensors import CARRIED, compress, deviator, expand, safe_sqrt, second_invariant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEWTON_STEPS = 12
"""Newton's steps for the strain that holds a stress; they start from that of the step before."""

DPI = 144
"""Pixels per inch of figures."""


class Path(NamedTuple):
    """Strain of a test, components xx, yy, zz and xz.

    Args:
        driven: strain for each unit of the strain that the test prescribes, tension positive.
        free: direction of the strain that holds a stress; None for a test without.
        kept: number of the component of stress that stays.
    """

    driven: tuple[float, float, float, float]
    free: tuple[float, float, float, float] | None = None
    kept: int = 0


PATHS = {
    "triaxial drained": Path((0, 0, -1, 0), (1, 1, 0, 0)),
    "triaxial undrained": Path((0.5, 0.5, -1, 0)),
    "plane strain drained": Path((0, 0, -1, 0), (1, 0, 0, 0)),
    "plane strain undrained": Path((1, 0, -1, 0)),
    "simple shear drained": Path((0, 0, 0, 0.5), (0, 0, 1, 0), 2),
    "simple shear undrained": Path((0, 0, 0, 0.5)),
    "oedometer": Path((0, 0, -1, 0)),
}
"""Tests by name."""


@pytree
@dataclass(frozen=True)
class ElementTest:
    """Stress and strain of a test from its start on.

    Args:
        strain: (steps + 1, 6) components xx, yy, zz, xy, yz, xz, tension positive and shear tensorial;
            (steps + 1, 6, N) of a law with values for N particles, and so for all other arrays.
        stress: likewise (Pa), effective in a law of effective stress.
        history: of the law, each array (steps + 1,).
        test: its name; static.
    """

    strain: Array
    stress: Array
    history: History
    test: str = field(metadata={"static": True})

    @property
    def axial_strain(self) -> Array:
        """Vertical strain (steps + 1,), positive in compression."""
        return -self.strain[:, 2]

    @property
    def shear_strain(self) -> Array:
        """Engineering shear strain (steps + 1,) of horizontal planes."""
        return 2 * self.strain[:, 5]

    @property
    def volumetric_strain(self) -> Array:
        """Volumetric strain (steps + 1,), positive in compression."""
        return -jnp.sum(self.strain[:, :3], axis=1)

    @property
    def vertical_stress(self) -> Array:
        """Vertical stress (steps + 1,) Pa, positive in compression."""
        return -self.stress[:, 2]

    @property
    def shear_stress(self) -> Array:
        """Shear stress (steps + 1,) Pa on horizontal planes."""
        return self.stress[:, 5]

    @property
    def pressure(self) -> Array:
        """Mean stress p (steps + 1,) Pa, positive in compression."""
        return -jnp.mean(self.stress[:, :3], axis=1)

    @property
    def deviatoric(self) -> Array:
        """Q = sqrt(3 J2) (steps + 1,) Pa."""
        return safe_sqrt(3 * jnp.asarray(second_invariant(deviator(_columns(self.stress)))))

    def figure(self) -> Figure:
        """Stress against strain, path of the stress, and change of volume; neither shown nor saved.

        Returns:
            Figure.
        """
        from matplotlib.figure import Figure  # a second's import, which a run does without

        canvas = Figure(figsize=(10, 3.2), layout="constrained", dpi=DPI)
        sheared, oedometer = self.test.startswith("simple shear"), self.test == "oedometer"
        along = self.shear_strain if sheared else self.axial_strain
        acting, name = (self.shear_stress, "shear stress") if sheared else (self.deviatoric, "q")
        mean_stress, of = (self.vertical_stress, "vertical stress") if sheared else (self.pressure, "p")
        of_strain = "shear strain" if sheared else "axial strain"
        kilo = 1e-3
        panels = (
            (of_strain, along, f"{name} (kPa)", acting * kilo),
            (f"{of} (kPa)", mean_stress * kilo, f"{name} (kPa)", acting * kilo),
            (of_strain, along, "volumetric strain", self.volumetric_strain),
        )
        if oedometer:
            panels = (*panels[:2], ("vertical stress (kPa)", self.vertical_stress * kilo, of_strain, along))
        for axes, (x_name, x, y_name, y) in zip(canvas.subplots(1, 3), panels, strict=True):
            axes.plot(np.asarray(x), np.asarray(y))
            axes.set(xlabel=x_name, ylabel=y_name)
            axes.grid(alpha=0.3)
        if oedometer:
            axes.set_xscale("log")
            axes.invert_yaxis()
        canvas.suptitle(self.test)
        return canvas


def element_test(
    law: Material,
    test: str,
    *,
    pressure: ArrayLike,
    strain: float,
    k0: ArrayLike = 1.0,
    steps: int = 1000,
    rate: float | None = None,
) -> ElementTest:
    """Test one element of soil as a laboratory does.

    Compressed along z: "triaxial drained" (lateral stress held), "triaxial undrained" (volume held), "plane strain
    drained", "plane strain undrained" (no strain along y) and "oedometer" (no lateral strain). Sheared along x on
    horizontal planes: "simple shear drained" (vertical stress held) and "simple shear undrained" (height held). It is
    differentiable and vmappable in the law's numbers, the pressure and k0, and each test is compiled once.

    Args:
        law: whose parameters are numbers, or one value for each of N elements (N,).
        test: its name.
        pressure: vertical stress at the start (Pa), positive in compression; () or (N,).
        strain: at the end; axial, positive in compression and below 0 for extension, or engineering shear strain.
        k0: horizontal over vertical stress at the start; () or (N,).
        steps: equal increments of strain.
        rate: of that strain (1/s); laws that depend on it need one.

    Returns:
        Stress, strain and history from the start on.

    Raises:
        ValueError: If the test has no such name or a number is impossible.
    """
    if test not in PATHS:
        raise ValueError(f"test = {test!r}: give one of {', '.join(map(repr, PATHS))}")
    check.finite("strain", strain)
    check.not_negative("pressure", pressure, "Pa")
    check.not_negative("k0", k0)
    check.whole("steps", steps)
    if rate is not None:
        check.positive("rate", rate, "1/s")
    check.within_limits(law)
    dt = None if rate is None else abs(strain) / steps / rate
    return _tested(law, jnp.asarray(pressure), jnp.asarray(k0), strain / steps, dt, test=test, steps=steps)


@partial(jax.jit, static_argnames=("test", "steps"))
def _tested(
    law: Material, pressure: Array, k0: Array, step: Array, dt: Array | None, *, test: str, steps: int
) -> ElementTest:
    path, dtype = PATHS[test], jnp.result_type(*jax.tree.leaves(law))
    shape = jnp.broadcast_shapes((), *(jnp.shape(leaf) for leaf in (*jax.tree.leaves(law), pressure, k0)))
    one = jnp.ones(shape or (1,), dtype)
    law = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), law)
    dt = None if dt is None else jnp.asarray(dt, dtype)
    vertical = -pressure.astype(dtype) * one
    start = jnp.stack([k0.astype(dtype) * vertical, k0.astype(dtype) * vertical, vertical, 0 * one])
    history = law.history_at_rest(law.initial_history(Particles(jnp.stack([one, one]), one, one)), expand(start, 2))
    gap = 0 * one if remembers_gap(law) else None
    driven = jnp.asarray(path.driven, dtype)[:, None] * step.astype(dtype) * one
    free = None if path.free is None else jnp.asarray(path.free, dtype)[:, None] * one

    def updated(increment: Array, carry: tuple[Array, History, Array | None]) -> tuple[Tensor, History, Array | None]:
        stress, history, gap = carry
        return update_with_gap(law, expand(increment, 2), expand(stress, 2), history, dt, gap=gap)

    def increment_of(carry: tuple[Array, History, Array | None], amount: Array) -> tuple[Array, Array]:
        """Increment of strain, and its part along the free direction."""
        if free is None:
            return driven, amount
        direction = free

        def stress_kept(amount: Array) -> Array:
            return compress(updated(driven + amount * direction, carry)[0], 2)[path.kept]

        def newton(_: int, amount: Array) -> Array:
            value, slope = jax.jvp(stress_kept, (amount,), (jnp.ones_like(amount),))
            return amount - (value - start[path.kept]) / jnp.where(slope == 0, 1, slope)

        amount = jax.lax.fori_loop(0, NEWTON_STEPS, newton, amount)
        return driven + amount * direction, amount

    def one_step(carry: Any, _: None) -> tuple[Any, Any]:
        state, amount, strain = carry
        increment, amount = increment_of(state, amount)
        stress, history, gap = updated(increment, state)
        state, strain = (compress(stress, 2), history, gap), strain + increment
        return (state, amount, strain), (strain, state[0], history)

    initial = (start, history, gap), 0 * one, jnp.zeros_like(start)
    _, (strains, stresses, histories) = jax.lax.scan(one_step, initial, None, length=steps)

    def whole(first: Array, rest: Array) -> Array:
        all_of_it = jnp.concatenate([first[None], rest])
        return all_of_it if shape else all_of_it[..., 0]

    def six(first: Array, rest: Array) -> Array:
        components = whole(first, rest)
        placed = jnp.zeros((len(components), 6, *components.shape[2:]), dtype)
        return placed.at[:, jnp.asarray(CARRIED[2])].set(components)

    return ElementTest(six(initial[2], strains), six(start, stresses), jax.tree.map(whole, history, histories), test)


def _columns(tensors: Array) -> Tensor:
    """Components of tensors (n, 6, ...)."""
    xx, yy, zz, xy, yz, xz = jnp.moveaxis(tensors, 1, 0)
    return xx, yy, zz, xy, yz, xz
