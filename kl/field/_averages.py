"""Local averages: the field of means over cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kl._checks import require
from kl.axis import AveragedModes
from kl.field._expansion import Expansion


def averaged(expansion: Expansion, size: Sequence[float]) -> Expansion:
    """The expansion of a field's means over boxes around points.

    The mean of a standard Gaussian field has less variance, by Vanmarcke's variance function of the box. It is of the
    Gaussian field: of a lognormal property it gives the geometric mean over the box, so the median stays. At the ends
    of the box of the expansion the part inside counts. The coefficients are those of the field, so point values and
    means of one sample go together, and `kl.condition` takes means as data.

    Source: Vanmarcke (2010), Random Fields, World Scientific, Section 5.1.

    Args:
        expansion: from `kl.expand`; with bedding boxes lie along the strata.
        size: edges of the boxes (d,) m, 0 for no average along an axis.

    Returns:
        The expansion of the means.

    Raises:
        ValueError: If there is another number of edges, one is below 0, or means are averaged again.
    """
    require(len(size) == len(expansion.axes), f"size = {size}: give {len(expansion.axes)} edges, one per axis")
    require(all(0 <= edge < float("inf") for edge in size), f"size = {size}: give finite edges of 0 m or more")
    require(
        not any(isinstance(axis, AveragedModes) for axis in expansion.axes),
        "the expansion is of means: average the field",
    )
    axes = tuple(
        AveragedModes(axis, float(edge)) if edge > 0 else axis  # type: ignore[arg-type]
        for axis, edge in zip(expansion.axes, size, strict=True)
    )
    return replace(expansion, axes=axes)
