"""The report of a campaign, read from its folder alone: its figures, one page with all of them, a summary in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cooperative import runs
from cooperative.estimate import Estimator, Exceedance
from cooperative.folder import Results, model_of, models_of, read_results
from cooperative.hazard import THICKNESS, HazardMaps, maps_of
from cooperative.names import DRAWN_SLIDES
from cooperative.reporting import _bodies as bodies
from cooperative.reporting import _charts as charts
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _plots as plots
from cooperative.reporting import _sentences as sentences
from cooperative.reporting._interactive import Drawn
from cooperative.reporting._page import page
from cooperative.scene import campaign_of
from cooperative.store import FAILED_AT, GRIDS, FinishedRun, Scalar, own_folder, read_sample, write_aside
from jaxmpm import diagnostics, solve_each
from jaxmpm.run import Hooks, Midway
from jaxmpm.support.files import remove_leftovers

SHARES = (0.1, 0.3, 0.6)
"""Shares of the largest displacement at which a slide that is run again is drawn, and at its end."""

LOSS = {"loss": "loss [currency of the scene]"}
"""Label of an axis, as `labels` has those of consequences."""


def report(
    folder: str | Path, *, slides: int = DRAWN_SLIDES, again: bool = False, estimator: Estimator | None = None
) -> str:
    """Draw the figures of a campaign into `figures/` and write `report.html` with all of them.

    Args:
        folder: of the campaign; it may be running.
        slides: how many slides to draw at several times, the farthest of each mode, from the frames and fields of
            their runs.
        again: whether to run these slides again and draw more moments; without it nothing is solved.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one.

    Returns:
        The summary in words.

    Raises:
        ValueError: the folder holds no campaign or no finished sample, or `slides` is below 0.
    """
    if slides < 0:
        raise ValueError(f"slides = {slides}: give 0 or more")
    results = read_results(folder, estimator)
    labels, cut = sentences.labels(results), sentences.cut_off(results.summary)
    figures = [*_hazards(results, labels, cut), *_numbers(results, labels, cut)]
    figures += _slopes(results, slides, again, estimator)
    _write(results, figures)
    write_aside(results.store.folder / "report.html", page(results, figures).encode())
    return sentences.words(results)


def draw_slides(results: Results, *, slides: int = DRAWN_SLIDES, again: bool = False) -> list[Drawn]:
    """Draw what the slides of a campaign reach and how they look into its `figures/`.

    Args:
        results: of the campaign.
        slides: how many to draw at several times, as for `report`.
        again: whether to run these again, as for `report`.

    Returns:
        The figures.
    """
    labels, cut = sentences.labels(results), sentences.cut_off(results.summary)
    figures = [*_hazards(results, labels, cut), *_slopes(results, slides, again, None)]
    _write(results, figures)
    return figures


def _write(results: Results, figures: Iterable[Drawn]) -> None:
    """Save figures in the folder of a campaign."""
    target = own_folder(results.store.folder / "figures")
    for written in (results.store.folder, target):
        remove_leftovers(written)
    for figure in figures:
        plots.lay_out(figure.figure)
        plots.save(figure.figure, target / f"{figure.name}.png")


def _hazards(results: Results, labels: Mapping[str, str], cut: str) -> Iterator[Drawn]:
    """Figures of how likely a slide does how much."""
    summary, pf, maps = results.summary, results.summary.probability, maps_of(results)
    # A curve of one step, as of slides that are all as deep as the ground, shows no more than P_f.
    exceedances = summary.consequences.exceedance.items()
    curves = {name: steps for name, steps in exceedances if len({*steps.probability[:-1]}) > 1}
    if curves:
        yield Drawn(
            "exceedance",
            "Probability that a slope fails and its slide exceeds the value on the axis, with the "
            f"{pf.level:.0%} interval at each point. The curves start at the probability of failure.{cut}",
            charts.exceedance(curves, labels, level=pf.level),
            partial(interactive.stairs, curves, labels, "probability of more [-]"),
        )
    if maps is not None:
        toe = None if results.ground.face is None else results.ground.face.toe_x
        solid = results.ground.dimension == 3
        yield Drawn(
            "hazard",
            _mapped(maps, pf.level) + cut,
            (charts.plan_maps if solid else charts.profile)(maps, toe=toe),
            partial(interactive.plan_maps if solid else interactive.profile, maps, toe=toe),
        )
    if summary.consequences.risk and summary.consequences.risk.loss:
        curve: Exceedance = summary.consequences.risk.loss.exceedance
        if summary.consequences.risk.loss.expected:
            yield Drawn(
                "losses",
                "Probability that the elements at risk together lose more than the value on the axis. The area under "
                f"the curve is the expected loss.{cut}",
                charts.losses(curve, level=pf.level),
                partial(interactive.stairs, {"loss": curve}, LOSS, "probability of losing more [-]"),
            )


def _mapped(maps: HazardMaps, level: float) -> str:
    """What maps show."""
    few = not np.isfinite(maps.maps[THICKNESS].high).any()
    return (
        f"Probability that soil comes above the ground of a column of cells of {maps.plan.cell:g} m, from "
        f"{maps.slides} slides, with the {level:.0%} interval of each column. A column counts as reached when the mean "
        f"thickness of that soil is {maps.least:.2g} m or more; soil that slides below the old surface does not count. "
        f"Columns are read every {maps.every:.2g} s, in which the fastest soil moved "
        f"{maps.missed:.2g} m; shorter peaks are missed."
        + (" The slides are too few for intervals of thickness and arrival." if few else "")
    )


def _numbers(results: Results, labels: Mapping[str, str], cut: str) -> Iterator[Drawn]:
    """Figures of the other numbers, those that there are data for."""
    summary, pf = results.summary, results.summary.probability
    modes, displacements = sentences.occurring(summary), _displacements(results)
    columns, limit = results.refined.columns, pf.failure_displacement
    decided = "DECIDED" in columns.get("status", ())
    stopped = " Runs that ended once they had failed are drawn with the displacement they had then." if decided else ""
    yield Drawn(
        "ranked",
        "Largest displacement of every sample by its rank on the rough grid, with the refined runs. Refined failures "
        f"should become rare down the ranks.{stopped}",
        charts.ranked_displacements(displacements, failure_displacement=limit),
        partial(interactive.ranked, displacements, limit),
    )
    if len(pf.convergence.refined_runs) > 1:
        yield Drawn(
            "convergence",
            "Probability of failure and its interval as refined runs came in.",
            charts.convergence(pf.convergence, pf.estimator, level=pf.level),
        )
    ended = np.isfinite(displacements["rough"]) & np.isfinite(displacements["refined"])
    if ended.any():
        yield Drawn(
            "grids",
            f"Samples that ran on both grids. {sentences.agreement(summary)}{stopped}",
            charts.grids(displacements["rough"][ended], displacements["refined"][ended], failure_displacement=limit),
            partial(interactive.grids, displacements, limit),
        )
    if len(modes) > 1:
        yield Drawn("modes", "Failure modes by their weighted share.", charts.mode_shares(modes))
    if summary.modes.severity and len(modes) > 1:
        yield Drawn(
            "severity",
            "Median of each consequence by failure mode, with its 90 % bootstrap interval.",
            charts.severity(summary.modes.severity, labels),
        )
    for group, fits in sentences.distinct(results).items():
        slides = results.slid & (results.weight > 0)
        slides &= (columns["mode"] == group) if group != "all" else True
        if fits:
            yield Drawn(
                f"fits-{group}",
                f"Distribution of the consequences of {group} failures ({slides.sum()} runs), with the three best fits."
                f"{cut}",
                charts.fitted({name: columns[name][slides] for name in fits}, results.weight[slides], fits, labels),
            )


def _displacements(results: Results) -> dict[str, np.ndarray]:
    """Number of every sample and its largest displacement on the rough and the refined grid (N,) m, nan for none."""
    rough, refined = results.rough, results.refined
    second = np.full(len(rough.numbers), np.nan)
    # A refined run that broke off counts with the displacement it had then.
    at = np.isin(rough.numbers, refined.numbers)
    second[at] = refined.columns.get("displacement", np.zeros(0))
    first = np.where(rough.columns["broke_off"].astype(bool), np.nan, rough.columns["displacement"])
    return {"sample": np.array(rough.numbers), "rough": first, "refined": second}


def _slopes(results: Results, slides: int, again: bool, estimator: Estimator | None) -> Iterator[Drawn]:
    """Pictures of chosen samples."""
    store, ground, chosen = results.store, results.ground, results.soils(slides)
    grid, numbers = results.slides_to_draw(slides)
    soils: Mapping[tuple[str, int], runs.SampleSoil] = runs.read_drawn(store.folder, chosen)
    samples = {number: read_sample(store, grid, number) for number in numbers}
    model_at: Callable[[Scalar | None], runs.GridModel] | None = None
    if again or len(soils) < len(chosen):
        # The random soil of these samples is not stored, or they run again.
        campaign = campaign_of(store, estimator)
        models, model_at = models_of(campaign), cache(partial(model_of, campaign, grid))
        soils = {of: soils.get(of) or runs.soil_of(models[of[0]], samples[of[1]].coefficients) for of in chosen}
    for number in numbers[:slides]:
        sample, soil = samples[number], soils[grid, number]
        shown = (
            moments(model_at(sample.row.get(FAILED_AT)), sample) if again and model_at else stored_moments(sample, soil)
        )
        yield from drawn_slide(ground, grid, sample, soil, shown)
        if ground.dimension == 3 and shown.times:
            of, displacement = ground.grids[grid], np.stack(shown.displacement)
            body = bodies.moving(np.asarray(of.position, float), displacement, shown.times, of.half_size)
            caption = f"{title(sample)}: the ground with its soil, coloured by displacement."
            yield Drawn(f"body-{number:06d}", caption, bodies.picture(body), partial(interactive.turning, body))
    first = samples[numbers[0]]
    if {"displacement", "plastic_strain"} <= first.fields.keys():
        yield drawn_change(ground, grid, first)
    yield from drawn_fields(ground, first, {grid_name: soils[grid_name, numbers[0]] for grid_name in GRIDS})


def stored_moments(sample: FinishedRun, soil: runs.SampleSoil) -> runs.Frames:
    """A sample's stored frames in single precision, and its end; none where its fields were not stored."""
    if "displacement" not in sample.fields:
        return runs.Frames()
    frames = runs.Frames.of(sample.fields)
    earlier = (displacement.astype(np.float32) for displacement in frames.displacement)
    end = sample.steps * soil.time_step
    return runs.Frames((*frames.times, end), (*earlier, sample.fields["displacement"]))


