"""The report of a campaign, read from its folder alone: its figures, one page with all of them, a summary in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator, Exceedance
from cooperative.folder import SLIDES, Results, models_of, read_results
from cooperative.hazard import THICKNESS, Maps, maps_of
from cooperative.reporting import _bodies as bodies
from cooperative.reporting import _charts as charts
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _page as page
from cooperative.reporting import _plots as plots
from cooperative.reporting._plots import Drawn
from cooperative.scene import campaign_of
from cooperative.store import GRIDS, Sample, own_folder, read_sample, write_aside
from foundation.text import short
from jaxmpm import solve_each
from jaxmpm.run import Midway

SHARES = (0.1, 0.3, 0.6)
"""Shares of the largest displacement at which a slide that is run again is drawn, and at its end."""

LOSS = {"loss": "loss [currency of the scene]"}
"""Label of an axis, as `labels` has those of consequences."""

HOW = (
    "Point at a curve, a map or a sample to read its values, draw a frame to see that part larger, double-click for "
    "all of it. Drag a body to turn it."
)
"""To whom the browser draws figures."""


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
    maps, moved, labels = maps_of(results), _moved(results), page.labels(results)
    cut = page.cut_off(results.summary)
    figures = [*_hazards(results, maps, labels, cut), *_numbers(results, moved, labels, cut)]
    figures += _slopes(results, slides, again, estimator)
    target = own_folder(results.store.folder / "figures")
    for drawn in figures:
        plots.lay_out(drawn.figure)
        plots.save(drawn.figure, target / f"{drawn.name}.png")
    live: Mapping[str, str] = {}
    scripts = ""
    if interactive.installed():
        live, scripts = _live(results, maps, figures, moved, labels), interactive.script()
    whole = page.document(results.summary.name, [scripts, *_parts(results, figures, live)])
    write_aside(results.store.folder / "report.html", whole.encode())
    return page.words(results)


def _moved(results: Results) -> dict[str, np.ndarray]:
    """Number of every sample and its largest displacement on the rough and the refined grid (N,) m, nan where it has
    none."""
    rough, refined = results.rough, results.refined
    place = {number: at for at, number in enumerate(rough.numbers)}
    second = np.full(len(place), np.nan)
    # Such a run is drawn where it had come to by then.
    second[[place[number] for number in refined.numbers]] = refined.columns.get("displacement", np.zeros(0))
    first = np.where(rough.columns["broke_off"].astype(bool), np.nan, rough.columns["displacement"])
    return {"sample": np.array(rough.numbers), "rough": first, "refined": second}


def _hazards(results: Results, maps: Maps | None, labels: Mapping[str, str], cut: str) -> Iterator[Drawn]:
    """Figures of how likely a slide does how much. labels: of consequences. cut: what a caption says of slides that had
    not come to rest."""
    found, curves = results.summary, _curves(results)
    if curves:
        yield Drawn(
            "exceedance",
            "Probability that a sample of the slope fails and its slide goes beyond what stands below, with its "
            f"{found.level:.0%} interval at each point. The curves start at the probability of failure.{cut}",
            charts.exceedance(curves, labels, level=found.level),
        )
    if maps is not None:
        draw = charts.plan_maps if results.ground.dimension == 3 else charts.profile
        yield Drawn("hazard", _mapped(maps, found.level) + cut, draw(maps, toe=_toe(results)))
    if found.risk and found.risk.loss and found.risk.loss.expected:
        yield Drawn(
            "losses",
            "Probability of losing more than stands below at the exposed places together. The area under the curve is "
            f"the expected loss.{cut}",
            charts.losses(found.risk.loss.exceedance, level=found.level),
        )


def _toe(results: Results) -> float | None:
    """x of the toe (m), None for ground without one."""
    return None if results.ground.face is None else results.ground.face.toe_x


def _curves(results: Results) -> Mapping[str, Exceedance]:
    """Exceedance curves but those of one step, as of slides that are all as deep as the ground: they tell no more than
    P_f."""
    return {name: each for name, each in results.summary.exceedance.items() if len({*each.probability[:-1]}) > 1}


def _numbers(results: Results, moved: Mapping[str, np.ndarray], labels: Mapping[str, str], cut: str) -> Iterator[Drawn]:
    """Figures of the other numbers, those that there are data for. moved: how far every sample did. labels, cut: as for
    `_hazards`."""
    found = results.summary
    alike, modes, distinct = page.agreement(found), page.occurring(found), page.distinct(results)
    columns, limit, path = results.refined.columns, found.failure_displacement, found.convergence
    decided = "DECIDED" in columns.get("status", ())
    stopped = " Failures that did not slide on are drawn where they had failed." if decided else ""
    yield Drawn(
        "ranked",
        "Largest displacement of every sample by its rank on the rough grid, with the refined runs. Refined failures "
        f"should thin out down the ranks.{stopped}",
        charts.ranked_displacements(moved, failure_displacement=limit),
    )
    if len(path.refined_runs) > 1:
        yield Drawn(
            "convergence",
            "Probability of failure and its interval as refined runs came in.",
            charts.convergence(
                {found.estimator: np.array(path.refined_runs)},
                {found.estimator: np.array(path.probability)},
                {found.estimator: np.array([path.low, path.high])},
            ),
        )
    ended = np.isfinite(moved["rough"]) & np.isfinite(moved["refined"])
    if ended.any():
        figure = charts.grids(moved["rough"][ended], moved["refined"][ended], failure_displacement=limit)
        yield Drawn("grids", f"Samples that ran on both grids. {alike}{stopped}", figure)
    if len(modes) > 1:
        yield Drawn("modes", "Failure modes, by what the runs stand for.", charts.mode_shares(modes))
    if found.severity and len(modes) > 1:
        yield Drawn(
            "severity",
            "Median of each consequence by failure mode, with its 90 % bootstrap interval.",
            charts.severity(found.severity, labels),
        )
    for group, fits in distinct.items():
        mine = results.slid & (results.weight > 0)
        mine &= (columns["mode"] == group) if group != "all" else True
        if fits:
            yield Drawn(
                f"fits-{group}",
                f"Distribution of the consequences of {group} failures ({mine.sum()} runs), with the three best fits."
                f"{cut}",
                charts.fitted({name: columns[name][mine] for name in fits}, results.weight[mine], fits, labels),
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
        shown = moments(model, sample) if again else kept_moments(sample, soil)
        yield from plots.drawn_slide(ground, grid, sample, soil, shown)
        if ground.dimension == 3 and shown.times:
            of, displacement = ground.grids[grid], np.stack(shown.displacement)
            caption = f"{plots.title(sample)}: the ground with its soil, by how far it has moved."
            body = bodies.moving(np.asarray(of.position, float), displacement, shown.times, of.half_size)
            yield Drawn(f"body-{number:06d}", caption, bodies.picture(body), body)
    first = samples[numbers[0]]
    if {"displacement", "plastic_strain"} <= first.fields.keys():
        yield plots.drawn_change(ground, grid, first)
    yield from plots.drawn_fields(ground, first, {each: soils[each, numbers[0]] for each in GRIDS})


def kept_moments(sample: Sample, soil: runs.SampleSoil) -> runs.Frames:
    """A sample's frames in single precision, and its end; nothing where its fields were not kept."""
    if "displacement" not in sample.fields:
        return runs.Frames()
    frames = runs.Frames.of(sample.fields)
    earlier = (each.astype(np.float32) for each in frames.displacement)
    end = sample.steps * soil.time_step
    return runs.Frames((*frames.times, end), (*earlier, sample.fields["displacement"]))


