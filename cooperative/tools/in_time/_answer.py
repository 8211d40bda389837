"""Samples asked at times whether they stand: screened by slices, bisected on the rough grid, audited on the refined.

A sample has failed at a time if it fails under the pore pressure of that time or of one before. Factors of safety by
slices say at which times it may fail first, those with a lower factor than all before. Among these its first failure
is found by bisection, from where slices expect it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import repeat
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Bracket, Estimate, critical_factor, first_guess, in_time, record_lows
from cooperative.names import GRIDS
from cooperative.scene import Campaign, check_samples, in_folder, rested
from cooperative.store import SLIDES_IN_TIME, FinishedRun, open_store
from cooperative.tools.in_time._kept import Kept
from cooperative.tools.safety import Method, Slices, critical_surface, sample_strength, slices_at_rest
from cooperative.tools.seepage import in_hours
from jaxmpm.support.text import printable

FEWEST = 20
"""Refined samples at least."""
SHARE = 0.2
"""Of the samples that run refined too, where nobody says how many."""
PILOT = 10
"""Samples from whose rough runs the critical factor by slices follows."""
SURFACES = 3
"""Critical surfaces of the mean soil, of as many states, by which samples are screened."""


@dataclass(frozen=True)
class InTime:
    """The probability of failure against time.

    Args:
        campaign: of the scene.
        times: (m,) s.
        estimates: of each time.
        rough: number of the time at which each sample fails first (n,) on the rough grid, m for never, -1 where a run
            broke off.
        refined: the same on the refined grid, of those samples that ran on it.
        factors: of safety of each sample at each time (n, m) by slices, nan where there are none.
        runs: on each grid.
    """

    campaign: Campaign
    times: tuple[float, ...]
    estimates: tuple[Estimate, ...]
    rough: np.ndarray
    refined: dict[int, int]
    factors: np.ndarray
    runs: dict[str, int]

    @property
    def grid(self) -> str:
        """The finest grid that was asked."""
        return "refined" if self.refined else "rough"

    @property
    def first(self) -> dict[int, int]:
        """Number of the time at which samples fail first on that grid, of those that fail."""
        first_failures = self.refined or dict(enumerate(self.rough.tolist()))
        return {sample: at for sample, at in first_failures.items() if 0 <= at < len(self.times)}

    def counts(self, grid: str) -> np.ndarray:
        """Samples that fail first at each time on a grid (m,).

        Args:
            grid: "rough" or "refined".
        """
        first = self.rough if grid == "rough" else np.array([*self.refined.values()], int)
        return np.array([int((first == at).sum()) for at in range(len(self.times))])


@dataclass(frozen=True)
class WaterState:
    """The ground under the pore pressure of a time.

    Args:
        words: for its time, and for its load where there are several.
        campaign: whose water moves.
        time: s.
        load: number of the load of a chart that moves it.
    """

    words: str
    campaign: Campaign
    time: float
    load: int = 0

    @cached_property
    def resting(self) -> Campaign:
        """The campaign whose ground rests there."""
        return rested(self.campaign, self.time)

    @cached_property
    def drained(self) -> Campaign:
        """The same, of which samples are asked whether they stand: soil with a B-value drains until it fails."""
        return self.resting.drained()


@dataclass
class StateRunner:
    """Runs samples in states of the ground: on models in this process, or by workers."""

    campaign: Campaign
    states: Sequence[WaterState]
    kept: Kept
    workers: runs.Workers | None
    stop: runs.Stop

    @cached_property
    def soil(self) -> runs.RandomSoil:
        return runs.random_soil(self.campaign)

    @cached_property
    def coefficients(self) -> np.ndarray:
        return runs.coefficients_of(self.campaign, self.soil)

    @cached_property
    def models(self) -> dict[tuple[str, int, bool], runs.GridModel]:
        return {}

    def run(self, grid: str, at: int, numbers: Sequence[int], stop_at: float | None) -> Iterator[FinishedRun]:
        """Samples that begin at rest in a state, and are drained to a displacement (m) or slide to their end (None)."""
        resting = self.states[at].resting if stop_at is None else self.states[at].drained
        rules = resting.rules(stop_at)
        if self.workers is not None:
            packed = runs.packed(resting)
            yield from runs.run_through(
                self.workers, packed, grid, numbers, self.coefficients, rules=rules, check=self.stop.check
            )
            return
        key = grid, at, resting is self.states[at].resting
        if key not in self.models:
            self.models[key] = runs.build(resting, grid, self.soil)
        model = self.models[key]
        yield from runs.run_samples(model, self.coefficients, numbers, rules=rules, stop=self.stop.requested)

    def ask(self, grid: str, at: int, numbers: Sequence[int]) -> Iterator[tuple[int, bool | None]]:
        """Whether samples fail in a state, None for runs that broke off."""
        limit = self.campaign.run.failure_displacement
        for sample in self.run(grid, at, numbers, limit):
            displacement, broke_off = sample.result
            yield sample.number, None if broke_off and displacement <= limit else displacement > limit
            self.stop.check()


class NothingRuns(runs.Stop):
    """A stop where all has been asked that there is, and nothing is to run.

    folder: that has the answers.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder

    def check(self) -> None:
        """Raise ValueError, as something would have to run."""
        raise ValueError(
            f"not all samples of {self.folder} have run to their end yet: `jaxmpm resume {self.folder}` goes on"
        )


