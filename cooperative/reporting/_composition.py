"""The report of a campaign, read from its folder alone: its figures, one page with all of them, a summary in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from cooperative import runs, summary
from cooperative.estimate import Estimator
from cooperative.hazard import THICKNESS, Maps, maps_of
from cooperative.reporting import _charts as charts
from cooperative.reporting import _page as page
from cooperative.reporting import _pictures as pictures
from cooperative.reporting import _plots as plots
from cooperative.reporting._plots import Drawn
from cooperative.reporting._told import Told
from cooperative.reporting._words import (
    agreement,
    answer,
    best_fits,
    bought,
    cut_off,
    distinct,
    estimates,
    finished,
    look,
    risks,
    run_table,
    unseen,
    without_slides,
    words,
)
from cooperative.runs import GridModel
from cooperative.scene import campaign_of
from cooperative.store import GRIDS, Rows, own_folder, read_sample, read_store, write_aside
from foundation.text import short

HOW = (
    "Figures answer: point at one to read its values, draw a frame in it to see that part larger, double-click for all "
    "of it. With the keyboard, Tab goes to a figure, arrow keys read, + and - zoom, 0 shows all."
)
"""To whom the page's script runs; not printed."""

SLIDES = 3
"""Slides drawn at several times, unless the caller says otherwise."""


def report(folder: str | Path, *, slides: int = SLIDES, again: bool = False, estimator: Estimator | None = None) -> str:
    """Draw the figures of a campaign into `figures/`, write `report.html` with all of them, and return its summary in
    words.

    slides: how many slides to draw at several times, the farthest of each mode, from the frames and fields that their
    runs left behind. again: run them again and draw more moments; all else is read, and nothing solved.
    estimator: the one that `cooperative.campaign.run` was given, where it was given one.
    Raises ValueError where the folder holds no campaign, or none with a finished sample.
    """
    if slides < 0:
        raise ValueError(f"slides = {slides}: give 0 or more")
    store = read_store(folder)
    campaign = campaign_of(store, estimator)
    models = pictures.models_of(campaign)
    rough, refined = map(runs.rows_reader(campaign, store, models), GRIDS)
    if not rough.numbers:
        raise ValueError(f"folder {folder} has no finished sample yet: start the run first")
    left_out = [f"{why}: will be run again" for rows in (rough, refined) for why in rows.damaged]
    refined, without = _paired(refined, rough)
    left_out += [f"refined run {number} has no rough run beside it: resume the campaign" for number in without]
    told = Told(
        store,
        campaign,
        rough,
        refined,
        summary.stored(campaign, store, rough, refined),
        tuple(left_out),
        maps_of(campaign, store, models["refined"], rough, refined),
    )
    numbers, slopes = list(_numbers(told)), list(_slopes(told, models, slides, again))
    target = own_folder(store.folder / "figures")
    for drawn in [*numbers, *slopes]:
        plots.lay_out(drawn.figure)
        plots.save(drawn.figure, target / f"{drawn.name}.png")
    write_aside(store.folder / "report.html", page.document(campaign.name, _parts(told, numbers, slopes)).encode())
    return words(told)


def _paired(refined: Rows, rough: Rows) -> tuple[Rows, list[int]]:
    """The refined runs whose rough runs are there, and the numbers of the others: nobody knows where those rank."""
    there = np.isin(refined.columns["sample"], rough.columns["sample"])
    columns = {name: values[there] for name, values in refined.columns.items()}
    return Rows(columns, refined.damaged), refined.columns["sample"][~there].tolist()


def _numbers(told: Told) -> Iterator[Drawn]:
    """Figures of the numbers, those that there are data for."""
    yield from _hazards(told)
    rough, refined, limit = told.rough, told.refined, told.campaign.run.failure_displacement
    place = {number: at for at, number in enumerate(rough.numbers)}
    both = np.full(len(place), np.nan)
    both[[place[number] for number in refined.numbers]] = refined.columns.get("displacement", np.zeros(0))
    first = np.where(rough.columns["broke_off"].astype(bool), np.nan, rough.columns["displacement"])
    # Such a run is drawn where it had come to by then.
    decided = "DECIDED" in refined.columns.get("status", ())
    stopped = " Failures that did not slide on are drawn where they had failed." if decided else ""
    yield Drawn(
        "ranked",
        "Largest displacement of every sample by its rank on the rough grid, with the refined runs. Refined failures "
        f"should thin out down the ranks.{stopped}",
        charts.ranked_displacements({"rough": first, "refined": both}, failure_displacement=limit),
    )
    path, estimator = told.summary.convergence, told.summary.estimator
    if len(path.refined_runs) > 1:
        yield Drawn(
            "convergence",
            "Probability of failure and its interval as refined runs came in.",
            charts.convergence(
                {estimator: np.array(path.refined_runs)},
                {estimator: np.array(path.probability)},
                {estimator: np.array([path.low, path.high])},
            ),
        )
    ended = np.isfinite(first) & np.isfinite(both)
    if ended.any():
        figure = charts.grids(first[ended], both[ended], failure_displacement=limit)
        yield Drawn("grids", f"Samples that ran on both grids. {agreement(told.summary)}{stopped}", figure)
    modes = {mode: share for mode, share in (told.summary.modes or {}).items() if share.count}
    if len(modes) > 1:
        yield Drawn("modes", "Failure modes, by what the runs stand for.", charts.mode_shares(modes))
    if told.summary.severity and len(modes) > 1:
        yield Drawn(
            "severity",
            "Median of each consequence by failure mode, with its 90 % bootstrap interval.",
            charts.severity(told.summary.severity, told.labels),
        )
    weight = summary.slides_of(told.campaign, told.phases, refined).weight
    for group, fits in distinct(told).items():
        mine = told.failed & (weight > 0)
        mine &= (refined.columns["mode"] == group) if group != "all" else True
        if fits:
            yield Drawn(
                f"fits-{group}",
                f"Distribution of the consequences of {group} failures ({mine.sum()} runs), with the three best fits."
                f"{cut_off(told.summary)}",
                charts.fitted({name: refined.columns[name][mine] for name in fits}, weight[mine], fits, told.labels),
            )


