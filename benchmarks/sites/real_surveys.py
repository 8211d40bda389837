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

import numpy as np

from benchmarks.measure import ROOT

MISS = 0.1
"""Share of values that an interval leaves out."""

POINTS = 201
"""Values of a surveyed range over which a score is averaged."""

BAND = math.sqrt((47 * 0.253**2 + 69 * 0.435**2 + 71 * 0.386**2 + 17 * 0.512**2) / 204)
"""Half width of Corominas's 95 % band in log10(H / L)."""


@dataclass(frozen=True)
class Survey:
    """One surveyed quantity.

    Args:
        low: least of its surveyed range, in m or, in a section, m2.
        high: largest.
        checked: whether a source was at hand that has it. What is derived from another assumption is not.
        scored: whether it counts. What was given, what is another quantity once more, what is of no section, and what
            depends on a number that nobody published does not; the note says which.
        published: what codes got, by their name.
        note: what it is, in words.
    """

    low: float
    high: float
    checked: bool = True
    scored: bool = True
    published: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def value(self) -> float:
        """Middle of the range."""
        return (self.low + self.high) / 2

    @property
    def values(self) -> np.ndarray:
        """Values over the range (n,)."""
        return np.linspace(self.low, self.high, POINTS)


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


def _surveyed_slides() -> Mapping[str, Known]:
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


KNOWN = _surveyed_slides()


def interval_score(low: float, high: float, survey: Survey, miss: float = MISS) -> float:
    """Interval score over the surveyed value: width, and 2 / miss times what it is missed by.

    Gneiting and Raftery (2007), 10.1198/016214506000001437, Section 6.2. It is the mean over the surveyed range, and
    divided by the middle of that, so that metres of one slide and of another can be averaged.

    Args:
        low: end of the interval.
        high: the other.
        survey: what came true, above 0, in the same unit.
        miss: share that the interval leaves out.
    """
    missed = np.maximum(low - survey.values, 0.0) + np.maximum(survey.values - high, 0.0)
    return float((high - low + 2 / miss * missed.mean()) / survey.value)


def crps(slides: np.ndarray, weight: np.ndarray, survey: Survey) -> float:
    """Continuous ranked probability score over the surveyed value, likewise: that of the slides, all in one number.

    E|X - y| - E|X - X'| / 2, Gneiting and Raftery (2007), Section 4.2.

    Args:
        slides: the quantity of each slide (n,).
        weight: what each stands for (n,).
        survey: what came true, in the same unit.
    """
    share = weight / weight.sum()
    missed = share @ np.abs(slides[:, None] - survey.values).mean(axis=1)
    spread = share @ np.abs(slides[:, None] - slides) @ share
    return float((missed - spread / 2) / survey.value)


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