def probability_in_time(
    campaign: Campaign,
    folder: Path,
    *,
    refined_runs: int | None = None,
    workers: int = 1,
    progress: Callable[[str], None] = lambda line: None,
) -> InTime:
    """The probability that a slope has failed by each time of its rain or drawdown.

    All samples run on the rough grid at one or two times, most of them; the first of them on the refined grid too, from
    where the rough grid has their failure. What has run is kept in the folder, and the same call goes on from there.

    Args:
        campaign: with rain or drawdown.
        folder: to keep answers in.
        refined_runs: samples on the refined grid; None for a fifth of them, at least 20; 0 for none.
        workers: processes that run samples.
        progress: called with a line after each round.

    Returns:
        Estimates at each time, and when each sample fails.

    Raises:
        ValueError: no water moves in the scene, nothing is random, or the folder is of another scene.
    """
    audited = audited_samples(campaign, refined_runs)
    with running(campaign, states_in_time(campaign), folder / SLIDES_IN_TIME, audited, workers) as runner:
        return answered(runner, progress)


def states_in_time(campaign: Campaign) -> list[WaterState]:
    """States of the ground at the times of a campaign."""
    assert campaign.seepage is not None
    return [WaterState(in_hours(time), campaign, time) for time in campaign.seepage.times]


def answered(runner: StateRunner, progress: Callable[[str], None]) -> InTime:
    """The probability by each time, from what is kept and what runs."""
    factors = screened(runner, progress)
    lows = [record_lows(row) for row in factors]
    rough, refined = first_failures(runner, factors, lows, progress)
    complete = factors if np.isfinite(factors).all() else None
    estimates = in_time(rough, refined if runner.kept.audited else None, complete, len(runner.states))
    return InTime(
        runner.campaign, tuple(state.time for state in runner.states), tuple(noted(estimates, rough, refined)), rough,
        refined, factors, {grid: runner.kept.count(grid) for grid in GRIDS},
    )  # fmt: skip


def audited_samples(campaign: Campaign, refined_runs: int | None) -> int:
    """How many samples run on the refined grid; ValueError for a campaign that has no answer as its water moves."""
    if campaign.seepage is None:
        raise ValueError("no water moves in the scene: add [rain] or [drawdown]")
    check_samples(campaign)
    if campaign.run.failure == "limit load" and campaign.measured.limit_load is None:
        raise ValueError("failure = 'limit load' is of one state of the water: give failure_displacement instead")
    if campaign.plan.calibrate:
        raise ValueError(
            "calibrate = true is of one state of the water: the refined runs correct the rough ones instead"
        )
    campaign.drained()  # refuses B-values that are random
    samples = campaign.plan.samples
    audited = min(samples, max(FEWEST, round(SHARE * samples)) if refined_runs is None else refined_runs)
    if 0 < audited < min(10, samples):
        raise ValueError(f"{audited} refined samples: give 10 or more, or 0 for the rough grid alone")
    return audited


