"""Sections of a report's page, from the answer down to how the campaign was run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cooperative.estimate import ENOUGH, after_more_runs
from cooperative.folder import Results
from cooperative.reporting import _interactive as plotly
from cooperative.reporting import _sentences as sentences
from cooperative.reporting._html import (
    Cell,
    document,
    figures,
    heading,
    headline,
    paragraph,
    preformatted,
    table,
)
from cooperative.reporting._plots import Drawn
from cooperative.risk import Element, Risk
from cooperative.store import GRIDS, read_sample
from cooperative.summary import OtherEstimate, Summary
from foundation.text import duration, short

INDISTINCT = 2.0
"""Difference in AIC below which two distributions are equally good."""

MORE_RUNS = (10, 25, 50, 100, 200, 500, 1000)
"""Further refined runs whose effect is in a table."""

HOW = (
    "Point at a curve, a map or a sample to read its values, draw a frame to see that part larger, double-click for "
    "all of it. Drag a body to turn it."
)
"""For browsers that run scripts."""


def page(results: Results, drawn: Sequence[Drawn]) -> str:
    """The page: what a decision needs, then how it was computed."""
    return document(results.summary.name, filter(None, _parts(results, drawn)))


def _parts(results: Results, drawn: Sequence[Drawn]) -> Iterator[str]:
    summary, names = results.summary, {each.name for each in drawn}
    interactive = plotly.installed() and any(each.interactive for each in drawn)

    def shown(*names: str) -> str:
        return figures(each for each in drawn if each.name.startswith(names))

    if interactive:
        yield plotly.script()
    yield heading(summary.name, 1)
    yield from answer(results)
    missing = sentences.without_slides(summary)
    if interactive:
        yield paragraph(HOW)
    if missing or {"exceedance", "hazard"} & names:
        yield heading("How far, how much, how deep")
        yield paragraph(missing)
        yield shown("exceedance", "hazard")
    if summary.risk:
        yield heading("Elements at risk")
        yield from risks(summary, summary.risk)
        yield shown("losses")
    yield heading("What the slides look like" if results.slid.any() else "What the slope looks like")
    yield from look(results)
    yield shown("slide", "plan", "body", "slope")
    yield heading("How sure, and why")
    yield estimates(summary)
    yield paragraph(" ".join(filter(None, (sentences.unseen(summary), sentences.finished(summary)))))
    yield shown("convergence", "ranked", "grids")
    yield heading("What more runs would bring")
    yield from further_runs(results)
    yield heading("How it was run")
    yield run_table(results)
    yield shown("field")
    if missing or {"severity", "fits-all"} & names:
        yield heading("Distributions of what the slides do")
        yield paragraph(missing)
    if not missing and {"severity", "fits-all"} & names:
        yield shown("severity")
        yield from best_fits(results)
        yield shown("fits")
    yield heading("Scene")
    yield preformatted("\n".join(short(line, 400) for line in results.store.source.words.strip().splitlines()))


def answer(results: Results) -> Iterator[str]:
    """The answer in a sentence, what it rests on, and what limits it."""
    summary = results.summary
    chance, (low, high) = summary.probability_of_failure, summary.interval
    yield headline(
        "The slope fails with probability" if chance else "No run has failed: the slope fails with probability",
        f"{chance:.3g}",
        f"({summary.level:.0%} interval {low:.3g} to {high:.3g}){sentences.in_slopes(chance)}.",
    )
    yield paragraph(
        f"It fails when {sentences.failing_soil(results)} moves farther than {summary.failure_displacement:g} m. "
        f"{summary.samples} random slopes ran on the rough grid, {summary.refined_runs} of them on the refined one, "
        f"where {summary.failures_refined} failed. {sentences.reach(results)}".strip()
    )
    if not summary.finished:
        yield paragraph(
            f"The campaign has not ended. The results so far are from {summary.samples} of "
            f"{summary.planned_samples} samples on the rough grid and {summary.refined_runs} refined runs.",
            "note",
        )
    for note in [*summary.notes, *(f"broke off: {line}" for line in sentences.broken(summary))]:
        yield paragraph(note, "note")


def look(results: Results) -> Iterator[str]:
    """What the slides do on average, and which modes they have."""
    summary = results.summary
    interval = f"{summary.level:.0%} interval"
    missing, modes = sentences.without_slides(summary), sentences.occurring(summary)
    yield (
        paragraph(missing)
        if missing
        else table(
            ["of the slides", "unit", "mean", interval, "smallest", "largest"],
            [
                [
                    name,
                    sentences.units(results)[name],
                    _or_least(spread.mean, spread.at_least),
                    sentences.interval(spread),
                    spread.smallest,
                    _or_least(spread.largest, spread.at_least),
                ]
                for name, spread in summary.consequences_of_failures.items()
                if spread and name in sentences.labels(results)
            ],
        )
    )
    if len(modes) == 1:
        yield paragraph(f"All failures are {next(iter(modes))}.")
    elif modes:
        yield table(
            ["failure mode", "runs", "share of the failures", interval, "probability"],
            [
                [mode, each.count, each.ratio, sentences.limits(each.interval), each.probability]
                for mode, each in modes.items()
            ],
        )


def further_runs(results: Results) -> Iterator[str]:
    """What further refined runs would bring, and how long they would take."""
    summary, estimate = results.summary, results.summary.estimate
    left = summary.after_more_runs.samples_left
    if left == 0:
        yield paragraph("Every sample has run on the refined grid: only more samples would narrow the interval.")
        return
    if left is None or summary.after_more_runs.coefficient_of_variation is None:
        yield paragraph("The runs so far do not show what more of them would bring.")
        return
    each = summary.seconds["refined"] / max(summary.refined_runs, 1)
    counts = [*(count for count in MORE_RUNS if count < left), left]
    covs = [after_more_runs(estimate, count, samples=estimate.refined_runs + left) for count in counts]
    yield table(
        ["more refined runs", "coefficient of variation", "time on one machine, about"],
        [[count, float(cov), duration(count * each)] for count, cov in zip(counts, covs, strict=True)],
    )
    yield paragraph(
        "In the last row every sample is refined. The uncertainty that remains there comes from the number of samples, "
        "and only more samples reduce it."
    )


def estimates(summary: Summary) -> str:
    """Table of P_f by every estimator, with its interval."""
    own = OtherEstimate(summary.probability_of_failure, summary.interval)
    return table(
        ["estimator", "probability", f"{summary.level:.0%} interval", "coefficient of variation"],
        [
            [name, each.probability, "{:.3g} to {:.3g}".format(*each.interval), cov]
            for name, each, cov in (
                (summary.estimator, own, summary.coefficient_of_variation),
                *((name, other, None) for name, other in summary.other_estimates.items()),
            )
        ],
    )


def risks(summary: Summary, risk: Risk) -> Iterator[str]:
    """How likely slides reach each element at risk, and what is lost."""
    cut, known = summary.cut_off, {name: element for name, element in risk.places.items() if element is not None}
    if len(known) < len(risk.places):
        why = sentences.without_slides(summary) or "No slide that has come to its end counts in the estimate so far."
        yield paragraph(f"How likely a slide reaches {', '.join(risk.places)} is not known. {why}", "note")
        return
    level = f"{summary.level:.0%} interval" + (f" of what {cut.t_end:g} s show" if cut.at_t_end else "")
    heads = ["element", "probability of being reached", level, "arrival, s", "thickness, m", "speed, m/s"]
    yield table([*heads, "expected loss", level], [[name, *_element(each, cut.t_end)] for name, each in known.items()])
    yield paragraph("Arrival, thickness and speed are means of the largest values over the slides that arrive.")
    whole = risk.loss
    if not whole:
        return
    modes = ", ".join(f"{share:.0%} of it comes from {mode} slides" for mode, share in whole.modes.items() if share)
    most = ", ".join(f"{each.sample} ({each.share:.0%})" for each in whole.samples)
    yield paragraph(
        f"The expected loss per slope is {sentences.at_least(whole.expected, whole.at_least)} "
        f"({sentences.limits(whole.interval)})"
        + (f"; {modes}. " if modes else ". ")
        + (f"The samples with the largest shares are {most}." if most else "")
    )


def _element(element: Element, t_end: float) -> list[Cell]:
    """Row of an element at risk."""
    reached, arrival, loss = element.reached, element.arrival, element.loss
    when = f"not within {t_end:g} s"
    if arrival:
        when = f"{sentences.at_least(arrival.mean, arrival.at_least)} ({sentences.interval(arrival)})"
    return [
        _or_least(reached.probability, reached.at_least),
        sentences.limits(reached.interval),
        when,
        *(_or_least(each.mean, each.at_least) if each else None for each in (element.thickness, element.speed)),
        _or_least(loss.expected, loss.at_least) if loss else None,
        sentences.limits(loss.interval) if loss else None,
    ]


def best_fits(results: Results) -> Iterator[str]:
    """The distribution that fits each consequence best, and groups with too few slides."""
    fits = sentences.distinct(results)
    few = {group: fit.samples for group, each in fits.items() for fit in each.values() if fit.samples < ENOUGH}
    if few:
        counts = ", ".join(f"{count} {group}" for group, count in few.items())
        yield paragraph(f"Too few failures to tell distributions apart ({counts}); {ENOUGH} are enough.", "note")
    yield table(
        ["failures", "consequence", "best by AIC", "best by BIC", "equally good by AIC"],
        [
            [group, name, fit.best_aic, fit.best_bic, ", ".join(close) or None]
            for group, each in fits.items()
            for name, fit in each.items()
            for close in [[other.name for other in fit.fits[1:] if other.aic - fit.fits[0].aic < INDISTINCT]]
        ],
    )


def run_table(results: Results) -> str:
    """Table of what ran on each grid, with its settings and versions."""
    rows: list[list[Cell]] = []
    made: dict[str, str] = {}
    for grid, of in zip(GRIDS, (results.rough, results.refined), strict=True):
        statuses = ", ".join(_ended(results.summary, *each) for each in results.summary.status[grid].items())
        rows.append([f"{grid} grid", f"{statuses or 'none'}; {duration(results.summary.seconds[grid])} of runs"])
        rows.append([f"{grid} grid", results.ground.grids[grid].numerics])
        for number in of.numbers[-1:]:
            last = read_sample(results.store, grid, number)
            versions = ", ".join(f"{name} {version}" for name, version in last.versions.items())
            made[grid] = f"{last.dtype} on {last.device}; {versions}"
    rows += [
        [f"last sample, {' and '.join(g for g in made if made[g] == how)} grid", how] for how in set(made.values())
    ]
    rows += [["left out", why] for why in results.left_out]
    if results.summary.calibration:
        rows.append(["calibration", f"rough strength times {results.summary.calibration.factor:.3f}"])
    return table([], rows)


def _ended(summary: Summary, status: str, count: int) -> str:
    """How many runs ended in which way."""
    if status != "FINISHED":
        return f"{count} {status}"
    return f"{count} FINISHED (at its end time{', not settled' if summary.settle else ''})"


def _or_least(value: float, is_least: bool) -> str | float:
    """A number of a table, in words where slides would have gone on."""
    return sentences.at_least(value, is_least) if is_least else value
