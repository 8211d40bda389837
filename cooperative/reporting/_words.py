"""What a person sees of a campaign, read from its folder alone: a summary in words, figures, and one page with all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cooperative import runs, summary
from cooperative.estimate import ENOUGH, Estimator, Phases, after_more_runs
from cooperative.hazard import Maps, maps_of
from cooperative.reporting import _charts as charts
from cooperative.reporting import _page as page
from cooperative.reporting import _pictures as pictures
from cooperative.reporting import _plots as plots
from cooperative.reporting._plots import Drawn
from cooperative.reporting._progress import duration, planned_rough
from cooperative.runs import GridModel
from cooperative.scene import Campaign, campaign_of
from cooperative.store import GRIDS, Rows, Store, own_folder, read_sample, read_store, write_aside
from foundation.text import printable, short
from jaxmpm import Slope

INDISTINCT = 2.0
"""Difference in AIC below which two distributions are as good as each other."""

MORE_RUNS = (10, 25, 50, 100, 200, 500, 1000)
"""Further refined runs of which the page tells what they would buy."""

HOW = (
    "Figures answer: point at one to read its values, draw a frame in it to see that part larger, double-click for all "
    "of it. With the keyboard, Tab goes to a figure, arrow keys read, + and - zoom, 0 shows all."
)
"""To whom the page's script runs; not printed."""

SLIDES = 3
"""Slides drawn at several times, unless the caller says otherwise."""


@dataclass(frozen=True)
class Told:
    """A campaign read once: its rows, and its summary as `summary.json` has it. left_out: what is there and does not
    count, and why. maps: of hazard, None where the scene asks for none or nothing slid."""

    store: Store
    campaign: Campaign
    rough: Rows
    refined: Rows
    summary: dict[str, Any]
    left_out: tuple[str, ...] = ()
    maps: Maps | None = None

    @cached_property
    def phases(self) -> Phases:
        """What the rows tell the campaign's estimator."""
        return runs.phases_of(self.campaign, self.rough, self.refined)

    @property
    def labels(self) -> dict[str, str]:
        """Axis label of each consequence, with its unit. In a section the influence area is the run-out, and is told
        once."""
        solid = self.campaign.dimension == 3
        return {
            "displacement": "largest displacement $R_d$ [m]",
            "depth": "sliding depth $H$ [m]",
            "runout": "run-out $L$ [m]",
            "volume": f"sliding volume $V$ [{'m$^3$' if solid else 'm$^3$/m'}]",
        } | ({"area": "influence area $S$ [m$^2$]"} if solid else {})

    @property
    def units(self) -> dict[str, str]:
        """Unit of each consequence in words."""
        each = "" if self.campaign.dimension == 3 else " per metre of width"
        toe = isinstance(self.campaign.site.shape, Slope)
        drawn = "" if self.campaign.site.track is None else ", along the line that the scene draws"
        return {
            "displacement": "m",
            "depth": "m below the crest" if toe else "m below the surface",
            "runout": "m beyond the toe" if toe else f"m from its rear to its front{drawn}",
            "volume": f"m³{each}",
            "area": "m² beyond the toe" if toe else "m² at its end",
        }

    @property
    def failed(self) -> np.ndarray:
        """Refined runs that failed and have consequences: they slid to their end (runs,) bool."""
        slid = summary.slides_of(self.campaign, self.phases, self.refined).slid
        return slid & ~self.refined.columns.get("broke_off", np.zeros(slid.size)).astype(bool)


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


def words(told: Told) -> str:
    """The summary for people."""
    found = told.summary
    low, high = found["interval"]
    lines = [
        f"{found['name']}",
        f"  probability of failure  {found['probability_of_failure']:.3f}  "
        f"({found['level']:.0%} interval {low:.3f} to {high:.3f}; {found['estimator']})",
    ]
    lines += [f"  {line}" for line in (_unseen(found),) if line]
    for method, other in found["other_estimates"].items():
        low, high = other["interval"]
        lines.append(f"  beside it: {method:<14} {other['probability']:.3f}  ({low:.3f} to {high:.3f})")
    lines += [
        f"  rough grid     {found['samples']} samples, {found['failures_rough']} beyond the failure displacement, "
        f"{found['seconds']['rough']:.0f} s",
        f"  refined grid   {found['refined_runs']} runs, {found['failures_refined']} failures, "
        f"{found['seconds']['refined']:.0f} s",
    ]
    lines += [f"  {line}" for line in (_more(found), _agreement(found)) if line]
    for mode, share in (found["modes"] or {}).items():
        if share["count"]:
            low, high = share["interval"]
            lines.append(f"  {mode:<13}  {share['ratio']:.0%} of the failures ({low:.0%} to {high:.0%})")
    for name, spread in found["consequences_of_failures"].items():
        if spread and name in told.labels:
            lines.append(
                f"  {name:<13}  mean {spread['mean']:.4g} ({_limits(spread['interval'])}), {spread['smallest']:.4g} to "
                f"{spread['largest']:.4g} ({told.units[name]}, failed samples)"
            )
    lines += [f"  BROKE OFF      {line}" for line in _broken(found)]
    lines += [f"  LEFT OUT       {line}" for line in told.left_out]
    lines += [f"  note: {note}" for note in found["notes"]]
    lines.append(f"  all of it, with figures: {told.store.folder / 'report.html'}")
    return "\n".join(map(printable, lines))