def moments(model: runs.GridModel, sample: Sample) -> runs.Frames:
    """Run a finished sample again and keep its displacement when it has moved the given shares of its largest one, and
    at its end."""
    due = [share * float(sample.row["displacement"]) for share in SHARES]
    times: list[float] = []
    kept: list[np.ndarray] = []

    def look(_: int, seconds: float, midway: Midway) -> None:
        displacement = midway.state.displacement
        if due and float(np.linalg.norm(displacement, axis=0).max()) >= due[0]:
            del due[0]
            times.append(seconds)
            kept.append(np.asarray(displacement))

    run = model.campaign.run
    varied = {name: [value] for name, value in model.varied(sample.coefficients).items()}
    for _, result in solve_each(
        model.scene, model.state, varied, width=1, t_end=run.t_end, settle=run.settle, slides_end=model.slides_end,
        least_volume=run.least_volume, observe=look,
    ):  # fmt: skip
        end = int(result.state.step) * float(result.time_step)
        if not times or end > times[-1]:
            times.append(end)
            kept.append(np.asarray(result.state.displacement))
    return runs.Frames(tuple(times), tuple(kept))


def _live(
    results: Results,
    maps: Maps | None,
    figures: Sequence[Drawn],
    moved: Mapping[str, np.ndarray],
    labels: Mapping[str, str],
) -> dict[str, str]:
    """Parts of the page that answer and turn, by the names of the figures that they stand for."""
    found = results.summary
    made = {
        "ranked": interactive.ranked(moved, found.failure_displacement),
        "grids": interactive.grids(moved, found.failure_displacement),
    }
    if curves := _curves(results):
        made["exceedance"] = interactive.stairs(curves, labels, "probability of more [-]")
    if maps is not None:
        draw = interactive.plan_maps if results.ground.dimension == 3 else interactive.profile
        made["hazard"] = draw(maps, toe=_toe(results))
    if found.risk and found.risk.loss:
        curve = found.risk.loss.exceedance
        made["losses"] = interactive.stairs({"loss": curve}, LOSS, "probability of losing more [-]")
    made |= {drawn.name: interactive.turning(drawn.body) for drawn in figures if drawn.body}
    return {drawn.name: interactive.html(made[drawn.name], drawn.name) for drawn in figures if drawn.name in made}


