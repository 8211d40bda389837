"""The table of a water level that is drawn with each sample."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Self

import jax.numpy as jnp
import numpy as np
from pydantic import model_validator as validates

import kl
from cooperative.scene.tables._key import Length, Metres, Part, key, one_of, table
from cooperative.scene.tables._varying import MARGINALS, check_bounds
from jaxmpm.support.check import Invalid

LEVELS = {name: MARGINALS[name] for name in ("normal", "truncated normal", "uniform", "gumbel", "beta")}
"""Families that keep their shape when the zero of heights moves."""
AWAY = 100.0
"""Deviations by which levels are shifted above 0. The families do not change, but for bounds, which shift too."""


@table
class RandomLevel(Part):
    """A water level that is drawn with each sample, as the level at which the sample stands from the start.

    The initial stress of each sample is solved with its own level, and soil below it has its saturated weight. A
    `strength_ratio` refers to the mean level, under which soil has consolidated.
    """

    mean: Metres = key("Mean.", 3.0)
    sd: Length = key("Standard deviation.", 0.5)
    marginal: Annotated[type, one_of(LEVELS)] = key("Distribution.", "normal", "normal")
    lower: Metres | None = key("Lower bound, where the family has one.", 1.0, None, otherwise="none")
    upper: Metres | None = key("Upper bound, likewise.", 5.0, None, otherwise="none")

    @validates(mode="after")
    def _distribution(self) -> Self:
        check_bounds(self.marginal, self.lower, self.upper)
        try:
            kl.marginal.check_marginal(self._shifted)
        except ValueError as error:
            ends = f" between {self.lower} and {self.upper} m" if (self.lower, self.upper) != (None, None) else ""
            raise Invalid(
                ("sd",), f"{self.sd:g} m", f"about mean = {self.mean:g} m cannot be had{ends}",
                "give less, or other bounds",
            ) from error  # fmt: skip
        return self

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
