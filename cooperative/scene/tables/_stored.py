"""Tables that a campaign wrote into the scene that its folder keeps, and numbers that its folder keeps in files."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge

from cooperative.scene.tables._key import AboveZero, Length, Several, Table, key


class Calibration(Table):
    """Factors of safety of the slope of median soil."""

    rough: AboveZero = key("On the rough grid.", 1.2)
    refined: AboveZero = key("On the refined grid.", 1.1)


class LimitLoad(Table):
    """The limit load of the slope of median soil."""

    factor: AboveZero = key("Factor of safety.", 1.2)
    displacement: Length = key("Displacement that goes with it.", 0.3)
    volume: AboveZero | None = key("Least volume that moves farther (m3, in a section m2).", 5.0, None)


Terms = Several[Annotated[int, Ge(1)]]


class FieldModes(Table):
    """How many terms each expansion of the random soil has."""

    counts: Terms = key("Of each expansion.", [242])


class Measured(Table):
    """What a campaign measured before its first run, in the file of its folder."""

    terms: Terms | None = key("Number of terms of each expansion of the random soil.", [242], None)
    calibration: Calibration | None = key("Factors of safety.", {"rough": 1.2, "refined": 1.1}, None)
    limit_load: LimitLoad | None = key("Limit load.", {"factor": 1.2, "displacement": 0.3}, None)


class Defaults(Table):
    """Defaults of both grids and of the soil that were others once, as they were at the campaign's start. A key that it
    lacks is younger than the campaign."""

    cfl: AboveZero = key("Of both grids.", 0.5)
    gap_memory: bool = key("Of the soil.", False, False)


class GivenEstimator(Table):
    """How the estimator describes itself that a script gave."""

    given: str = key("In words.", "EveryKth(k=2)")
