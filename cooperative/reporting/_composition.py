"""The report of a campaign, read from its folder alone: its figures, one page with all of them, a summary in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator
from cooperative.folder import SLIDES, Results, models_of, read_results
from cooperative.hazard import THICKNESS, Maps, maps_of
from cooperative.reporting import _charts as charts
from cooperative.reporting import _page as page
from cooperative.reporting import _pictures as pictures
from cooperative.reporting import _plots as plots
from cooperative.reporting._plots import Drawn
from cooperative.scene import campaign_of
from cooperative.store import GRIDS, own_folder, read_sample, write_aside
from foundation.text import short

HOW = (
    "Figures answer: point at one to read its values, draw a frame in it to see that part larger, double-click for all "
    "of it. With the keyboard, Tab goes to a figure, arrow keys read, + and - zoom, 0 shows all."
)
"""To whom the page's script runs; not printed."""


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
    results = read_results(folder, estimator)
    maps = maps_of(results)
    numbers, slopes = list(_numbers(results, maps)), list(_slopes(results, slides, again, estimator))
    target = own_folder(results.store.folder / "figures")
    for drawn in [*numbers, *slopes]:
        plots.lay_out(drawn.figure)
        plots.save(drawn.figure, target / f"{drawn.name}.png")
    whole = page.document(results.summary.name, _parts(results, numbers, slopes))
    write_aside(results.store.folder / "report.html", whole.encode())
    return page.words(results)


def _numbers(results: Results, maps: Maps | None) -> Iterator[Drawn]:
    """Figures of the numbers, those that there are data for."""
    yield from _hazards(results, maps)
    rough, refined, limit = results.rough, results.refined, results.summary.failure_displacement
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
    path, estimator = results.summary.convergence, results.summary.estimator
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
        yield Drawn("grids", f"Samples that ran on both grids. {page.agreement(results.summary)}{stopped}", figure)
    modes = {mode: share for mode, share in (results.summary.modes or {}).items() if share.count}
    if len(modes) > 1:
        yield Drawn("modes", "Failure modes, by what the runs stand for.", charts.mode_shares(modes))
    if results.summary.severity and len(modes) > 1:
        yield Drawn(
            "severity",
            "Median of each consequence by failure mode, with its 90 % bootstrap interval.",
            charts.severity(results.summary.severity, page.labels(results)),
        )
    weight = results.weight
    for group, fits in page.distinct(results).items():
        mine = results.slid & (weight > 0)
        mine &= (refined.columns["mode"] == group) if group != "all" else True
        if fits:
            yield Drawn(
                f"fits-{group}",
                f"Distribution of the consequences of {group} failures ({mine.sum()} runs), with the three best fits."
                f"{page.cut_off(results.summary)}",
                charts.fitted(
                    {name: refined.columns[name][mine] for name in fits}, weight[mine], fits, page.labels(results)
                ),
            )


def _hazards(results: Results, maps: Maps | None) -> Iterator[Drawn]:
    """Figures of how likely a slide does how much."""
    # A curve of one step, as of slides that are all as deep as the ground, tells no more than P_f.
    curves = {name: each for name, each in results.summary.exceedance.items() if len({*each.probability[:-1]}) > 1}
    if curves:
        yield Drawn(
            "exceedance",
            "Probability that a sample of the slope fails and its slide goes beyond what stands below, with its "
            f"{results.summary.level:.0%} interval at each point. The curves start at the probability of failure."
            f"{page.cut_off(results.summary)}",
            charts.exceedance(curves, page.labels(results), level=results.summary.level),
        )
    if maps is not None:
        face = results.ground.face
        toe = None if face is None else face.toe_x
        draw = charts.plan_maps if results.ground.dimension == 3 else charts.profile
        said = _mapped(maps, results.summary.level) + page.cut_off(results.summary)
        yield Drawn("hazard", said, draw(maps, toe=toe))
    risk = results.summary.risk
    if risk and risk.loss and risk.loss.expected:
        yield Drawn(
            "losses",
            "Probability of losing more than stands below at the exposed places together. The area under the curve is "
            f"the expected loss.{page.cut_off(results.summary)}",
            charts.losses(risk.loss.exceedance, level=results.summary.level),
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


def _slopes(results: Results, slides: int, again: bool, estimator: Estimator | None) -> Iterator[Drawn]:
    """Pictures of chosen samples."""
    store, ground, wanted = results.store, results.ground, results.soils(slides)
    grid, numbers = results.drawn(slides)
    soils, models = runs.read_drawn(store.folder, wanted), {}
    samples = {number: read_sample(store, grid, number) for number in numbers}
    if again or len(soils) < len(wanted):
        # Their random soil was not kept, or they run again.
        models = models_of(campaign_of(store, estimator))
        soils = {of: soils.get(of) or runs.soil_of(models[of[0]], samples[of[1]].coefficients) for of in wanted}
    if again:
        model = runs.build(models[grid].campaign, grid, models[grid].soil)
    for number in numbers[:slides]:
        sample, soil = samples[number], soils[grid, number]
        shown = pictures.moments(model, sample) if again else pictures.kept_moments(sample, soil)
        yield from pictures.slide(ground, grid, sample, soil, shown)
    first = samples[numbers[0]]
    if {"displacement", "plastic_strain"} <= first.fields.keys():
        yield pictures.before_and_after(ground, grid, first)
    yield from pictures.fields(ground, first, {each: soils[each, numbers[0]] for each in GRIDS})


def _parts(results: Results, numbers: Sequence[Drawn], slopes: Sequence[Drawn]) -> Iterator[str]:
    """The page from top to bottom: what a decision needs, then how it was found."""
    found = results.summary
    figures = {drawn.name: drawn for drawn in [*numbers, *slopes]}

    def shown(*names: str) -> Iterator[str]:
        mine = [drawn for name, drawn in figures.items() if name.startswith(names)]
        if mine:
            yield page.figures(drawn.page or page.picture(drawn.figure, drawn.caption) for drawn in mine)

    yield page.heading(found.name, 1)
    yield from page.answer(results)
    missing = page.without_slides(found)
    if missing or {"exceedance", "hazard"} & figures.keys():
        yield page.heading("How far, how much, how deep")
        yield page.paragraph(missing) if missing else page.paragraph(HOW, "how")
        yield from shown("exceedance", "hazard")
    if found.risk:
        yield page.heading("Exposed places")
        yield from page.risks(found, found.risk)
        yield from shown("losses")
    yield page.heading("What the slides look like" if results.slid.any() else "What the slope looks like")
    yield from page.look(results)
    yield from shown("slide", "plan", "slope")
    yield page.heading("How sure, and why")
    yield page.estimates(found)
    yield page.paragraph(" ".join(line for line in (page.unseen(found), page.finished(found)) if line))
    if missing:
        yield page.paragraph(HOW, "how")
    yield from shown("convergence", "ranked", "grids")
    yield page.heading("What more runs would buy")
    yield from page.bought(results)
    yield page.heading("How it was run")
    yield page.run_table(results)
    yield from shown("field")
    if missing or {"severity", "fits-all"} & figures.keys():
        yield page.heading("Distributions of what the slides do")
    if missing:
        yield page.paragraph(missing)
    elif {"severity", "fits-all"} & figures.keys():
        yield from shown("severity")
        yield from page.best_fits(results)
        yield from shown("fits")
    yield page.heading("Scene")
    yield page.preformatted("\n".join(short(line, 400) for line in results.store.source.words.strip().splitlines()))
    yield page.SCRIPT
    if any(drawn.page for drawn in slopes):
        yield page.TURN
