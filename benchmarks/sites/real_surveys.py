"""What was surveyed of real slides, what published codes got, and an empirical relation; how intervals are scored.

The surveys stand in benchmarks/scenes/real/surveys.json, with their sources, and were committed before the first run of
their scene.

Corominas (1996), Canadian Geotechnical Journal 33, 260-271: log(H / L) = -0.085 log V - 0.047 for all landslides (not
found in a second source). The half width of its 95 % band is that of his four kinds of landslides together, as the
table in the public repository Diashc/landslide_runout_corominas has them: 0.253, 0.435, 0.386 and 0.512 of 47, 69, 71
and 17 slides.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist

from benchmarks.measure import ROOT

MISS = 0.1
"""Share of values that an interval leaves out."""

WIDEST = 3.0
"""Ratio of its ends from which on an interval does not count."""

BAND = math.sqrt((47 * 0.253**2 + 69 * 0.435**2 + 71 * 0.386**2 + 17 * 0.512**2) / 204)
"""Half width of Corominas's 95 % band in log10(H / L)."""


@dataclass(frozen=True)
class Survey:
    """One surveyed quantity.

    Args:
        low: least of its surveyed range, in m or, in a section, m2.
        high: largest.
        checked: whether a source was at hand that has it. What is derived from another assumption is not.
        published: what codes got, by their name.
        note: what it is, in words.
    """

    low: float
    high: float
    checked: bool = True
    published: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def value(self) -> float:
        """Middle of the range."""
        return (self.low + self.high) / 2


@dataclass(frozen=True)
class Known:
    """What is known of a slide.

    Args:
        surveys: by quantity. runout: from the toe to the front. retrogression: from the crest to the rear. travel: from
            the rear before to the front after. centre: displacement of the mass along its way, in a section along x.
            volume: of what slid. crest_loss: of the highest ground.
        crest: x of the crest of a section (m), None in 3D.
        fall: from its crown to where it came to rest (m), None where its travel was not surveyed.
        volume: for the empirical relation (m3), likewise.
        change: name of the file with its surveyed change of heights, None where there is none.
    """

    surveys: Mapping[str, Survey]
    crest: float | None
    fall: float | None
    volume: float | None
    change: str | None = None


def _known() -> Mapping[str, Known]:
    """The slides by name, from the file of surveys."""
    slides = json.loads((ROOT / "benchmarks" / "scenes" / "real" / "surveys.json").read_text(encoding="utf-8"))
    return {
        name: Known(
            {quantity: Survey(**survey) for quantity, survey in slide["surveys"].items()},
            slide.get("crest"),
            slide.get("fall"),
            slide.get("volume"),
            slide.get("change"),
        )
        for name, slide in slides.items()
    }


KNOWN = _known()


def interval_score(low: float, high: float, value: float, miss: float = MISS) -> float:
    """Interval score over the value: width, and 2 / miss times what it is missed by.

    Gneiting and Raftery (2007), Journal of the American Statistical Association 102, 359-378, Section 6.2. Divided by
    the value, so that metres of one slide and of another can be averaged.

    Args:
        low: end of the interval.
        high: the other.
        value: that came true, above 0, in the same unit.
        miss: share that the interval leaves out.
    """
    missed = max(low - value, 0.0) + max(value - high, 0.0)
    return (high - low + 2 / miss * missed) / value


def holds(low: float, high: float, value: float) -> bool:
    """Whether an interval holds a value and is narrow enough to count."""
    return low <= value <= high and high <= WIDEST * low


def corominas(fall: float, volume: float, miss: float = MISS) -> tuple[float, float, float]:
    """Travel distance (m) by the relation for all landslides: lower end, middle, upper end.

    Args:
        fall: H (m).
        volume: V (m3).
        miss: share that the interval leaves out.
    """
    middle = -0.085 * math.log10(volume) - 0.047
    half = BAND * NormalDist().inv_cdf(1 - miss / 2) / NormalDist().inv_cdf(0.975)
    return fall / 10 ** (middle + half), fall / 10**middle, fall / 10 ** (middle - half)
