"""Samples asked at times whether they stand: screened by slices, bisected on the rough grid, audited on the refined.

A sample has failed at a time if it fails under the pore pressure of that time or of one before. Factors of safety by
slices say at which times it may fail first, those with a lower factor than all before. Among these its first failure
is found by bisection, from where slices expect it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import repeat
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Bracket, Estimate, critical_factor, first_guess, in_time, record_lows
from cooperative.scene import Campaign, check_samples, rested
from cooperative.tools.in_time._kept import Kept
from cooperative.tools.safety import critical_surface, sample_strength, slices_at_rest
from cooperative.tools.seepage import in_hours
from jaxmpm.support.text import printable

FEWEST = 20
"""Refined samples at least."""
SHARE = 0.2
"""Of the samples that run refined too, where nobody says how many."""
PILOT = 10
"""Samples from whose rough runs the critical factor by slices follows."""
SURFACES = 3
"""Critical surfaces of the mean soil, of as many times, by which samples are screened."""


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


@dataclass
class _Runner:
    """Runs samples at times: on models in this process, or by workers."""

    campaign: Campaign
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
    def models(self) -> dict[tuple[str, int], runs.GridModel]:
        return {}

    def ask(self, grid: str, at: int, numbers: Sequence[int]) -> Iterator[tuple[int, bool | None]]:
        """Whether samples fail under the pressure of a time, None for runs that broke off."""
        assert self.campaign.seepage is not None
        limit = self.campaign.run.failure_displacement
        resting = rested(self.campaign, self.campaign.seepage.times[at])
        if self.workers is not None:
            packed = runs.packed(resting)
            ended = runs.run_through(
                self.workers, packed, grid, numbers, self.coefficients, stop_at=limit, check=self.stop.check
            )
        else:
            if (grid, at) not in self.models:
                self.models[grid, at] = runs.build(resting, grid, self.soil)
            model = self.models[grid, at]
            ended = runs.run_samples(model, self.coefficients, numbers, stop_at=limit, stop=self.stop.requested)
        for sample in ended:
            displacement, broke_off = sample.result
            yield sample.number, None if broke_off and displacement <= limit else displacement > limit
            self.stop.check()


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
    table = campaign.seepage
    if table is None:
        raise ValueError("no water moves in the scene: add [rain] or [drawdown]")
    check_samples(campaign)
    if campaign.run.failure == "limit load" and campaign.measured.limit_load is None:
        raise ValueError("failure = 'limit load' is of one state of the water: give failure_displacement instead")
    if campaign.plan.calibrate:
        raise ValueError(
            "calibrate = true is of one state of the water: the refined runs correct the rough ones instead"
        )
    samples, count = campaign.plan.samples, len(table.times)
    audited = min(samples, max(FEWEST, round(SHARE * samples)) if refined_runs is None else refined_runs)
    if 0 < audited < min(10, samples):
        raise ValueError(f"{audited} refined samples: give 10 or more, or 0 for the rough grid alone")
    pool = None if workers == 1 else runs.Workers(partial(runs.process_pool, workers), workers, ahead=workers)
    with runs.stop_by_signals() as stop, closing(pool) if pool else nullcontext():
        kept = Kept.opened(folder, campaign)
        runner = _Runner(campaign, kept, pool, stop)
        factors = _factors(runner, progress)
        lows = [record_lows(each) for each in factors]

        def guessed(critical: float) -> list[int]:
            return [first_guess(each, low, critical) for each, low in zip(factors, lows, strict=True)]

        pilot = range(min(PILOT, samples))
        _first(runner, "rough", pilot, lows, guessed(1.0), progress)
        told = [(factors[n, at], failed) for n, at, failed in kept.of("rough", pilot) if failed is not None]
        guesses = guessed(critical_factor(*map(list, zip(*told, strict=True))) if told else 1.0)
        rough = _first(runner, "rough", range(samples), lows, guesses, progress)
        guesses = [
            len(low) if first == count or first < 0 else low.index(first)
            for low, first in zip(lows, rough, strict=True)
        ]
        fine = _first(runner, "refined", range(audited), lows, guesses, progress)
    refined = dict(enumerate(fine.tolist()))
    known = factors if np.isfinite(factors).all() else None
    estimates = in_time(rough, refined if audited else None, known, count)
    lost = int((rough < 0).sum()), sum(first < 0 for first in refined.values())
    notes = [
        f"{n} samples broke off on the {grid} grid and are left out"
        for n, grid in zip(lost, ("rough", "refined"), strict=True)
        if n
    ]
    return InTime(
        campaign, table.times, tuple(replace(each, notes=(*each.notes, *notes)) for each in estimates), rough, refined,
        factors, {grid: kept.count(grid) for grid in ("rough", "refined")},
    )  # fmt: skip


def _first(
    runner: _Runner, grid: str, numbers: Sequence[int], lows: Sequence[Sequence[int]], guesses: Sequence[int],
    progress: Callable[[str], None],
) -> np.ndarray:  # fmt: skip
    """The time at which each sample fails first on a grid, by rounds in which each is asked at one time."""
    assert runner.campaign.seepage is not None
    times = runner.campaign.seepage.times
    brackets = {number: Bracket.of(len(lows[number])) for number in numbers}
    while True:
        asked = defaultdict(list)
        for number in numbers:
            # What the folder has is not asked again.
            while (at := brackets[number].next(guesses[number])) is not None:
                answer = runner.kept.answer(grid, number, lows[number][at])
                if answer is Kept.UNKNOWN:
                    asked[lows[number][at]].append(number)
                    break
                brackets[number] = brackets[number].told(at, answer)  # type: ignore[arg-type]
        if not asked:
            break
        for at, some in sorted(asked.items()):
            try:
                for number, failed in runner.ask(grid, at, some):
                    runner.kept.tell(grid, number, at, failed)
            finally:
                runner.kept.write()
            left = sum(not each.known for each in brackets.values())
            progress(f"{grid} grid: {len(some)} samples at {in_hours(times[at])}, {left} of {len(numbers)} under way")
    last = len(times)
    return np.array(
        [
            -1
            if (known := brackets[number]).lost
            else (last if known.fails == known.count else lows[number][known.fails])
            for number in numbers
        ],
        int,
    )


def _factors(runner: _Runner, progress: Callable[[str], None]) -> np.ndarray:
    """Factor of safety of each sample at each time, on critical surfaces of the mean soil; nan where there are none."""
    campaign = runner.campaign
    table = campaign.seepage
    assert table is not None
    samples, count = campaign.plan.samples, len(table.times)
    if (known := runner.kept.factors) is not None:
        return known
    factors = np.full((samples, count), math.nan)
    try:
        sections = [slices_at_rest(rested(campaign, time)) for time in table.times]
        chosen = np.unique(np.linspace(0, count - 1, min(count, SURFACES)).round().astype(int))
        critical = [critical_surface(sections[at]) for at in chosen]
    except ValueError as error:
        progress(f"no screening by slices: {error}; every time may be that of a first failure")
        return factors
    surfaces = [each.slip.points for each in critical] + [each.circle.points for each in critical if each.circle]
    model = runs.build(rested(campaign, table.times[0]), "rough", runner.soil, at_rest=False)
    own = runs.own_flows(campaign, runner.soil, runner.coefficients) if campaign.conductivities else repeat(None)
    for number, flow in zip(range(samples), own, strict=False):
        strength = sample_strength(model, runner.coefficients[number])
        if flow is not None:
            sections = [slices_at_rest(rested(campaign, time, flow)) for time in table.times]
        for at, section in enumerate(sections):
            slices = replace(section, strength=strength)
            slips = [
                slices.slip(points, each.slip.method) for points, each in zip(surfaces, critical * 2, strict=False)
            ]
            factors[number, at] = min((slip.factor for slip in slips if slip is not None), default=math.nan)
        runner.stop.check()
    runner.kept.factors = factors
    runner.kept.write()
    progress(f"slices: {samples} samples at {count} times on {len(surfaces)} surfaces")
    return factors


def lines(result: InTime) -> Iterator[str]:
    """The answer in words, for a terminal.

    Args:
        result: of `probability_in_time`.
    """
    campaign, samples = result.campaign, result.rough.size
    yield printable(campaign.name)
    grids = f"{samples} samples on the rough grid, {len(result.refined)} of them on the refined one"
    total = result.runs["rough"] / max(samples, 1)
    yield f"  runs       {grids}; {result.runs['rough']} and {result.runs['refined']} runs, {total:.2g} a sample"
    yield "  time       P_f    (95 %)"
    for time, estimate in zip(result.times, result.estimates, strict=True):
        low, high = estimate.interval
        yield f"  {in_hours(time):>8}  {estimate.probability:6.3f}  ({low:.3f} to {high:.3f})"
    for note in dict.fromkeys(note for each in result.estimates for note in each.notes):
        yield f"    {note}"
    yield "    a sample that has failed at a time counts as failed after it"
