"""The annual probability of failure of classes of storms, each with how often it comes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cooperative.estimate import annual
from cooperative.scene import Campaign
from cooperative.tools.in_time._answer import InTime


@dataclass(frozen=True)
class Annual:
    """The probability that the slope fails in a year.

    Args:
        probability: that one storm or more of a year lets it fail.
        interval: of it.
        classes: name, storms a year and failures a year of each class.
    """

    probability: float
    interval: tuple[float, float]
    classes: tuple[tuple[str, float, float], ...]


def check_classes(storms: Mapping[str, Campaign]) -> None:
    """Check that it is known how often the storms of each class come.

    Args:
        storms: campaigns by the name of their class; one alone needs no frequency.

    Raises:
        ValueError: a class has none.
    """
    lacking = [name for name, storm in storms.items() if storm.plan.annual_frequency is None]
    if len(storms) > 1 and lacking:
        raise ValueError(
            f"annual_frequency is not known of {', '.join(lacking)}: give how often a year such a storm comes, in "
            '[campaign] of the scene and as "campaign.annual_frequency" = 0.02 in each [[scenario]]'
        )


def annual_in_time(results: Mapping[str, InTime]) -> Annual:
    """The annual probability of failure by classes of storms that come at random, each with its `annual_frequency`.

    1 - exp(-sum of frequency x P_f), with the P_f of each class by the last of its times. The classes may share their
    samples, so that their errors add up: the ends of the interval are those of all intervals together.

    Args:
        results: of `probability_in_time`, by the name of the class.

    Raises:
        ValueError: a class has no annual_frequency.
    """
    check_classes({name: result.campaign for name, result in results.items()})
    often = [float(result.campaign.plan.annual_frequency or 0.0) for result in results.values()]
    last = [result.estimates[-1] for result in results.values()]

    def total(chances: Sequence[float]) -> float:
        return annual(1.0, sum(rate * chance for rate, chance in zip(often, chances, strict=True)))

    low, high = zip(*(estimate.interval for estimate in last), strict=True)
    chances = [estimate.probability for estimate in last]
    return Annual(
        total(chances), (total(low), total(high)),
        tuple((name, rate, rate * chance) for name, rate, chance in zip(results, often, chances, strict=True)),
    )  # fmt: skip


def lines_of_year(year: Annual) -> Iterator[str]:
    """The annual probability in words, for a terminal.

    Args:
        year: of `annual_in_time`.
    """
    yield "  storms     a year   failures a year"
    for name, often, failures in year.classes:
        yield f"  {name:<10} {often:6.3g}   {failures:.3g}"
    low, high = year.interval
    yield f"  annual probability of failure {year.probability:.3g} ({low:.3g} to {high:.3g})"
