"""What a campaign and its estimator ask of each other.

An estimator is one frozen dataclass. Its fields are its settings, and those that a scene can give have the names of
keys of `[campaign]`; a script may give an object of its own instead. All its methods are pure functions of what
is known, so that the answer does not depend on what ran at once, in which order, or after which interruption.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import NoReturn, Protocol, runtime_checkable

import numpy as np

from cooperative.estimate._chains import Chains
from cooperative.estimate._estimates import Estimate

Answers = Mapping[int, bool | None]
"""Sample -> whether it failed on the refined grid; None where the run broke off undecided."""

Screened = Mapping[int, tuple[float, bool]]
"""Sample -> its largest displacement on the rough grid (m), and whether that run broke off."""


def _no_field() -> NoReturn:
    """Stand in for a field that is not known yet."""
    raise ValueError("the random field is not known yet: ask for coefficients once the scene is read")


@dataclass(frozen=True)
class Sampling:
    """What a scene has of the first phase.

    Args:
        samples: [campaign] samples.
        failure_displacement: beyond which a sample has failed (m).
        screening_stop: displacement at which a rough run ends (m), None where none does.
        modes: gives the number of coefficients of a sample.
        draw: gives the coefficients of all samples (samples, modes), by the design that the scene asks for, Latin
            hypercube or another. `check` and `rough_runs` do without `modes` and `draw`.
        rough_samples: of these, how many run on the rough grid, drawn by their displacement on a coarser one; None
            where all do.
        zones: what each of these stands for, by number; None where all run.
        shared: the audit that campaigns of the same samples have in common, None for one of its own.
    """

    samples: int
    failure_displacement: float
    screening_stop: float | None = None
    modes: Callable[[], int] = _no_field
    draw: Callable[[], np.ndarray] = _no_field
    rough_samples: int | None = None
    zones: Mapping[int, Zone] | None = None
    shared: SharedAudit | None = None


@dataclass(frozen=True)
class SharedAudit:
    """What the audits of several campaigns of the same samples have in common, see `cooperative.tools.sweep_audit`.

    Args:
        doubt: of each sample (samples,), to which its chance of a draw is proportional, but for the even share.
        model: probability of failure of each sample (samples,), from which the estimate of every campaign starts.
        certain: samples that run refined without a draw: their rough run broke off in one campaign or another.
        runs: refined runs of the audit in all, where another campaign decides it; None where the estimator does.
    """

    doubt: tuple[float, ...]
    model: tuple[float, ...]
    certain: tuple[int, ...] = ()
    runs: int | None = None


@dataclass(frozen=True)
class Zone:
    """Ranks on a coarser grid that a sample stands for, which was drawn from them.

    Args:
        weight: share of all samples that they are.
        score: normal score of the sample's rank there.
        single: weight of the sample there.
        samples: independent ones, of which the coarsest grid had all.
        earlier: the same of the grid before, None where the coarser grid had all samples.
    """

    weight: float
    score: float
    single: float
    samples: int
    earlier: Zone | None = None


@dataclass(frozen=True)
class Population:
    """Samples of the first phase.

    Args:
        rough_displacement: (N,) m.
        broke_off: (N,) bool, rough runs without a result.
        weight: (N,), summing to 1, equal if None.
        replicate: (N,) int, the independent runs of subset simulation that the samples came from; None if all N samples
            are independent.
        chains: which of the samples the chains of these runs visited, None where that is not known.
        number: (N,) int, of each sample in the campaign, 0 to N - 1 if None.
        failure_displacement: beyond which a sample has failed (m).
        zones: what each stands for of the samples of a coarser grid (N,), None where there is none.
        shared: the audit that campaigns of the same samples have in common, None for one of its own.
    """

    rough_displacement: np.ndarray = field(repr=False)
    broke_off: np.ndarray | None = field(default=None, repr=False)
    weight: np.ndarray | None = field(default=None, repr=False)
    replicate: np.ndarray | None = field(default=None, repr=False)
    chains: Chains | None = field(default=None, kw_only=True, repr=False)
    number: np.ndarray | None = field(default=None, repr=False)
    failure_displacement: float = 1.0
    zones: tuple[Zone, ...] | None = field(default=None, repr=False)
    shared: SharedAudit | None = None

    @property
    def size(self) -> int:
        """How many samples there are, N."""
        return int(np.size(self.rough_displacement))

    @property
    def independent(self) -> int:
        """Independent samples that these were drawn from; themselves where they were not drawn."""
        return self.size if self.zones is None else self.zones[0].samples

    @property
    def weights(self) -> np.ndarray:
        """Share of all samples that each is (N,)."""
        return np.full(self.size, 1 / self.size) if self.weight is None else np.asarray(self.weight)

    @property
    def numbers(self) -> np.ndarray:
        """Number of each sample in the campaign (N,)."""
        return np.arange(self.size) if self.number is None else np.asarray(self.number)


class Estimator(Protocol):
    """One way to a probability of failure.

    `Population` and `Answers` number the samples by their position in the population.

    Anything that has these methods and is a frozen dataclass runs in a campaign, see `cooperative.campaign.run`. One
    that refines some of the scene's own samples may derive from `SceneSamples`, which writes the first phase.
    """

    @property
    def name(self) -> str:
        """What a scene and messages call it."""

    def check(self, sampling: Sampling) -> None:
        """ValueError for settings that make no sense with this first phase, naming value, limit and remedy."""

    def rough_runs(self, sampling: Sampling) -> int:
        """Rough runs that the first phase takes in all."""

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Coefficients of the first samples of the first phase, as many as the rough results so far determine.

        Those without a result are run, and then the method is called again.

        Args:
            sampling: of the scene.
            screened: rough results so far.

        Returns:
            Coefficients (n, terms) of samples 0 to n - 1.
        """

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The first phase as the second sees it; None while it is not complete enough for that."""

    def budget(self, samples: int) -> int | None:
        """Most refined runs of a population of so many samples; None where it depends on the results."""

    def next_runs(self, population: Population, answers: Answers, lanes: int, under_way: Collection[int]) -> list[int]:
        """Samples to start on the refined grid now.

        Args:
            population: samples of the first phase.
            answers: of refined runs so far.
            lanes: in all.
            under_way: samples that are running.

        Returns:
            Samples; empty when nothing is to start, and with nothing under way when the campaign has ended.
        """

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """Probability of failure from what is known."""

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """Estimates on the way, first to last: how it came to where it is."""

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """What each refined run stands for; runs that stand for nothing may be left out."""

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """What other estimators make of the same runs, where that is allowed."""

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """Why no further refined run is asked for, in words; None where some still are."""


@dataclass(frozen=True)
class Failures:
    """Where the failures lie: (N,) each, by position in the population, or by rank.

    Args:
        number: of each sample in the campaign.
        weight: share of all samples that it is.
        chance: probability that it fails, by the estimator's own runs, 0 or 1 where one of them has its
            class.
        count: failures that the estimator counts there, as a share of all samples; they add up to about P_f, and single
            ones may be below 0.
    """

    number: np.ndarray = field(repr=False)
    weight: np.ndarray = field(repr=False)
    chance: np.ndarray = field(repr=False)
    count: np.ndarray = field(repr=False)

    @property
    def expected(self) -> np.ndarray:
        """Failures expected of each sample, as a share of all samples (N,)."""
        return self.weight * self.chance


@runtime_checkable
class Modelled(Protocol):
    """What an estimator has beside the rest that knows how likely samples fail which it did not run."""

    def failures(self, population: Population, answers: Answers) -> Failures:
        """Where the failures lie, by position in the population."""


def all_samples(sampling: Sampling, screened: Screened) -> Population | None:
    """The scene's own samples, each as good as another, or those drawn of them; None before the first result.

    Drawn ones stand for all only together: None until all of them have a result.

    Args:
        sampling: of the scene.
        screened: rough results.
    """
    if not screened or (sampling.zones is not None and sampling.zones.keys() - screened.keys()):
        return None
    number = np.array(sorted(screened if sampling.zones is None else sampling.zones), dtype=int)
    displacement, broke_off = (np.array([screened[int(n)][which] for n in number]) for which in (0, 1))
    zones = None if sampling.zones is None else tuple(sampling.zones[int(n)] for n in number)
    return Population(
        displacement,
        broke_off.astype(bool),
        weight=None if zones is None else np.array([zone.weight for zone in zones]),
        number=number,
        failure_displacement=sampling.failure_displacement,
        zones=zones,
        shared=sampling.shared,
    )
