"""What the slides of a campaign do, as values: modes, means, elements at risk, losses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cooperative.estimate._fits import Fits, Severity
from cooperative.estimate._means import Exceedance


@dataclass(frozen=True)
class ModeShare:
    """A failure mode.

    Args:
        count: refined runs that failed so.
        ratio: weighted share of the failures.
        interval: confidence limits of the share.
        probability: that a sample fails so.
    """

    count: int
    ratio: float
    interval: tuple[float, float]
    probability: float


@dataclass(frozen=True)
class CutOff:
    """Slides that ended before they came to rest.

    Args:
        of: slides that count.
        at_t_end: those that moved still when they ended.
        broke_off: those that ended for numerical reasons.
        t_end: up to when slides may go on (s).
    """

    of: int
    at_t_end: int
    broke_off: int
    t_end: float


@dataclass(frozen=True)
class Spread:
    """A consequence over the slides.

    Args:
        mean: weighted.
        interval: its confidence limits, None for too few slides.
        smallest: of all slides.
        largest: of all slides.
        at_least: whether the slides would have gone on.
    """

    mean: float
    interval: tuple[float, float] | None
    smallest: float
    largest: float
    at_least: bool


@dataclass(frozen=True)
class Reached:
    """Probability that a slide reaches an element at risk, or carries it away.

    Args:
        probability: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    probability: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class ElementLoss:
    """Expected loss at one element at risk.

    Args:
        value: what it is worth.
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    value: float
    expected: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class SampleLoss:
    """A sample that is part of the loss.

    Args:
        sample: its number.
        loss: if it fails.
        share: of the expected loss.
    """

    sample: int
    loss: float
    share: float


@dataclass(frozen=True)
class Loss:
    """Expected loss at all elements at risk together.

    Args:
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
        exceedance: probability of losing more.
        modes: share of the loss by failure mode.
        samples: those with the largest shares.
    """

    expected: float
    interval: tuple[float, float]
    at_least: bool
    exceedance: Exceedance
    modes: Mapping[str, float]
    samples: tuple[SampleLoss, ...]


@dataclass(frozen=True)
class Element:
    """Effects on one element at risk.

    What hits it is soil that lies or moves above the surface that was there before; what carries it away is a
    displacement of its own ground.

    Args:
        reached: probability that soil arrives above its ground.
        thickness: largest of that soil, of the slides that arrive (m), None where none does.
        speed: largest of that soil, of the slides that arrive (m/s), None where none does.
        arrival: of the slides that arrive (s), None where none does.
        loss: by what hits it, None where the scene gives no value.
        carried: probability that its ground moves by the failure displacement or more.
        ground: displacement of its ground, of the slides that carry it away (m), None where none does.
    """

    reached: Reached
    thickness: Spread | None
    speed: Spread | None
    arrival: Spread | None
    loss: ElementLoss | None
    carried: Reached
    ground: Spread | None


@dataclass(frozen=True)
class Risk:
    """Risk of the elements at risk.

    Args:
        places: effects by name of the element, None each while nothing is known of them.
        loss: of all together, None where no element has a value.
    """

    places: Mapping[str, Element | None]
    loss: Loss | None


@dataclass(frozen=True)
class Effects:
    """What the slides do; each field as in `cooperative.Summary`.

    Args:
        cut_off: slides that had not come to rest.
        modes: by name, None where the rows have none.
        consequences_of_failures: by name, None where no slide has it.
        exceedance: curves by consequence.
        risk: of the elements at risk, None without any.
        fits: by group and consequence.
        severity: modes by the median of each consequence.
    """

    cut_off: CutOff
    modes: Mapping[str, ModeShare] | None
    consequences_of_failures: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    risk: Risk | None
    fits: Mapping[str, Mapping[str, Fits]]
    severity: Mapping[str, tuple[Severity, ...]]