def _parts(results: Results, figures: Sequence[Drawn], live: Mapping[str, str]) -> Iterator[str]:
    """The page from top to bottom: what a decision needs, then how it was found. live: what stands for figures, by
    their names."""
    found, names = results.summary, {drawn.name for drawn in figures}

    def shown(*names: str) -> Iterator[str]:
        mine = [page.figure(drawn, live.get(drawn.name)) for drawn in figures if drawn.name.startswith(names)]
        if mine:
            yield page.figures(mine)

    yield page.heading(found.name, 1)
    yield from page.answer(results)
    missing = page.without_slides(found)
    if live:
        yield page.paragraph(HOW)
    if missing or {"exceedance", "hazard"} & names:
        yield page.heading("How far, how much, how deep")
        yield from [page.paragraph(missing)] if missing else []
        yield from shown("exceedance", "hazard")
    if found.risk:
        yield page.heading("Exposed places")
        yield from page.risks(found, found.risk)
        yield from shown("losses")
    yield page.heading("What the slides look like" if results.slid.any() else "What the slope looks like")
    yield from page.look(results)
    yield from shown("slide", "plan", "body", "slope")
    yield page.heading("How sure, and why")
    yield page.estimates(found)
    yield page.paragraph(" ".join(line for line in (page.unseen(found), page.finished(found)) if line))
    yield from shown("convergence", "ranked", "grids")
    yield page.heading("What more runs would buy")
    yield from page.bought(results)
    yield page.heading("How it was run")
    yield page.run_table(results)
    yield from shown("field")
    if missing or {"severity", "fits-all"} & names:
        yield page.heading("Distributions of what the slides do")
    if missing:
        yield page.paragraph(missing)
    elif {"severity", "fits-all"} & names:
        yield from shown("severity")
        yield from page.best_fits(results)
        yield from shown("fits")
    yield page.heading("Scene")
    yield page.preformatted("\n".join(short(line, 400) for line in results.store.source.words.strip().splitlines()))