def _hazards(told: Told) -> Iterator[Drawn]:
    """Figures of how likely a slide does how much."""
    # A curve of one step, as of slides that are all as deep as the ground, tells no more than P_f.
    curves = {name: each for name, each in told.summary.exceedance.items() if len({*each.probability[:-1]}) > 1}
    if curves:
        yield Drawn(
            "exceedance",
            "Probability that a sample of the slope fails and its slide goes beyond what stands below, with its "
            f"{told.summary.level:.0%} interval at each point. The curves start at the probability of failure."
            f"{cut_off(told.summary)}",
            charts.exceedance(curves, told.labels, level=told.summary.level),
        )
    maps, face = told.maps, told.campaign.site.shape.face
    toe = None if face is None else face.toe_x
    if maps is not None:
        draw = charts.plan_maps if told.campaign.dimension == 3 else charts.profile
        said = _mapped(maps, told.summary.level) + cut_off(told.summary)
        yield Drawn("hazard", said, draw(maps, toe=toe))
    risk = told.summary.risk
    if risk and risk.loss and risk.loss.expected:
        yield Drawn(
            "losses",
            "Probability of losing more than stands below at the exposed places together. The area under the curve is "
            f"the expected loss.{cut_off(told.summary)}",
            charts.losses(risk.loss.exceedance, level=told.summary.level),
        )


def _mapped(maps: Maps, level: float) -> str:
    """What maps show, in words."""
    few = not np.isfinite(maps.maps[THICKNESS].high).any()
    return (
        f"How likely soil that moved reaches a column of cells of {maps.plan.cell:g} m, from {maps.slides} slides, "
        f"with the {level:.0%} interval of each column. Soil counts as there from {maps.least:.2g} m on, averaged over "
        f"the column. It was looked at every {maps.every:.2g} s, in which the fastest soil went {maps.missed:.2g} "
        "m: peaks shorter than that are missed."
        + (" The slides are too few for intervals of thickness and arrival." if few else "")
    )


def _slopes(told: Told, models: dict[str, GridModel], slides: int, again: bool) -> Iterator[Drawn]:
    """Pictures of chosen samples."""
    grid, rows = ("refined", told.refined) if told.refined.numbers else ("rough", told.rough)
    failed = told.failed if grid == "refined" else np.zeros(len(rows.numbers), bool)
    chosen = [read_sample(told.store, grid, n) for n in pictures.choose(rows, failed, max(slides, 1))]
    yield from pictures.slides(models[grid], chosen[:slides], again=again)
    if {"displacement", "plastic_strain"} <= chosen[0].fields.keys():
        yield pictures.before_and_after(models[grid], chosen[0])
    yield from pictures.fields(models, chosen[0])


def _parts(told: Told, numbers: Sequence[Drawn], slopes: Sequence[Drawn]) -> Iterator[str]:
    """The page from top to bottom: what a decision needs, then how it was found."""
    found = told.summary
    figures = {drawn.name: drawn for drawn in [*numbers, *slopes]}

    def shown(*names: str) -> Iterator[str]:
        mine = [drawn for name, drawn in figures.items() if name.startswith(names)]
        if mine:
            yield page.figures(drawn.page or page.picture(drawn.figure, drawn.caption) for drawn in mine)

    yield page.heading(told.campaign.name, 1)
    yield from answer(told)
    missing = without_slides(found)
    if missing or {"exceedance", "hazard"} & figures.keys():
        yield page.heading("How far, how much, how deep")
        yield page.paragraph(missing) if missing else page.paragraph(HOW, "how")
        yield from shown("exceedance", "hazard")
    if found.risk:
        yield page.heading("Exposed places")
        yield from risks(found, found.risk)
        yield from shown("losses")
    yield page.heading("What the slides look like" if told.failed.any() else "What the slope looks like")
    yield from look(told)
    yield from shown("slide", "plan", "slope")
    yield page.heading("How sure, and why")
    yield estimates(found)
    yield page.paragraph(" ".join(line for line in (unseen(found), finished(found)) if line))
    if missing:
        yield page.paragraph(HOW, "how")
    yield from shown("convergence", "ranked", "grids")
    yield page.heading("What more runs would buy")
    yield from bought(told)
    yield page.heading("How it was run")
    yield run_table(told)
    yield from shown("field")
    if missing or {"severity", "fits-all"} & figures.keys():
        yield page.heading("Distributions of what the slides do")
    if missing:
        yield page.paragraph(missing)
    elif {"severity", "fits-all"} & figures.keys():
        yield from shown("severity")
        yield from best_fits(told)
        yield from shown("fits")
    yield page.heading("Scene")
    yield page.preformatted("\n".join(short(line, 400) for line in told.campaign.text.strip().splitlines()))
    yield page.SCRIPT
    if any(drawn.page for drawn in slopes):
        yield page.TURN