def _numbers(told: Told) -> Iterator[Drawn]:
    """Figures of the numbers, those that there are data for."""
    yield from _hazards(told)
    rough, refined, limit = told.rough, told.refined, told.campaign.run.failure_displacement
    place = {number: at for at, number in enumerate(rough.numbers)}
    both = np.full(len(place), np.nan)
    both[[place[number] for number in refined.numbers]] = refined.columns.get("displacement", np.zeros(0))
    first = np.where(rough.columns["broke_off"].astype(bool), np.nan, rough.columns["displacement"])
    yield Drawn(
        "ranked",
        "Largest displacement of every sample by its rank on the rough grid, with the refined runs. Refined failures "
        "should thin out down the ranks.",
        charts.ranked_displacements({"rough": first, "refined": both}, failure_displacement=limit),
    )
    way = told.summary["convergence"]
    if len(way["refined_runs"]) > 1:
        yield Drawn(
            "convergence",
            "Probability of failure and its interval as refined runs came in.",
            charts.convergence(
                {told.summary["estimator"]: np.array(way["refined_runs"])},
                {told.summary["estimator"]: np.array(way["probability"])},
                {told.summary["estimator"]: np.array([way["low"], way["high"]])},
            ),
        )
    ended = np.isfinite(first) & np.isfinite(both)
    if ended.any():
        figure = charts.grids(first[ended], both[ended], failure_displacement=limit)
        yield Drawn("grids", f"Samples that ran on both grids. {_agreement(told.summary)}", figure)
    modes = {mode: share for mode, share in (told.summary["modes"] or {}).items() if share["count"]}
    if len(modes) > 1:
        yield Drawn("modes", "Failure modes, by what the runs stand for.", charts.mode_shares(modes))
    if told.summary["severity"] and len(modes) > 1:
        yield Drawn(
            "severity",
            "Median of each consequence by failure mode, with its 90 % bootstrap interval.",
            charts.severity(told.summary["severity"], told.labels),
        )
    weight = summary.slides_of(told.campaign, told.phases, refined).weight
    for group, fits in _distinct(told).items():
        mine = told.failed & (weight > 0)
        mine &= (refined.columns["mode"] == group) if group != "all" else True
        if fits:
            yield Drawn(
                f"fits-{group}",
                f"Distribution of the consequences of {group} failures ({mine.sum()} runs), with the three best fits.",
                charts.fitted({name: refined.columns[name][mine] for name in fits}, weight[mine], fits, told.labels),
            )


def _hazards(told: Told) -> Iterator[Drawn]:
    """Figures of how likely a slide does how much."""
    # A curve of one step, as of slides that are all as deep as the ground, tells no more than P_f.
    curves = {name: each for name, each in told.summary["exceedance"].items() if len({*each["probability"][:-1]}) > 1}
    if curves:
        yield Drawn(
            "exceedance",
            "Probability that a sample of the slope fails and its slide goes beyond what stands below, with its "
            f"{told.summary['level']:.0%} interval at each point. The curves start at the probability of failure.",
            charts.exceedance(curves, told.labels, level=told.summary["level"]),
        )
    maps, shape = told.maps, told.campaign.site.shape
    toe = shape.toe_x if isinstance(shape, Slope) else None
    if maps is not None:
        draw = charts.plan_maps if told.campaign.dimension == 3 else charts.profile
        yield Drawn("hazard", _mapped(maps, told.summary["level"]), draw(maps, toe=toe))
    risk = told.summary["risk"]
    if risk and risk["loss"] and risk["loss"]["expected"]:
        yield Drawn(
            "losses",
            "Probability of losing more than stands below at the exposed places together. The area under the curve is "
            "the expected loss.",
            charts.losses(risk["loss"]["exceedance"], level=told.summary["level"]),
        )


