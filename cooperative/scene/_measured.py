"""What a campaign measures once, before its first run, and keeps in its database.

Terms: an expansion takes as many as hold its share of the variance. Eigenvalues are rounded otherwise on another
machine, where one term more or less may hold it, so the number of the machine on which a campaign began stands for all
that go on with it, work for it or read it.

Calibration: a rough grid is stiffer and stands where the refined one fails. Its strength is multiplied by the ratio of
their factors of safety, those of the slope of median soil by strength reduction, some ten runs on each grid.

Limit load: a displacement of 1 m is no failure where soil does not soften; such a slope slides a little and stands
again. At its limit load the displacement of the slope of median soil turns upwards with the reduction factor, or jumps.
That factor depends on strength alone where nothing softens (`jaxmpm.run.limit_load_scene`). The displacement that goes
with it depends on the stiffness too: samples run with their own, so it is measured with that of the median soil. The
geometric mean of displacements a little below and above the factor is the failure displacement of all samples, so that
this slope's factor of safety by displacement is that of its limit load.

Shared audit: campaigns of a sweep refine the same samples (`cooperative.tools.sweep_audit`), drawn by the rough
results of all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import jax

from cooperative.scene._campaign import Campaign
from cooperative.scene._in_folder import keep
from cooperative.scene.tables import Calibration, LimitLoad, Measured
from cooperative.store import GRIDS, Store
from jaxmpm import Scene, Settle, State, diagnostics, factor_of_safety, reduced, solve
from jaxmpm.run import FactorOfSafety
from jaxmpm.support.check import Invalid

BLUNT = 5.0
"""Sharpness of the kink below which there is no clear limit load."""

BESIDE = 0.02
"""How far below and above the factor of the limit load displacements are taken, over that factor."""


class MeasuredGrid(Protocol):
    """A grid of which something is measured, see `runs.GridModel`."""

    @property
    def median(self) -> tuple[Scene, State]:
        """Scene and initial state of the median soil."""


def measure(campaign: Campaign, store: Store, terms: Sequence[int], grids: Mapping[str, MeasuredGrid]) -> Campaign:
    """Measure what the campaign asks for and has not, and keep each number in the database once it is known.

    Args:
        campaign: with what its folder has measured.
        store: the campaign's folder.
        terms: number of terms of each expansion, counted on this machine.
        grids: both grids by name.

    Returns:
        The campaign with all of it.

    Raises:
        ValueError: a slope's factor lies outside 0.5 to 3, or its displacement shows no limit load there.
        OSError: the disk refuses.
    """

    def stored(measured: Measured) -> Campaign:
        keep(store, measured)
        return replace(campaign, measured=measured)

    if campaign.measured.terms is None and terms:  # none where a water level alone is random
        campaign = stored(replace(campaign.measured, terms=tuple(terms)))
    if campaign.run.failure == "limit load" and campaign.measured.limit_load is None:
        limit_load = measure_limit_load(campaign, grids["refined"])
        campaign = stored(replace(campaign.measured, limit_load=limit_load))
    if campaign.plan.calibrate and campaign.measured.calibration is None:
        campaign = stored(replace(campaign.measured, calibration=factors_of_safety(campaign, grids)))
    return campaign


def factors_of_safety(campaign: Campaign, grids: Mapping[str, MeasuredGrid]) -> Calibration:
    """Factors of safety of the slope of median soil.

    Args:
        campaign: the campaign.
        grids: both grids by name.

    Raises:
        ValueError: one lies outside 0.5 to 3.
    """
    run = campaign.run
    factors = {
        grid: factor_of_safety(
            *unshaken(grids[grid]), failure_displacement=run.failure_displacement, t_end=run.t_end,
            batch=_factors_at_once(), settle=run.settling(), least_volume=campaign.failing_volume,
        ).stable
        for grid in GRIDS
    }  # fmt: skip
    return Calibration(**factors)


def measure_limit_load(campaign: Campaign, refined: MeasuredGrid) -> LimitLoad:
    """The limit load of the slope of median soil, by strength reduction.

    Args:
        campaign: the campaign.
        refined: the refined grid.

    Raises:
        ValueError: its displacement shows none between factors of 0.5 and 3.
    """
    scene, state = unshaken(refined)
    t_end, volume = campaign.run.t_end, failing_volume(campaign)
    result = limit_load_factor(campaign, scene, state)
    assert result.kink is not None
    below, above = (
        _displacement(reduced(scene, factor), state, t_end, volume)
        for factor in (result.kink * (1 - BESIDE), result.kink * (1 + BESIDE))
    )
    displacement = float(f"{math.sqrt(below * above):.3g}")
    return LimitLoad(result.kink, displacement, volume, result.sharpness, result.local)


def unshaken(grid: MeasuredGrid) -> tuple[Scene, State]:
    """Scene and initial state of the median soil, whose base does not move: a factor of safety is of a steady load.

    Args:
        grid: of which something is measured.
    """
    scene, state = grid.median
    steady = scene.loads.motion is None
    return (scene if steady else replace(scene, loads=replace(scene.loads, motion=None))), state


def failing_volume(campaign: Campaign) -> float:
    """Least volume of soil (m3, in a section m2) whose displacement is that of a slope at its limit load.

    Args:
        campaign: the campaign.

    Raises:
        Invalid: any particle is a failure.
    """
    if campaign.failing_volume is None:
        rule = "lets any particle be a failure, and one moves below the limit load"
        raise Invalid(("run", "least_volume"), "0", rule, "give more or leave it out")
    return campaign.failing_volume


def doubts(answer: FactorOfSafety | LimitLoad, volume: str) -> Iterator[str]:
    """Why a limit load is not the whole answer.

    Args:
        answer: factor by the limit load.
        volume: the least that is a failure, with its unit.
    """
    if answer.sharpness is not None and answer.sharpness < BLUNT:
        yield (
            f"displacement grows {answer.sharpness:.2g} times as fast beyond the limit load as below, no sharp "
            "limit: look at what moves"
        )
    if answer.local is not None:
        factor, slip = answer.local
        yield (
            f"a slip of {slip:.2g} {volume.split()[-1]} moves at R = {factor:.3g} already; it is smaller than the "
            f"{volume} that is a failure: give a smaller least_volume where it matters"
        )


def limit_load_factor(
    campaign: Campaign,
    scene: Scene,
    state: State,
    *,
    bracket: tuple[float, float] = (0.5, 3.0),
    progress: Callable[[Sequence[float], Sequence[float]], None] | None = None,
) -> FactorOfSafety:
    """The factor of safety of a slope at its limit load, by strength reduction.

    Args:
        campaign: the campaign.
        scene: of one of its grids, with the soil of the slope.
        state: at the start.
        bracket: factors between which the limit load is looked for.
        progress: as for `jaxmpm.factor_of_safety`.

    Raises:
        ValueError: its displacement shows none between the factors of the bracket.
    """
    return factor_of_safety(
        scene, state, criterion="limit load", t_end=campaign.run.t_end, batch=_factors_at_once(),
        least_volume=failing_volume(campaign), bracket=bracket, progress=progress,
    )  # fmt: skip


def _displacement(scene: Scene, state: State, t_end: float, volume: float) -> float:
    """Displacement (m) that a volume of soil has exceeded by the end of a run."""
    result = solve(scene, state, t_end=t_end, rules=[Settle(least_volume=volume)]).raise_if_failed()
    return float(diagnostics.exceeded_displacement(scene, result.state, volume))


def _factors_at_once() -> int:
    """Reduction factors that a measurement tries at once.

    On CPU lanes run in turn, and bisection takes the fewest; elsewhere a batch costs as much time as one.
    """
    return 2 if jax.default_backend() == "cpu" else 8
