"""Karhunen-Loeve expansion of a standard Gaussian field on a box, from one-dimensional eigenpairs.

With separable covariance the eigenpairs are products of the axes':

    H(x, y, z) = sum over modes of xi_m psi_i(x) psi_j(y) psi_k(z),  psi scaled by the root of its eigenvalue.

The expansion is grid free: the same coefficients give the same field at any points. `expand` selects the modes on the
host; all other functions are pure and may be jitted, vmapped and differentiated.

Sources: Ghanem and Spanos (1991), doi:10.1007/978-1-4612-3094-6, Section 2.3; Jiang et al. (2024),
doi:10.1016/j.compgeo.2024.106413, Eqs. 4 to 6.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from kl._checks import finite, floating, is_traced, positive, pytree, require
from kl.axis import (
    AveragedModes,
    AxisModes,
    Corrected,
    Covariance,
    Periodic,
    Solver,
    all_axis_modes,
    check_resolves,
    leading,
    length_leaves,
    resolved,
)
from kl.field._bedding import Bedding, rotated_box
from kl.field._selection import select
from kl.types import HostArray

_CONSTANT = "`Infinite()` is a field constant along an axis"


# Share of the variance in negative eigenvalues that a corrected correlation may have.
_INDEFINITE = 0.02


@pytree
@dataclass(frozen=True)
class Expansion:
    """Modes of a field on a box.

    Args:
        covariance: d correlation functions, one per axis; `with_covariance` makes their lengths differentiable.
        axes: eigenpairs of each axis, n_i of them.
        index: (d, M) numbers of the axes' modes that make up each mode, largest variance first.
        bedding: orientation of the axes of `covariance` for inclined strata, or None; static.
        solvers: one per axis; static.
        origin: lowest corner of the box (m), in rotated axes if there is bedding; static.
        extent: size of the box (m), in rotated axes if there is bedding; static.
    """

    covariance: tuple[Covariance, ...]
    axes: tuple[AxisModes, ...]
    index: Array
    bedding: Bedding | None = field(metadata={"static": True})
    solvers: tuple[Solver, ...] = field(metadata={"static": True})
    origin: tuple[float, ...] = field(metadata={"static": True})
    extent: tuple[float, ...] = field(metadata={"static": True})

    @property
    def modes(self) -> int:
        """Number of modes M, which is the number of coefficients of a sample."""
        return self.index.shape[1]

    @property
    def fractions(self) -> Array:
        """Share of the total variance in each mode (M,), largest first."""
        shares = [axis.fractions[row] for axis, row in zip(self.axes, self.index, strict=True)]
        return jnp.stack(shares).prod(axis=0)

    @property
    def variance_mean(self) -> float:
        """Captured variance, averaged over the box; 1 without truncation."""
        return float(self.fractions.sum())


def expand(
    covariance: tuple[Covariance, ...],
    origin: tuple[float, ...],
    extent: tuple[float, ...],
    *,
    energy: float | None = None,
    modes: int | None = None,
    solver: Solver | tuple[Solver | None, ...] | None = None,
    bedding: Bedding | None = None,
    dtype: DTypeLike | None = None,
) -> Expansion:
    """Expand a field with the product of `covariance` over the axes of a box.

    Args:
        covariance: one per axis, d = 1 to 3; in two dimensions the axes are (x, z).
        origin: d coordinates of the lowest corner of the box (m).
        extent: d sizes of the box (m).
        energy: share of the variance to keep, in (0, 1]; 0.999 unless `modes` is given.
        modes: number of modes to keep instead.
        solver: `Nystrom`, `Legendre`, `Haar` or `ClosedForm`, one for all axes or a tuple; None takes the most
            accurate for each axis.
        bedding: dip and strike of inclined strata; `covariance` then runs along dip, strike and normal.
        dtype: float32 or float64; by default that of the lengths.

    Returns:
        Expansion. `captured_variance` reports what the truncation leaves out.

    Raises:
        ValueError: If a length or extent is not above 0, energy is outside (0, 1], energy or modes exceed what the
            solvers give, a solver does not fit its covariance, a covariance is not positive definite, positions are too
            far from 0 for their precision, float64 is disabled, or a length is traced (expand outside the traced
            function and call `with_covariance` in it).

    Example:
        >>> import kl
        >>> covariance = kl.Exponential(20.0), kl.SquaredExponential(2.0)
        >>> field = kl.expand(covariance, origin=(0.0, 0.0), extent=(40.0, 10.0), energy=0.95)
        >>> 0.95 <= kl.captured_variance(field).mean <= 1.0
        True
    """
    covariance, origin, extent = _checked(covariance, origin, extent)
    if energy is not None and modes is not None:
        raise ValueError(f"energy = {energy} and modes = {modes}: give one of them")
    if modes is None:
        energy = 0.999 if energy is None else energy
        require(0 < energy <= 1, f"energy = {energy} is outside (0, 1]: give a share of the variance such as 0.999")
    else:
        require(modes >= 1, f"modes = {modes} must be 1 or more")
    if bedding is not None:
        origin, extent = rotated_box(bedding, origin, extent)
    per_axis = solver if isinstance(solver, tuple) else (solver,) * len(covariance)
    require(len(per_axis) == len(covariance), f"{len(per_axis)} solvers for {len(covariance)} axes: give one each")
    remainder = 0.0 if energy is None else (1 - energy) / (3 * len(covariance))
    most = modes if modes is not None else 2**31
    solvers = tuple(
        resolved(solver_of_axis, axis, size, remainder, most)
        for solver_of_axis, axis, size in zip(per_axis, covariance, extent, strict=True)
    )
    real = jnp.result_type(float, *jax.tree.leaves(covariance)) if dtype is None else floating(dtype)
    _check_near(covariance, origin, extent, real)
    covariance = jax.tree.map(lambda length: jnp.asarray(length, real), covariance)
    axes = all_axis_modes(covariance, solvers, origin, extent)
    fractions = [np.asarray(axis.fractions) for axis in axes]
    _require_positive_definite(covariance, fractions)
    index, _ = select(fractions, energy=energy, modes=modes)
    used = index.max(axis=1) + 1
    host_axes = jax.device_get(axes)
    axes = tuple(jax.device_put(leading(axis, int(count))) for axis, count in zip(host_axes, used, strict=True))
    return Expansion(covariance, axes, jax.device_put(index.astype(np.int32)), bedding, solvers, origin, extent)


RESOLVED = 0.02
"""Rounding of a position at most, over the shortest correlation length."""


def _check_near(
    covariance: tuple[Covariance, ...], origin: tuple[float, ...], extent: tuple[float, ...], real: DTypeLike
) -> None:
    """Raise ValueError for a box so far from 0 that positions are rounded to a part of a correlation length."""
    far = max(max(abs(low), abs(low + size)) for low, size in zip(origin, extent, strict=True))
    shortest = min((float(length) for axis in covariance for length in length_leaves(axis)), default=np.inf)
    rounding = float(jnp.finfo(real).eps) * far
    require(
        rounding <= RESOLVED * shortest,
        f"the box reaches to {far:g} m, where {jnp.dtype(real).name} rounds positions to {rounding:.2g} m, and the "
        f"shortest correlation length is {shortest:g} m: measure positions from a corner of the box",
    )


def _checked(
    covariance: tuple[Covariance, ...], origin: tuple[float, ...], extent: tuple[float, ...]
) -> tuple[tuple[Covariance, ...], tuple[float, ...], tuple[float, ...]]:
    covariance = tuple(covariance) if isinstance(covariance, tuple | list) else (covariance,)
    axes = len(covariance)
    require(1 <= axes <= 3, f"{axes} axes: give a covariance for each of 1 to 3 axes")
    require(
        len(origin) == axes and len(extent) == axes,
        f"origin {origin} and extent {extent} must have one number for each of {axes} axes",
    )
    if is_traced(covariance):
        raise ValueError("a correlation length is traced: expand outside and call `with_covariance` in the function")
    finite("origin", origin, remedy="it is the lowest corner of the box in metres")
    for size in extent:
        positive("extent", size, "m", remedy="it is the size of the box")
    for axis, size in zip(covariance, extent, strict=True):
        if isinstance(axis, Periodic):
            require(axis.period == size, f"period = {axis.period} must be the extent of its axis, {size}")
        for length in length_leaves(axis):
            require(np.ndim(length) == 0, f"correlation length of shape {np.shape(length)}: give one number")
            positive("correlation length", length, "m", remedy=_CONSTANT)
            if isinstance(axis, Periodic):
                require(length <= 20 * axis.period, f"length = {length} exceeds 20 periods: use `Infinite()`")
    return covariance, tuple(map(float, origin)), tuple(map(float, extent))


def _require_positive_definite(covariance: tuple[Covariance, ...], fractions: list[HostArray]) -> None:
    for axis, shares in zip(covariance, fractions, strict=True):
        limit = 1e2 * np.finfo(shares.dtype).eps * max(1.0, float(shares.max()))
        lost = -float(shares[shares < -limit].sum())
        # Nataf's correction often is indefinite by a little; the nearest covariance lacks the negative modes.
        allowed = _INDEFINITE if isinstance(axis, Corrected) else 0.0
        require(
            np.isfinite(shares).all() and lost <= allowed,
            f"{type(axis).__name__} is not positive definite (negative eigenvalues of {lost:.2e} of the variance): "
            "change the correlation function",
        )
        if lost > 0:
            warnings.warn(
                f"{type(axis).__name__} is not quite positive definite: negative eigenvalues of {lost:.2e} of the "
                "variance are left out",
                stacklevel=3,
            )


def with_covariance(expansion: Expansion, covariance: tuple[Covariance, ...]) -> Expansion:
    """The same modes (numbers, order, box) for another covariance of the same families; pure and differentiable.

    It differentiates a field with respect to its correlation lengths: eigenpairs are decomposed again, the selection of
    products does not change.

    Args:
        expansion: from `expand`.
        covariance: d correlation functions of its families, whose lengths may be traced. Traced lengths are to be no
            shorter than the solvers resolve, which are those of the expansion.

    Returns:
        Expansion with this covariance.

    Raises:
        ValueError: If a family differs, a length is not above 0, or one is shorter than the solvers resolve.
    """
    families = [type(family).__name__ for family in expansion.covariance]
    kinds = [type(family).__name__ for family in covariance]
    require(kinds == families, f"covariance of {kinds} for an expansion of {families}: give the same families")
    for correlation in covariance:
        for length in length_leaves(correlation):
            positive("correlation length", length, "m", remedy=_CONSTANT)
    for solver, correlation, old, size in zip(
        expansion.solvers, covariance, expansion.covariance, expansion.extent, strict=True
    ):
        check_resolves(solver, correlation, old, size)
    axes = all_axis_modes(covariance, expansion.solvers, expansion.origin, expansion.extent)
    solved = [leading(axis, old.fractions.shape[0]) for axis, old in zip(axes, expansion.axes, strict=True)]
    return replace(
        expansion,
        covariance=covariance,
        axes=tuple(
            replace(old, modes=axis) if isinstance(old, AveragedModes) else axis  # type: ignore[arg-type]
            for axis, old in zip(solved, expansion.axes, strict=True)
        ),
    )