def moments(model: runs.GridModel, sample: FinishedRun) -> runs.Frames:
    """Displacement of a finished sample, run again, at the given shares of its largest one and at its end."""
    due = [share * float(sample.row["displacement"]) for share in SHARES]
    times: list[float] = []
    displacements: list[np.ndarray] = []

    def report_moment(_: int, seconds: float, midway: Midway) -> None:
        if due and float(diagnostics.largest_displacement(midway.state)) >= due[0]:
            del due[0]
            times.append(seconds)
            displacements.append(np.asarray(midway.state.displacement))

    varied = {name: [value] for name, value in model.varied(sample.coefficients).items()}
    for _, result in solve_each(
        model.scene, model.state, varied, width=1, t_end=model.t_end, rules=model.campaign.rules(),
        hooks=Hooks(observe=report_moment),
    ):  # fmt: skip
        end = int(result.state.step) * float(result.time_step)
        if not times or end > times[-1]:
            times.append(end)
            displacements.append(np.asarray(result.state.displacement))
    return runs.Frames(tuple(times), tuple(displacements))


def drawn_fields(
    ground: runs.StoredGround, sample: FinishedRun, soils: Mapping[str, runs.SampleSoil]
) -> Iterator[Drawn]:
    """The random fields of one sample on both grids, a picture for each parameter.

    Args:
        ground: of the campaign.
        sample: whose fields are drawn.
        soils: of the sample, by grid.
    """
    planes = {grid: _plane(ground, grid, sample) for grid in soils}
    sections = {grid: plots.section_of(ground.grids[grid], plane) for grid, plane in planes.items()}
    for number, name in enumerate(ground.random):
        seen = {grid: soil.values[name][planes[grid]] for grid, soil in soils.items()}
        caption = f"Sample {sample.number}: the same random field of {_word(name)} on both grids."
        if ground.bottoms is not None and len(ground.bottoms):
            caption += " Lines: lower boundaries of the layers."
        figure = plots.parameter_fields(name, sections, seen)
        for ax, (grid, plane) in zip(figure.axes, planes.items(), strict=False):
            _draw_outline(ax, ground, float(ground.grids[grid].position[1, plane].mean()))
        yield Drawn(f"field-{name}" if number else "field", caption, figure)