@contextmanager
def running(
    campaign: Campaign, states: Sequence[WaterState], folder: Path, audited: int, workers: int, *, chart: bool = False
) -> Iterator[StateRunner]:
    """A runner whose answers the folder keeps, until the block ends.

    Args:
        campaign: whose samples are asked.
        states: to ask them in.
        folder: to keep answers in.
        audited: samples to ask on the refined grid too.
        workers: processes that run samples.
        chart: whether the states are of loads of a chart.
    """
    runs.refuse_unguarded(workers)
    _, source = in_folder(campaign, folder, None, None)
    pool = None if workers == 1 else runs.Workers(partial(runs.process_pool, workers), workers, ahead=workers)
    with runs.stop_by_signals() as stop, closing(pool) if pool else nullcontext(), open_store(folder, source) as store:
        yield StateRunner(campaign, states, Kept.begin(store, audited, chart=chart), pool, stop)


def first_failures(
    runner: StateRunner,
    factors: np.ndarray,
    chains: Sequence[Sequence[int]],
    progress: Callable[[str], None],
) -> tuple[np.ndarray, dict[int, int]]:
    """The state of its chain in which each sample fails first, on the rough grid and of some on the refined one.

    Args:
        runner: of the states.
        factors: of safety of each sample in each state (n, states).
        chains: of each sample, states in which its factor falls from one to the next.
        progress: called with a line after each round.

    Returns:
        Numbers of states (n,) and by sample: their count for never, -1 where a run broke off.
    """
    samples, count = len(chains), len(runner.states)

    def guessed(critical: float) -> list[int]:
        return [first_guess(row, chain, critical) for row, chain in zip(factors, chains, strict=True)]

    pilot = range(min(PILOT, samples))
    _first(runner, "rough", pilot, chains, guessed(1.0), progress)
    told = [(factors[n, at], failed) for n, at, failed in runner.kept.of("rough", pilot) if failed is not None]
    guesses = guessed(critical_factor(*map(list, zip(*told, strict=True))) if told else 1.0)
    rough = _first(runner, "rough", range(samples), chains, guesses, progress)
    guesses = [
        len(chain) if first == count or first < 0 else chain.index(first)
        for chain, first in zip(chains, rough, strict=True)
    ]
    return rough, dict(
        enumerate(_first(runner, "refined", range(runner.kept.audited), chains, guesses, progress).tolist())
    )


def noted(estimates: Sequence[Estimate], rough: np.ndarray, refined: Mapping[int, int]) -> Iterator[Estimate]:
    """Estimates that say how many samples broke off, of the states in which samples fail first."""
    lost = int((rough < 0).sum()), sum(first < 0 for first in refined.values())
    notes = [
        f"{n} samples broke off on the {grid} grid and are left out"
        for n, grid in zip(lost, ("rough", "refined"), strict=True)
        if n
    ]
    return (replace(estimate, notes=(*estimate.notes, *notes)) for estimate in estimates)


