"""The page of a report, which needs no other file: from the answer down to how the campaign was run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path

from cooperative.estimate import ENOUGH, FITTED, NOT_ASKED, after_more_runs
from cooperative.folder import Results
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _sentences as sentences
from cooperative.reporting._interactive import Drawn
from cooperative.reporting._sentences import Cell, number
from cooperative.store import GRIDS, read_sample
from cooperative.summary import OtherEstimate, Risk, Summary
from jaxmpm.support.text import duration, short

STYLE, PAGE = (Path(__file__).with_name(f"_page.{kind}").read_text(encoding="utf-8") for kind in ("css", "html"))

INDISTINCT = 2.0
"""Difference in AIC below which two distributions are equally good."""

MORE_RUNS = (10, 25, 50, 100, 200, 500, 1000)
"""Further refined runs whose effect is in a table."""

HOW = (
    "Point at a curve, a map or a sample to read its values, draw a frame to see that part larger, double-click for "
    "all of it. Drag a body to turn it."
)
"""For browsers that run scripts."""


def page(results: Results, figures: Sequence[Drawn]) -> str:
    """The page: what a decision needs, then how it was computed."""
    return document(results.summary.name, filter(None, _parts(results, figures)))


def _parts(results: Results, figures: Sequence[Drawn]) -> Iterator[str]:
    summary, names = results.summary, {figure.name for figure in figures}
    points = interactive.any_interactive(figures)

    def shown(*names: str) -> str:
        return interactive.figures(figure for figure in figures if figure.name.startswith(names))

    yield heading(summary.name, 1)
    yield from answer(results)
    missing = without_slides(summary)
    if points:
        yield paragraph(HOW)
    if missing or {"exceedance", "hazard"} & names:
        yield heading("How far, how much, how deep")
        yield paragraph(missing)
        yield shown("exceedance", "hazard")
    if summary.consequences.risk:
        yield heading("Elements at risk")
        yield from risks(summary, summary.consequences.risk)
        yield shown("losses")
    yield heading("What the slides look like" if results.slid.any() else "What the slope looks like")
    yield from appearance(results)
    yield shown("slide", "plan", "body", "slope")
    yield heading("How sure, and why")
    yield estimates(summary)
    yield paragraph(" ".join(filter(None, (sentences.hidden(summary), finished(summary)))))
    yield shown("convergence", "ranked", "grids")
    yield heading("What more runs would bring")
    yield from further_runs(results)
    yield heading("How it was run")
    yield run_table(results)
    yield shown("field")
    if missing or any(summary.consequences.fits.values()):
        yield heading("Distributions of what the slides do")
        yield paragraph(missing)
    if not missing and any(summary.consequences.fits.values()):
        yield shown("severity")
        yield from best_fits(results)
        yield shown("fits")
    yield heading("Scene")
    scene = "\n".join(short(line, 400) for line in results.store.source.words.strip().splitlines())
    yield f"<pre>{escape(scene)}</pre>"
    if points:
        yield interactive.script()


def answer(results: Results) -> Iterator[str]:
    """The answer in a sentence, what it rests on, and what limits it."""
    summary = results.summary
    cost, pf = summary.cost, summary.probability
    yield headline(*sentences.verdict(pf.estimate))
    yield paragraph(
        f"{sentences.criterion(results)} {sentences.screened(summary)}, {cost.refined_runs} of these on the "
        f"refined one, where {pf.failures_refined} failed. {reach(results)}".strip()
    )
    for line in (sentences.condition(summary), *sentences.at_risk(summary)):
        yield paragraph(line)
    if not cost.finished:
        yield paragraph(
            f"The campaign has not ended. The results so far are from {cost.samples} of "
            f"{cost.planned_samples} samples on the rough grid and {cost.refined_runs} refined runs.",
            "note",
        )
    for note in [*summary.warnings, *summary.notes, *(f"broke off: {line}" for line in sentences.broken(summary))]:
        yield paragraph(note, "note")


def appearance(results: Results) -> Iterator[str]:
    """What the slides do on average, and which modes they have, for a page.

    Args:
        results: of a campaign.

    Yields:
        HTML.
    """
    summary = results.summary
    interval = f"{summary.probability.level:.0%} interval"
    missing, modes = without_slides(summary), sentences.occurring(summary)
    heads = ["of the slides", "unit", "mean", interval, "smallest", "largest"]
    yield paragraph(missing) if missing else table(heads, sentences.consequences(results))
    if len(modes) == 1:
        yield paragraph(f"All failures are {next(iter(modes))}.")
    elif modes:
        yield table(
            ["failure mode", "runs", "share of the failures", interval, "probability"],
            [
                [mode, share.count, share.ratio, sentences.limits(share.interval), share.probability]
                for mode, share in modes.items()
            ],
        )


def further_runs(results: Results) -> Iterator[str]:
    """What further refined runs would bring, and how long they would take."""
    summary = results.summary
    cost, pf = summary.cost, summary.probability
    remaining = cost.after_more_runs.samples_left
    if remaining == 0:
        which = "sample" if cost.coarse_samples is None else "rough sample"
        yield paragraph(f"Every {which} has run on the refined grid: only more {which}s would narrow the interval.")
        return
    if remaining is None or cost.after_more_runs.coefficient_of_variation is None:
        yield paragraph(sentences.more(summary) or "The runs so far do not show what more of them would bring.")
        return
    # Runs of a wave that is not complete do not count yet.
    waiting, samples = cost.refined_runs - pf.runs, cost.refined_runs + remaining
    seconds = cost.seconds["refined"] / max(cost.refined_runs, 1)
    counts = [*(count for count in MORE_RUNS if count < remaining), remaining]
    covs = [after_more_runs(pf.estimate, waiting + count, samples=samples) for count in counts]
    yield table(
        ["more refined runs", "coefficient of variation", "time on one machine, about"],
        [[count, float(cov), duration(count * seconds)] for count, cov in zip(counts, covs, strict=True)],
    )
    yield paragraph(
        "In the last row every sample is refined. The uncertainty that remains there comes from the number of samples, "
        "and only more samples reduce it."
    )


def estimates(summary: Summary) -> str:
    """Table of P_f by every estimator, with its interval."""
    pf = summary.probability
    estimate = OtherEstimate(pf.value, pf.interval)
    return table(
        ["estimator", "probability", f"{pf.level:.0%} interval", "coefficient of variation"],
        [
            [name, other.probability, " to ".join(map(number, other.interval)), cov]
            for name, other, cov in (
                (pf.estimator, estimate, pf.coefficient_of_variation),
                *((name, other, None) for name, other in pf.others.items()),
            )
        ],
    )


def risks(summary: Summary, risk: Risk) -> Iterator[str]:
    """How likely slides reach each element at risk, and what is lost, for a page.

    Args:
        summary: of a campaign.
        risk: of its elements at risk.

    Yields:
        HTML.
    """
    cut, elements = summary.consequences.cut_off, summary.consequences.elements_at_risk
    affected = {name: element for name, element in elements.items() if element is not None}
    if len(affected) < len(elements):
        why = without_slides(summary) or "No slide that has come to its end counts in the estimate so far."
        yield paragraph(f"How likely a slide reaches {', '.join(elements)} is not known. {why}", "note")
        return
    level = f"{summary.probability.level:.0%} interval" + (f" of what {cut.t_end:g} s show" if cut.at_t_end else "")
    heads = ["element", "probability of being reached", level, "arrival, s", "thickness, m", "speed, m/s"]
    heads += ["probability that its ground is carried away", "displacement of its ground, m"]
    yield table(
        [*heads, "expected loss", level],
        [[name, *sentences.element_row(element, cut.t_end)] for name, element in affected.items()],
    )
    yield paragraph(
        "Reached is an element when soil lies or moves above the surface that was there before. Arrival, thickness and "
        "speed are of that soil, means of the largest values over the slides that arrive, and losses follow from it. "
        f"Carried away is an element whose own ground moves by {summary.probability.failure_displacement:g} m or more."
    )
    whole = risk.loss
    if not whole:
        return
    modes = ", ".join(f"{share:.0%} of it comes from {mode} slides" for mode, share in whole.modes.items() if share)
    most = ", ".join(f"{sample.sample} ({sample.share:.0%})" for sample in whole.samples)
    yield paragraph(
        f"The expected loss per slope is {sentences.at_least(whole.expected, whole.at_least)} "
        f"({sentences.limits(whole.interval)})"
        + (f"; {modes}. " if modes else ". ")
        + (f"The samples with the largest shares are {most}." if most else "")
    )


def best_fits(results: Results) -> Iterator[str]:
    """The distribution that fits each consequence best, and groups with too few slides."""
    fits = sentences.distinct(results)
    if few := {
        group: fit.samples
        for group, by_measure in results.summary.consequences.fits.items()
        for fit in by_measure.values()
        if fit.samples < FITTED
    }:
        counts = ", ".join(f"{count} {group}" for group, count in few.items())
        yield paragraph(f"Too few slides for a fit ({counts}); it takes {FITTED}.", "note")
    few = {
        group: fit.samples for group, by_measure in fits.items() for fit in by_measure.values() if fit.samples < ENOUGH
    }
    if few:
        counts = ", ".join(f"{count} {group}" for group, count in few.items())
        yield paragraph(f"Too few failures to tell distributions apart ({counts}); {ENOUGH} are enough.", "note")
    if not fits:
        return
    yield table(
        ["failures", "consequence", "best by AIC", "best by BIC", "equally good by AIC"],
        [
            [group, name, fit.best_aic, fit.best_bic, ", ".join(close) or None]
            for group, by_measure in fits.items()
            for name, fit in by_measure.items()
            for close in [[other.name for other in fit.fits[1:] if other.aic - fit.fits[0].aic < INDISTINCT]]
        ],
    )


def run_table(results: Results) -> str:
    """Table of what ran on each grid, with its settings and versions."""
    cost, pf = results.summary.cost, results.summary.probability
    rows: list[list[Cell]] = []
    made: dict[str, str] = {}
    for grid, of in zip(GRIDS, (results.rough, results.refined), strict=True):
        statuses = ", ".join(_ended(results.summary, *ended) for ended in cost.status[grid].items())
        rows.append([f"{grid} grid", f"{statuses or 'none'}; {duration(cost.seconds[grid])} of runs"])
        rows.append([f"{grid} grid", results.ground.grids[grid].numerics])
        if of.numbers:
            last = read_sample(results.store, grid, of.numbers[-1])
            versions = ", ".join(f"{name} {version}" for name, version in last.versions.items())
            made[grid] = f"{last.dtype} on {last.device}; {versions}"
    rows += [
        [f"last sample, {' and '.join(g for g in made if made[g] == how)} grid", how]
        for how in dict.fromkeys(made.values())
    ]
    rows += [["left out", why] for why in results.left_out]
    if pf.calibration:
        rows.append(["calibration", f"rough strength times {pf.calibration.factor:.3f}"])
    return table([], rows)


def _ended(summary: Summary, status: str, count: int) -> str:
    """How many runs ended in which way."""
    if status != "FINISHED":
        return f"{count} {status}"
    return f"{count} FINISHED (at its end time{', not settled' if summary.cost.settle else ''})"


def without_slides(summary: Summary) -> str:
    """Why nothing is known of what slides do; empty where some have come to their end."""
    if summary.consequences.means.get("depth"):
        return ""
    if not summary.probability.failures_refined:
        return "No refined run has failed, so there is no slide."
    if not summary.consequences.planned:
        return f"No consequence was asked for: {NOT_ASKED}, and refined runs end once they have failed."
    return "No slide has come to its end yet."


def finished(summary: Summary) -> str:
    """Whether the campaign has ended, and why."""
    why = summary.cost.finished
    return f"The campaign has ended: {why}." if why else "The campaign has not ended yet."


def reach(results: Results) -> str:
    """Run-out of one slope in ten, a hundred or a thousand, the rarest that the runs show; else empty."""
    curve, estimate = results.summary.consequences.exceedance.get("runout"), results.summary.probability.estimate
    many = next((many for many in (10, 100, 1000) if estimate.probability > 1.2 / many), None)
    if not curve or many is None:
        return ""
    reached = [at for at, chance in zip(curve.thresholds, curve.probability, strict=True) if chance >= 1 / many]
    unit = sentences.units(results)["runout"]
    return f"One slope in {many} slides to {reached[-1]:.3g} {unit}, or farther." if reached else ""


def document(title: str, parts: Iterable[str]) -> str:
    """The page.

    Args:
        title: of the window.
        parts: HTML made by the other functions of this module.
    """
    return PAGE.format(title=escape(title), style=STYLE, body="\n".join(parts))


def heading(text: str, level: int = 2) -> str:
    """A heading.

    Args:
        text: of the heading.
        level: 1 is the page's own.
    """
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str | None = None) -> str:
    """A paragraph, nothing for empty text.

    Args:
        text: of the paragraph.
        kind: a class of the style sheet, "note" for warnings.
    """
    return f"<p{_class(kind)}>{escape(text)}</p>" if text else ""


def headline(before: str, strong: str, after: str) -> str:
    """A sentence with its number large.

    Args:
        before: words before the number.
        strong: the number.
        after: words after it.
    """
    return f'<p class="answer">{escape(before)} <strong>{escape(strong)}</strong> {escape(after)}</p>'


def table(head: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A table.

    Args:
        head: names of the columns; none for a table without a head.
        rows: cells of each row.
    """
    rows, names = list(rows), [escape(name) for name in head]
    heads: list[str | None] = [*names] or [None] * max(map(len, rows), default=0)
    lines = "".join(f"<tr>{''.join(map(_cell, row, heads))}</tr>\n" for row in rows)
    # The head of a column of numbers stands on the right too.
    numeric = [bool(rows) and not any(isinstance(row[at], str) for row in rows) for at in range(len(names))]
    shown = "".join(
        f'<th scope="col"{_class("number" if right else None)}>{name}</th>'
        for name, right in zip(names, numeric, strict=True)
    )
    top = f"<thead><tr>{shown}</tr></thead>\n" if shown else ""
    return f"<table{_class('rows' if shown else None)}>\n{top}<tbody>\n{lines}</tbody>\n</table>"


def _cell(value: Cell, head: str | None) -> str:
    name = "" if head is None else f' data-head="{head}"'
    if isinstance(value, str):
        return f"<td{name}>{escape(value)}</td>"
    text = "–" if value is None else number(value) if isinstance(value, float) else f"{value}"
    return f'<td class="number"{name}>{text}</td>'


def _class(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""
