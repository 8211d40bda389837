"""A water level that is drawn with each sample."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

import kl
from cooperative.scene import tables

AWAY = 100.0
"""Deviations by which levels are shifted above 0. The families do not change, but for bounds, which shift too."""


@dataclass(frozen=True)
class RandomLevel:
    """Distribution of the height of the water.

    Args:
        mean: m.
        sd: standard deviation (m).
        marginal: class of `kl`.
        lower: bound of a marginal that has one (m).
        upper: bound of a marginal that has one (m).
    """

    mean: float
    sd: float
    marginal: type = kl.Normal
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        try:
            kl.marginal.check_marginal(self._shifted)
        except ValueError as error:
            ends = f" between {self.lower} and {self.upper} m" if (self.lower, self.upper) != (None, None) else ""
            raise ValueError(
                f"sd = {self.sd:g} m about mean = {self.mean:g} m cannot be had{ends}: give less, or other bounds"
            ) from error

    @property
    def _shifted(self) -> kl.marginal.Marginal:
        """The distribution `_up` metres higher."""
        mean = self.mean + self._up
        bounds = {"lower": self.lower, "upper": self.upper}
        shifted = {end: at + self._up for end, at in bounds.items() if at is not None}
        distribution: kl.marginal.Marginal = self.marginal(mean, self.sd / mean, **shifted)
        return distribution

    @property
    def _up(self) -> float:
        return AWAY * self.sd - self.mean

    def at(self, score: float) -> float:
        """The level (m) of a standard normal score."""
        return float(np.asarray(self._shifted.transform(jnp.asarray(score)))) - self._up

    def raised(self, by: float) -> RandomLevel:
        """The distribution of levels that are all so much higher (m)."""
        lower, upper = (None if end is None else end + by for end in (self.lower, self.upper))
        return replace(self, mean=self.mean + by, lower=lower, upper=upper)


def random_level(water: tables.Water | None) -> RandomLevel | None:
    """The distribution of the level that a scene gives, None where it gives a number or none.

    Args:
        water: table of the scene.

    Raises:
        ValueError: bounds that exclude the mean, or the deviation.
    """
    if water is None or not isinstance(water.level, tables.Level):
        return None
    try:
        return RandomLevel(**dict(water.level))
    except ValueError as error:
        raise ValueError(f"[water.level]: {error}") from error
