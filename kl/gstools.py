"""Models of GSTools as covariances of `kl`, and back; needs the package gstools.

A GSTools model is isotropic in its own scaled and turned axes, with a variance and a nugget. A field of `kl.expand` is
a product over the axes, which is the same for the Gaussian family alone. `waves_of` gives the isotropic field.

Words: GSTools' `len_scale` times its `rescale` is the length here, `anis` are ratios of the other axes' lengths to the
first one's, `var` is the square of a marginal's deviation, `Gaussian` is the squared exponential, and `Linear` in one
dimension is triangular.
"""

from __future__ import annotations

import math
from typing import Any

from kl._checks import require
from kl.axis import (
    Covariance,
    Exponential,
    Matern32,
    Matern52,
    SquaredExponential,
)
from kl.field import Waves, isotropic

SMOOTHNESS: dict[type, float] = {
    family: family.smoothness for family in (Exponential, Matern32, Matern52, SquaredExponential)
}
"""Smoothness of each family that is a Matern one."""


def lengths_of(model: Any) -> tuple[float, ...]:
    """The length of a model along each of its axes (m), as the family of the same smoothness has it in `kl`.

    Args:
        model: a `gstools.CovModel` without rotation.

    Raises:
        ValueError: If it is rotated, or of another kind than Gaussian, Exponential and Matern.
    """
    require(not any(model.angles), f"angles = {list(model.angles)}: a turned model has no axes of its own here")
    smoothness, name = _smoothness(model), type(model).__name__
    # GSTools' Matern correlation has sqrt(nu) where that of `kl` has sqrt(2 nu).
    factor = math.sqrt(2) if name == "Matern" and not math.isinf(smoothness) else 1.0
    factor = 2.0 if name == "Matern" and math.isinf(smoothness) else factor
    ratios = [1.0, *model.anis]
    return tuple(float(model.len_scale * ratio / model.rescale * factor) for ratio in ratios)


def _smoothness(model: Any) -> float:
    name = type(model).__name__
    smoothness = {"Gaussian": math.inf, "Exponential": 0.5}
    if name == "Matern":
        return math.inf if model.nu > 20 else float(model.nu)  # GSTools takes the Gaussian limit there
    require(name in smoothness, f"a model of the kind {name}: give a Gaussian, Exponential or Matern one")
    return smoothness[name]


def from_gstools(model: Any) -> tuple[tuple[Covariance, ...], float, float]:
    """A model as one covariance for each axis, whose product agrees with it along the axes.

    Args:
        model: a `gstools.CovModel` without rotation, Gaussian, Exponential, or Matern with nu = 1/2, 3/2 or 5/2.

    Returns:
        Covariances for `kl.expand`, the variance of the field, and the nugget.

    Raises:
        ValueError: If it is another one.
    """
    smoothness = _smoothness(model)
    families = {value: family for family, value in SMOOTHNESS.items()}
    require(
        smoothness in families,
        f"nu = {smoothness:g}: `kl` has products of 1/2, 3/2 and 5/2; `waves_of` gives any as an isotropic field",
    )
    covariance = tuple(families[smoothness](length) for length in lengths_of(model))
    return covariance, float(model.var), float(model.nugget)


def waves_of(model: Any, *, waves: int = 1024, seed: int = 0) -> tuple[Waves, float, float]:
    """A model as an isotropic field.

    Args:
        model: a `gstools.CovModel` without rotation, Gaussian, Exponential or Matern.
        waves: as in `kl.field.isotropic`.
        seed: as in `kl.field.isotropic`.

    Returns:
        The field, its variance, and the nugget.

    Raises:
        ValueError: If it is another one.
    """
    field = isotropic(_smoothness(model), lengths_of(model), waves=waves, seed=seed)
    return field, float(model.var), float(model.nugget)


def to_gstools(covariance: tuple[Covariance, ...], *, variance: float = 1.0, nugget: float = 0.0) -> Any:
    """The model of GSTools that agrees with a product of covariances along its axes.

    Args:
        covariance: of one family, one per axis.
        variance: of the field.
        nugget: variance that is independent from point to point.

    Returns:
        `gstools.CovModel`.

    Raises:
        ValueError: If the families differ, or GSTools has none of the kind.
    """
    import gstools

    first, *others = covariance
    require(
        all(type(model) is type(first) for model in others), "covariances of several families: give one for all axes"
    )
    smoothness = SMOOTHNESS.get(type(first))
    require(smoothness is not None, f"{type(first).__name__}: give one of {[kind.__name__ for kind in SMOOTHNESS]}")
    lengths = [float(model.length) for model in covariance]  # type: ignore[attr-defined]
    shared = {"dim": len(covariance), "var": variance, "nugget": nugget, "rescale": 1.0}
    if type(first) is SquaredExponential:
        return gstools.Gaussian(len_scale=lengths, **shared)
    if type(first) is Exponential:
        return gstools.Exponential(len_scale=lengths, **shared)
    return gstools.Matern(len_scale=[length / math.sqrt(2) for length in lengths], nu=smoothness, **shared)