def _mapped(maps: Maps, level: float) -> str:
    """What maps show, in words."""
    return (
        f"How likely soil that moved reaches a column of cells of {maps.plan.cell:g} m, from {maps.slides} slides, "
        f"with the {level:.0%} interval of each column. Soil counts as there from {maps.least:.2g} m on, averaged over "
        f"the column. It was looked at every {maps.every:.2g} s, in which the fastest soil went {maps.missed:.2g} "
        "m: peaks shorter than that are missed."
    )


def _distinct(told: Told) -> dict[str, dict[str, Any]]:
    """Fits of all failures and of each mode, but not of a mode that all failures have."""
    fits: dict[str, dict[str, Any]] = told.summary["fits"]
    modes = [fit for group, fit in fits.items() if group != "all"]
    kept = {"all": fits["all"]} if modes == [fits.get("all")] else fits
    # What is the same in all slides has no distribution.
    return {
        group: {name: fit for name, fit in each.items() if name in told.labels and fit["fits"]}
        for group, each in kept.items()
    }


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
    yield from _answer(told)
    if {"exceedance", "hazard"} & figures.keys():
        yield page.heading("How far, how much, how deep")
        yield page.paragraph(HOW, "how")
        yield from shown("exceedance", "hazard")
    if found["risk"]:
        yield page.heading("Exposed places")
        yield from _risk(found)
        yield from shown("losses")
    yield page.heading("What the slides look like" if told.failed.any() else "What the slope looks like")
    yield from _look(told)
    yield from shown("slide", "plan", "slope")
    yield page.heading("How sure, and why")
    yield _estimates(found)
    yield page.paragraph(" ".join(line for line in (_unseen(found), _finished(found)) if line))
    yield from shown("convergence", "ranked", "grids")
    yield page.heading("What more runs would buy")
    yield from _bought(told)
    yield page.heading("How it was run")
    yield _runs(told)
    yield from shown("field")
    if {"severity", "fits-all"} & figures.keys():
        yield page.heading("Distributions of what the slides do")
        yield from shown("severity")
        yield from _fits(told)
        yield from shown("fits")
    yield page.heading("Scene")
    yield page.preformatted("\n".join(short(line, 400) for line in told.campaign.text.strip().splitlines()))
    yield page.SCRIPT
    if any(drawn.page for drawn in slopes):
        yield page.TURN


def _answer(told: Told) -> Iterator[str]:
    """The answer in a sentence, what it rests on, and what a reader must beware of."""
    found = told.summary
    chance, (low, high) = found["probability_of_failure"], found["interval"]
    yield page.answer(
        "The slope fails with probability" if chance else "No run has failed: the slope fails with probability",
        f"{chance:.3g}",
        f"({found['level']:.0%} interval {low:.3g} to {high:.3g}){in_slopes(chance)}.",
    )
    yield page.paragraph(
        f"It fails when soil moves farther than {told.campaign.run.failure_displacement:g} m. "
        f"{found['samples']} random slopes ran on the rough grid, {found['refined_runs']} of them on the refined one, "
        f"where {found['failures_refined']} failed. {_reach(told)}".strip()
    )
    if not found["finished"]:
        planned = planned_rough(told.campaign)
        yield page.paragraph(
            f"The campaign has not ended: this is what is known so far, from {found['samples']} of {planned} samples "
            f"on the rough grid and {found['refined_runs']} refined runs.",
            "note",
        )
    for note in [*found["notes"], *(f"broke off: {line}" for line in _broken(found))]:
        yield page.paragraph(note, "note")


def in_slopes(chance: float) -> str:
    """A probability as a count of slopes; empty where there is nothing to count."""
    if not 0 < chance < 1:
        return ""
    return (
        f": {chance * 100:.0f} in 100 such slopes"
        if chance > 0.095
        else f": one in {float(f'{1 / chance:.2g}'):.0f} such slopes"
    )


def _reach(told: Told) -> str:
    """How far one slope in ten, a hundred or a thousand goes, the rarest of which the runs tell; else empty."""
    curve, found = told.summary["exceedance"].get("runout"), told.phases.estimate
    if not curve:
        return ""
    for many in (10, 100, 1000):
        if found.probability > 1.2 / many:
            reached = [at for at, chance in zip(curve["thresholds"], curve["probability"], strict=True)
                       if chance >= 1 / many]  # fmt: skip
            return (
                f"One slope in {many} slides to {reached[-1]:.3g} {told.units['runout']} or farther." if reached else ""
            )
    return ""