def _draw_outline(ax: Axes, ground: runs.StoredGround, y: float) -> None:
    """Lower boundaries of layers, and walls along x, in a section at y (m)."""
    for x, z in ground.boundaries(y):
        ax.plot(x, z, color="k", lw=0.8)
    for axis, position, hold in ground.walls:
        if axis == 0:
            ax.axvline(position, color="k", lw=1.5, ls="--" if hold == "roller" else "-")


def drawn_change(ground: runs.StoredGround, grid: str, sample: FinishedRun) -> Drawn:
    """One sample's section before and after, by the stored plastic strain."""
    plane = _plane(ground, grid, sample)
    section, half = plots.section_of(ground.grids[grid], plane)
    displacement, strain = sample.fields["displacement"][:, plane], sample.fields["plastic_strain"][plane]
    caption = f"Sample {sample.number} before and after its slide, by plastic strain."
    return Drawn("slope", caption, plots.before_and_after(section, displacement, strain, half))


def drawn_slide(
    ground: runs.StoredGround, grid: str, sample: FinishedRun, soil: runs.SampleSoil, shown: runs.Frames
) -> Iterator[Drawn]:
    """A sample's strength and slide at several times, in 3D from above too; nothing where no moment is known.

    Nor where a law of the user's own, of which nothing is random, declares no strength.
    """
    if not shown.times or not soil.values:
        return
    displacement, plane = np.stack(shown.displacement), _plane(ground, grid, sample)
    name, of = next(iter(ground.random or soil.values)), ground.grids[grid]
    seen = displacement[:, :, plane]
    where = " Section where it moved farthest." if ground.dimension == 3 else ""
    yield Drawn(
        f"slide-{sample.number:06d}",
        f"{title(sample)}: {_word(name)} and slide.{where}",
        plots.slide(plots.section_of(of, plane), name, soil.values[name][plane], seen, shown.times),
    )
    if ground.dimension == 3:
        toe = None if ground.face is None else ground.face.toe_x
        yield Drawn(
            f"plan-{sample.number:06d}",
            f"{title(sample)}, by how far the soil on top has moved, from above.",
            plots.plan(np.asarray(of.position, float), displacement, shown.times, of.half_size, toe=toe),
        )


def title(sample: FinishedRun) -> str:
    """Number and failure mode of a sample."""
    mode = sample.row.get("mode")
    return f"Sample {sample.number}" + ("" if mode in (None, "none") else f", {mode}")


def _word(name: str) -> str:
    return "strength" if name == "strength" else plots.quantity(name).word


def _plane(ground: runs.StoredGround, grid: str, sample: FinishedRun) -> np.ndarray:
    """Particles (N,) of the section to draw: all of them in 2D, in 3D the slice that moved farthest."""
    of, displacement = ground.grids[grid], sample.fields.get("displacement")
    if ground.dimension == 3 and displacement is not None and displacement.shape == of.position.shape:
        return plots.plane_at(of, float(of.position[1, np.argmax(np.linalg.norm(displacement, axis=0))]))
    return plots.plane_at(of, ground.middle)
