"""What a campaign measures before its first run, and tables that it wrote into the scene that its folder keeps."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Interval
from pydantic import Strict, computed_field
from pydantic import model_validator as validates

from cooperative.estimate import SharedAudit
from cooperative.scene.tables._key import AboveZero, Length, Pair, Part, Several, Text, key, table


@table
class Calibration(Part):
    """Factors of safety of the slope of median soil; the rough strength is multiplied by `factor`."""

    rough: AboveZero = key("On the rough grid.", 1.2)
    refined: AboveZero = key("On the refined grid.", 1.1)

    @validates(mode="before")
    @classmethod
    def _without_factor(cls, values: object) -> object:
        """A summary has the factor beside them."""
        return (
            {name: value for name, value in values.items() if name != "factor"} if isinstance(values, dict) else values
        )

    @computed_field  # type: ignore[prop-decorator]
    @property
    def factor(self) -> float:
        """Refined over rough factor of safety."""
        return self.refined / self.rough


@table
class LimitLoad(Part):
    """The limit load of the slope of median soil, on the refined grid."""

    factor: AboveZero = key("Factor of safety.", 1.2)
    displacement: Length = key("Displacement that goes with it.", 0.3)
    volume: AboveZero = key("Least volume that moves farther (m3, in a section m2).", 5.0)
    sharpness: AboveZero | None = key(
        "Growth of the displacement beyond the limit load, over that below.", 50.0, None, otherwise="not known"
    )
    local: Pair[AboveZero] | None = key(
        "Lowest reduction factor tried at which a slip of less than that volume moved, and the volume of that slip.",
        (1.1, 2.0),
        None,
        otherwise="none",
    )


Terms = Several[Annotated[int, Strict(), Ge(1)]]


@table
class Measured(Part):
    """What a campaign measures before its first run, None where it is not known.

    Args:
        terms: number of terms of each expansion of the random soil, in the order of `runs.RandomSoil.groups`.
        calibration: factors of safety of both grids.
        limit_load: where failure counts from it.
        shared: the audit that it has in common with the other campaigns of a sweep.
    """

    terms: Terms | None = None
    calibration: Calibration | None = None
    limit_load: LimitLoad | None = None
    shared: SharedAudit | None = None


MOST_RUNS = 2**31 - 1
"""Refined runs at most that a folder may allow."""
Runs = Annotated[int, Strict(), Interval(ge=1, le=MOST_RUNS)]


@table
class Budget(Part):
    """Refined runs that a campaign's folder allows, and those that its scene did.

    Args:
        refined_runs: allowed.
        scene: allowed by the scene.
    """

    refined_runs: Runs
    scene: Runs


@table
class LongerSlides(Part):
    """Until when a campaign's folder lets slides go on, later than its scene.

    Args:
        t_end: that time (s).
    """

    t_end: Annotated[float, Interval(gt=0, le=1e9)]


@table
class GivenEstimator(Part):
    """How the estimator describes itself that a script gave."""

    given: Text = key("In words.", "EveryKth(k=2)")
