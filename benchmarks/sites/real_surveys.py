"""What was surveyed of real slides, what published codes got, and an empirical relation; how intervals are scored.

Committed before the first run of the scenes in benchmarks/scenes/real.

Sources of the surveys: NOAA/NGDC hazard photographs, picture 404 (Leyendecker, U.S. Geological Survey): 800,000 cubic
yards over 1,800 feet, 30 feet of height lost. Seed, Makdisi, Idriss and Lee (1975), ASCE Journal of the Geotechnical
Engineering Division 101(7), 651-688: 5 feet of freeboard left; 4 feet in the repository that the scene names. Del
Castillo, Borja and Favero Neto (2026), International Journal for Numerical and Analytical Methods in Geomechanics,
Section 6. Landlab's DEM_of_Difference.asc, of Keck et al. (2024), Earth Surface Dynamics 12, 1165-1186.

Corominas (1996), Canadian Geotechnical Journal 33, 260-271: log(H / L) = -0.085 log V - 0.047 for all landslides (not
found in a second source). The half width of its 95 % band is that of his four kinds of landslides together, as the
table in the public repository Diashc/landslide_runout_corominas has them: 0.253, 0.435, 0.386 and 0.512 of 47, 69, 71
and 17 slides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist

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
    """

    low: float
    high: float
    checked: bool = True
    published: Mapping[str, float] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """Middle of the range."""
        return (self.low + self.high) / 2


@dataclass(frozen=True)
class Known:
    """What is known of a slide.

    Args:
        surveys: by quantity. runout: from the toe to the front. retrogression: from the crest to the rear. travel: from
            the rear before to the front after. centre: of the mass along its way. volume: of what slid. crest_loss: of
            the highest ground.
        fall: from its crown to where it came to rest (m).
        volume: for the empirical relation (m3).
    """

    surveys: Mapping[str, Survey]
    fall: float
    volume: float


SPH = "SPH, u-pw, softening 5"
KNOWN = {
    "lower_san_fernando_1971": Known(
        {
            # Often quoted as 150 to 200 feet beyond the toe; no source of it was at hand.
            "runout": Survey(45.7, 61.0, checked=False),
            # From the crest, 97 m from the toe, whose lower side went too (NOAA).
            "travel": Survey(142.7, 165.0, checked=False),
            # 30 feet; 349.5 m less a reservoir at 338.4 m and 1.2 to 1.5 m of freeboard.
            "crest_loss": Survey(9.1, 9.9),
            # 611,600 m3 over 549 m, "as much as".
            "volume": Survey(1115.0, 1115.0),
        },
        fall=41.8,
        volume=611_600.0,
    ),
    "sainte_monique_1994": Known(
        {
            "runout": Survey(50.0, 50.0, published={SPH: 52.0}),
            "retrogression": Survey(100.0, 100.0, published={SPH: 116.0}),
            # With a face 36 m long, of the assumed height.
            "travel": Survey(186.0, 186.0, checked=False, published={SPH: 204.0}),
        },
        fall=16.0,
        volume=160_000.0,  # as wide as it went back (assumed)
    ),
    "s1000_2021": Known(
        {
            # Along the scene's run-out line, to the last square that changed.
            "travel": Survey(821.0, 841.0),
            # From the centre of what the scar lost to that of what was laid down below it.
            "centre": Survey(401.0, 401.0),
            "volume": Survey(21_070.0, 22_481.0),
        },
        fall=237.0,
        volume=21_070.0,
    ),
}


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
