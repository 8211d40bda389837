"""Local averages: the field of means over cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import jax.numpy as jnp

from kl._checks import require
from kl.axis import AveragedModes
from kl.field._expansion import Expansion
from kl.field._isotropic import Waves

_OF_MEANS = "the field is one of means: average the field itself"


@overload
def averaged(expansion: Expansion, size: Sequence[float]) -> Expansion: ...
@overload
def averaged(expansion: Waves, size: Sequence[float]) -> Waves: ...
def averaged(expansion: Expansion | Waves, size: Sequence[float]) -> Expansion | Waves:
    """The expansion, or the waves, of a field's means over boxes around points.

    The mean of a standard Gaussian field has less variance, by Vanmarcke's variance function of the box. It is of the
    Gaussian field: of a lognormal property it gives the geometric mean over the box, so the median stays. At the ends
    of the box of the expansion the part inside counts. The coefficients are those of the field, so point values and
    means of one sample go together, and `kl.condition` takes means as data.

    Source: Vanmarcke (2010), Random Fields, World Scientific, Section 5.1.

    Args:
        expansion: from `kl.expand`, with bedding its boxes lie along the strata; or from `isotropic`, whose boxes lie
            along the axes.
        size: edges of the boxes (d,) m, 0 for no average along an axis.

    Returns:
        The expansion, or the waves, of the means.

    Raises:
        ValueError: If there is another number of edges, one is below 0, or means are averaged again.
    """
    dimension = len(expansion.wavenumbers if isinstance(expansion, Waves) else expansion.axes)
    require(len(size) == dimension, f"size = {size}: give {dimension} edges, one per axis")
    require(all(0 <= edge < float("inf") for edge in size), f"size = {size}: give finite edges of 0 m or more")
    if isinstance(expansion, Waves):
        require(expansion.gains is None, _OF_MEANS)
        half_phase = expansion.wavenumbers * jnp.asarray(size, expansion.wavenumbers.dtype)[:, None] / 2
        return replace(expansion, gains=jnp.sinc(half_phase / jnp.pi).prod(axis=0))
    require(not any(isinstance(axis, AveragedModes) for axis in expansion.axes), _OF_MEANS)
    axes = tuple(
        AveragedModes(axis, float(edge)) if edge > 0 else axis  # type: ignore[arg-type]
        for axis, edge in zip(expansion.axes, size, strict=True)
    )
    return replace(expansion, axes=axes)