def _look(told: Told) -> Iterator[str]:
    """What the slides do on average, and which modes they have."""
    yield _consequences(told)
    modes = {mode: share for mode, share in (told.summary["modes"] or {}).items() if share["count"]}
    if len(modes) == 1:
        yield page.paragraph(f"All failures are {next(iter(modes))}.")
    elif modes:
        yield page.table(
            ["failure mode", "runs", "share of the failures", f"{told.summary['level']:.0%} interval", "probability"],
            [
                [mode, each["count"], float(each["ratio"]), _limits(each["interval"]), float(each["probability"])]
                for mode, each in modes.items()
            ],
        )


def _bought(told: Told) -> Iterator[str]:
    """What further refined runs would buy, and how long they would take."""
    found, estimate = told.summary, told.phases.estimate
    left = found["samples"] - found["refined_runs"]
    if left <= 0:
        yield page.paragraph("Every sample has run on the refined grid: only more samples would narrow the interval.")
        return
    if found["coefficient_of_variation"] is None:
        yield page.paragraph("No run has failed so far: the runs do not tell yet what more of them would buy.")
        return
    each = found["seconds"]["refined"] / max(found["refined_runs"], 1)
    counts = [*(count for count in MORE_RUNS if count < left), left]
    yield page.table(
        ["more refined runs", "coefficient of variation", "time of one machine, about"],
        [[count, float(after_more_runs(estimate, count)), duration(count * each)] for count in counts],
    )
    yield page.paragraph(
        "The last row runs every sample: what doubt is left then is that of the number of samples, and only more of "
        "them would lessen it."
    )


def _estimates(found: dict[str, Any]) -> str:
    own = {"probability": found["probability_of_failure"], "interval": found["interval"]}
    methods = {found["estimator"]: own} | found["other_estimates"]
    cov = found["coefficient_of_variation"]
    return page.table(
        ["estimator", "probability", f"{found['level']:.0%} interval", "coefficient of variation"],
        [
            [
                name,
                float(each["probability"]),
                "{:.3g} to {:.3g}".format(*each["interval"]),
                cov if name == found["estimator"] else None,
            ]
            for name, each in methods.items()
        ],
    )


def _consequences(told: Told) -> str:
    rows = [
        [name, told.units[name], spread["mean"], _limits(spread["interval"]), spread["smallest"], spread["largest"]]
        for name, spread in told.summary["consequences_of_failures"].items()
        if spread and name in told.labels
    ]
    if not rows:
        return page.paragraph("No refined run failed.")
    columns = ["of the failed samples", "unit", "mean", f"{told.summary['level']:.0%} interval", "smallest", "largest"]
    return page.table(columns, rows)


def _risk(found: dict[str, Any]) -> Iterator[str]:
    """What comes over the exposed places and what is lost."""

    def mean(spread: dict[str, Any]) -> float | None:
        return spread.get("mean")

    rows: list[list[str | float | int | None]] = []
    for name, place in found["risk"]["places"].items():
        loss = place.get("loss")
        rows.append(
            [
                name,
                place["reached"]["probability"],
                _limits(place["reached"]["interval"]),
                *(mean(place[what]) for what in ("arrival", "thickness", "speed")),
                loss and loss["expected"],
                loss and _limits(loss["interval"]),
            ]
        )
    level = f"{found['level']:.0%} interval"
    heads = ["place", "probability of being reached", level, "arrival, s", "thickness, m", "speed, m/s"]
    yield page.table([*heads, "expected loss", level], rows)
    yield page.paragraph(
        "Arrival, thickness and speed are means over the slides that come, of the largest values at the place."
    )
    loss = found["risk"]["loss"]
    if not loss:
        return
    modes = ", ".join(f"{share:.0%} {mode}" for mode, share in loss["modes"].items() if share)
    most = ", ".join(f"{each['sample']} ({each['share']:.0%})" for each in loss["samples"])
    yield page.paragraph(
        f"Expected loss per slope {page.number(loss['expected'])} ({_limits(loss['interval'])})"
        + (f"; {modes} slides make it" if modes else "")
        + (f"; most of it the samples {most}." if most else ".")
    )


def _limits(interval: Sequence[float] | None) -> str:
    return "too few for an interval" if interval is None else " to ".join(map(page.number, interval))


