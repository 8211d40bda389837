"""The folder of samples that were asked in time, looked at again: what it holds, how far it is, and on from there."""

from __future__ import annotations

from pathlib import Path

from cooperative.estimate import Bracket, record_lows
from cooperative.folder import known_summary
from cooperative.names import GRIDS
from cooperative.reporting import GridProgress, Progress, controller_of
from cooperative.scene import Campaign, campaign_of
from cooperative.store import SLIDES, read_store
from cooperative.tools.in_time._answer import InTime, NothingRuns, StateRunner, answered, states_in_time
from cooperative.tools.in_time._chart import Chart, answered_chart, chains_on_chart, loads_of, states_on_chart
from cooperative.tools.in_time._kept import Kept
from cooperative.tools.in_time._slides import SlidesInTime, rows_of_slides, slides_of_rows, to_slide


def kept_in(folder: str | Path) -> Kept | None:
    """The answers that a folder keeps of samples asked in time, None for a folder of a campaign.

    Args:
        folder: that of `probability_in_time`, its `slides`, or the `chart` of a chart.

    Raises:
        ValueError: it is neither.
    """
    return Kept.read(read_store(folder))


def read_in_time(folder: str | Path) -> tuple[InTime, SlidesInTime]:
    """The probability against time and its slides, from what a folder keeps; nothing runs.

    Args:
        folder: that of `probability_in_time`, or its `slides`.

    Raises:
        ValueError: the folder is none, or some samples have not been asked, or have not slid, yet.
    """
    runner = _reader(_kept(folder, chart=False))
    result = answered(runner, lambda _: None)
    chosen = to_slide(result)
    slid = rows_of_slides(runner.kept.store, chosen)
    rows, summary = slid[result.grid], known_summary(runner.kept.store, slid)
    if len(rows.numbers) < len(chosen):
        runner.stop.check()
    return result, slides_of_rows(rows, chosen, result.grid, () if summary is None else summary.notes)


def read_chart(folder: str | Path) -> Chart:
    """A chart, from what a folder keeps; nothing runs.

    Args:
        folder: `chart` in that of `probability_chart`.

    Raises:
        ValueError: the folder is none, or some samples have not been asked yet.
    """
    return answered_chart(_reader(_kept(folder, chart=True)), lambda _: None)


def _kept(folder: str | Path, *, chart: bool) -> Kept:
    """The answers of a folder; ValueError where it has none of this kind."""
    kept = kept_in(folder)
    if kept is None or kept.chart != chart:
        kind = "on a chart" if chart else "in time"
        raise ValueError(f"folder {folder} has no samples that are asked {kind}: give that of `jaxmpm seepage`")
    return kept


def progress_in_time(folder: str | Path) -> Progress:
    """How far samples are that are asked in time.

    Args:
        folder: as of `kept_in`.

    Raises:
        ValueError: the folder has no such samples.
    """
    if (kept := kept_in(folder)) is None:
        raise ValueError(f"folder {folder} has no samples that are asked in time: give that of `jaxmpm seepage`")
    campaign = campaign_of(kept.store)
    grids = [
        GridProgress(
            grid, _known(kept, grid, campaign, samples), samples, False, float("nan"),
            sum(failed is None for _, _, failed in kept.of(grid, range(samples))),
        )
        for grid, samples in zip(GRIDS, (campaign.plan.samples, kept.audited), strict=True)
        if samples
    ]  # fmt: skip
    estimate = None
    if not kept.chart and all(grid.done == grid.planned for grid in grids):
        result = answered(_reader(kept), lambda _: None)
        rows = rows_of_slides(kept.store, chosen := to_slide(result))[result.grid]
        grids.append(GridProgress(SLIDES, len(rows.numbers), len(chosen), False, float("nan")))
        estimate = result.estimates[-1]
    return Progress(campaign.name, *controller_of(kept.store), tuple(grids), estimate)


def _reader(kept: Kept) -> StateRunner:
    """A runner that gives what is kept, and refuses to run anything."""
    campaign = campaign_of(kept.store)
    states = states_on_chart(loads_of(campaign)) if kept.chart else states_in_time(campaign)
    return StateRunner(campaign, states, kept, None, NothingRuns(kept.store.folder))


def _known(kept: Kept, grid: str, campaign: Campaign, samples: int) -> int:
    """Samples of which nothing is left to ask on a grid."""
    if kept.factors is None:
        return 0
    loads = sum(map(len, loads_of(campaign))) if kept.chart else 0
    chains = chains_on_chart(kept.factors, loads)[2] if kept.chart else [*map(record_lows, kept.factors)]
    brackets = [Bracket.of(len(chain)) for chain in chains]
    for number, at, failed in kept.of(grid, range(samples)):
        if at in chains[number]:
            brackets[number] = brackets[number].told(chains[number].index(at), failed)
    return sum(bracket.known for bracket in brackets[:samples])