def _first(
    runner: StateRunner, grid: str, numbers: Sequence[int], chains: Sequence[Sequence[int]], guesses: Sequence[int],
    progress: Callable[[str], None],
) -> np.ndarray:  # fmt: skip
    """The state in which each sample fails first on a grid, by rounds in which each is asked in one of them."""
    brackets = {number: Bracket.of(len(chains[number])) for number in numbers}
    while True:
        to_ask = defaultdict(list)
        for number in numbers:
            # What the folder has is not asked again.
            while (at := brackets[number].next(guesses[number])) is not None:
                answer = runner.kept.answer(grid, number, chains[number][at])
                if answer is Kept.UNKNOWN:
                    to_ask[chains[number][at]].append(number)
                    break
                brackets[number] = brackets[number].told(at, answer)  # type: ignore[arg-type]
        if not to_ask:
            break
        runner.stop.check()
        for at, some in sorted(to_ask.items()):
            for number, failed in runner.ask(grid, at, some):
                runner.kept.tell(grid, number, at, failed)
            open_ = sum(not bracket.known for bracket in brackets.values())
            progress(
                f"{grid} grid: {len(some)} samples at {runner.states[at].words}, {open_} of {len(numbers)} under way"
            )
    last = len(runner.states)
    return np.array(
        [
            -1
            if (bracket := brackets[number]).lost
            else (last if bracket.fails == bracket.count else chains[number][bracket.fails])
            for number in numbers
        ],
        int,
    )


def _least(slices: Slices, surfaces: Sequence[tuple[np.ndarray, Method]]) -> float:
    """Lowest factor of safety on these surfaces, nan where none has one."""
    slips = [slices.slip(points, method) for points, method in surfaces]
    return min((slip.factor for slip in slips if slip is not None), default=math.nan)


def screened(runner: StateRunner, progress: Callable[[str], None]) -> np.ndarray:
    """Factor of safety of each sample in each state, on critical surfaces of the mean soil; nan where it has none."""
    samples, count = runner.campaign.plan.samples, len(runner.states)
    if (kept := runner.kept.factors) is not None:
        return kept
    runner.stop.check()
    factors = np.full((samples, count), math.nan)
    for state in runner.states:
        _ = state.campaign.flow  # water that cannot flow is no matter of slices
    try:
        sections = [slices_at_rest(state.resting) for state in runner.states]
        chosen = np.unique(np.linspace(0, count - 1, min(count, SURFACES)).round().astype(int))
        critical = [critical_surface(sections[at]) for at in chosen]
    except ValueError as error:
        progress(f"no screening by slices: {error}; every state may be that of a first failure")
        return runner.kept.screen(factors)
    surfaces = [(surface.slip.points, surface.slip.method) for surface in critical]
    surfaces += [(surface.circle.points, surface.slip.method) for surface in critical if surface.circle]
    model = runs.build(runner.states[0].resting, "rough", runner.soil, at_rest=False)
    loads = {state.load: state.campaign for state in runner.states}
    flows = [
        runs.own_flows(load, runner.soil, runner.coefficients) if load.conductivities else repeat(None)
        for load in loads.values()
    ]
    for number, *of_sample in zip(range(samples), *flows, strict=False):
        strength = sample_strength(model, runner.coefficients[number])
        if any(flow is not None for flow in of_sample):
            flow_of = dict(zip(loads, of_sample, strict=True))
            sections = [
                slices_at_rest(rested(state.campaign, state.time, flow_of[state.load])) for state in runner.states
            ]
        slices = [replace(section, strength=strength) for section in sections]
        factors[number] = [_least(section, surfaces) for section in slices]
        if not np.isfinite(factors[number]).all():
            # One method for all states, whose order is asked: Janbu's has an answer where rigorous ones have none.
            factors[number] = [_least(section, [(points, "janbu") for points, _ in surfaces]) for section in slices]
        runner.stop.check()
    progress(f"slices: {samples} samples in {count} states of the water on {len(surfaces)} surfaces")
    return runner.kept.screen(factors)


def first_lines(name: str, samples: int, refined: int, taken: Mapping[str, int]) -> Iterator[str]:
    """The first lines of an answer, for a terminal: the campaign's name, and what ran.

    Args:
        name: of the campaign.
        samples: that ran on the rough grid.
        refined: that ran on the refined one too.
        taken: runs on each grid.
    """
    yield printable(name)
    grids = f"{samples} samples on the rough grid, {refined} of them on the refined one"
    per_sample = taken["rough"] / max(samples, 1)
    yield f"  runs       {grids}; {taken['rough']} and {taken['refined']} runs, {per_sample:.2g} a sample"