def _fits(told: Told) -> Iterator[str]:
    rows: list[list[str | float | int | None]] = []
    few: dict[str, int] = {}
    for group, fits in _distinct(told).items():
        for name, fit in fits.items():
            best, *others = fit["fits"] or [None]
            close = [other["name"] for other in others if other["aic"] - best["aic"] < INDISTINCT]
            rows.append([group, name, fit["best_aic"], fit["best_bic"], ", ".join(close) or None])
            few |= {group: fit["samples"]} if fit["samples"] < ENOUGH else {}
    if few:
        said = ", ".join(f"{count} {group}" for group, count in few.items())
        yield page.paragraph(
            f"Too few failures to tell distributions apart ({said}): {ENOUGH} or more would do.", "note"
        )
    yield page.table(["failures", "consequence", "best by AIC", "best by BIC", "hardly worse by AIC"], rows)


def _runs(told: Told) -> str:
    rows: list[list[str | float | int | None]] = []
    made: dict[str, str] = {}
    for grid, of in zip(GRIDS, (told.rough, told.refined), strict=True):
        statuses = ", ".join(f"{count} {status}" for status, count in told.summary["status"][grid].items())
        rows.append([f"{grid} grid", f"{statuses or 'none'}; {duration(told.summary['seconds'][grid])} of runs"])
        rows.append([f"{grid} grid", _bands(told.campaign, grid)])
        for number in of.numbers[-1:]:
            last = read_sample(told.store, grid, number)
            versions = ", ".join(f"{name} {version}" for name, version in last.versions.items())
            made[grid] = f"{last.dtype} on {last.device}; {versions}"
    rows += [
        [f"last sample, {' and '.join(g for g in made if made[g] == how)} grid", how] for how in set(made.values())
    ]
    rows += [["left out", why] for why in told.left_out]
    factors = told.summary["calibration"]
    if factors:
        rows.append(["calibration", f"rough strength times {factors['factor']:.3f}"])
    return page.table([], rows)


def _bands(campaign: Campaign, grid: str) -> str:
    """How a grid's answers depend on its cell, in words."""
    numerics, thickness = campaign.grids[grid], campaign.soil.softening_length
    said = f"cells of {numerics.cell:g} m, {'F-bar' if numerics.fbar else 'no F-bar'}"
    if not campaign.soil.softens:
        return said
    if numerics.internal_length is not None:
        said += f", plastic strain averaged over {numerics.internal_length:.3g} m"
    return f"{said}, softening " + ("per cell" if thickness is None else f"of a band {thickness:g} m thick")


def _unseen(found: dict[str, Any]) -> str:
    """How much of the interval is for what no run has looked at, in words; empty where it holds no such part."""
    if found["sampling_interval"] is None:
        return ""
    low, high = found["sampling_interval"]
    cov = (
        ""
        if found["coefficient_of_variation"] is None
        else f" (coefficient of variation {found['coefficient_of_variation']:.1%})"
    )
    return (
        f"Of sampling alone the interval is {low:.3g} to {high:.3g}{cov}; the rest allows for up to "
        f"{found['unseen']:.2g} of all samples failing far down the ranking, where no run has looked."
    )


def _more(found: dict[str, Any]) -> str:
    """What further refined runs would buy, in words; empty where nothing can be said."""
    more, now = found["after_more_runs"], found["coefficient_of_variation"]
    then = more["coefficient_of_variation"]
    left = found["samples"] - found["refined_runs"]
    if now is None or then is None:
        return ""
    said = f"Another {more['runs']} refined runs would bring the coefficient of variation from {now:.1%} to {then:.1%}"
    return f"{said}; {left} samples are left for them." if left < more["runs"] else f"{said}."


def _finished(found: dict[str, Any]) -> str:
    return f"The campaign has ended: {found['finished']}." if found["finished"] else "The campaign has not ended yet."


def _agreement(found: dict[str, Any]) -> str:
    """How well the grids agree, in words."""
    grids = found["grids"]
    if not grids:
        return ""
    low, high = grids["interval"]
    return (
        f"Rank correlation of both grids {grids['spearman']:.2f} ({low:.2f} to {high:.2f}), same class in "
        f"{grids['same_class']:.0%}, over {grids['samples']} samples."
    )


def _broken(found: dict[str, Any]) -> list[str]:
    return [
        f"sample {number} on the {grid} grid: {why}"
        for grid, broken in found["broke_off"].items()
        for number, why in broken.items()
    ]
