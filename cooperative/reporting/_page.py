"""What a report says: the summary for the terminal, and one HTML page that needs nothing else, with text, tables and
figures within it, fit for the screen and for paper."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import matplotlib

from cooperative.effects import ModeShare, Risk, Spread
from cooperative.estimate import ENOUGH, NOT_ASKED, Fits, after_more_runs
from cooperative.folder import Results
from cooperative.reporting._plots import Drawn
from cooperative.store import GRIDS, read_sample
from cooperative.summary import OtherEstimate, Summary
from foundation.text import duration, printable

STYLE = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")

WIDE = 7.5
"""Width of a figure (inch) from which on it stands alone."""

DPI = 120
"""Of what is drawn as pixels within a figure: particles and maps."""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""A browser fetches nothing for the page."""

INDISTINCT = 2.0
"""Difference in AIC below which two distributions are as good as each other."""

MORE_RUNS = (10, 25, 50, 100, 200, 500, 1000)
"""Further refined runs of which the page tells what they would buy."""


def document(title: str, parts: Iterable[str]) -> str:
    """The page. parts: HTML made by the other functions of this module."""
    body = "\n".join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n'
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def heading(text: str, level: int = 2) -> str:
    """A heading; level 1 is the page's own."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str | None = None) -> str:
    """A paragraph; kind: a class of the style sheet, "note" for what a reader must beware of."""
    return f"<p{_kind(kind)}>{escape(text)}</p>"


def headline(before: str, strong: str, after: str) -> str:
    """The page's one answer, a sentence with its number large."""
    return f'<p class="answer">{escape(before)} <strong>{escape(strong)}</strong> {escape(after)}</p>'


def preformatted(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{escape(text)}</pre>"


def number(value: float) -> str:
    """Four figures of a number, as people write them: 0.1234, 42,560."""
    return f"{float(f'{value:.4g}'):,.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"


def table(head: Sequence[str], rows: Iterable[Sequence[str | float | int | None]]) -> str:
    """A table, without a head where `head` is empty. Numbers are set to the right, None is a dash."""
    names = [escape(name) for name in head]
    given = [list(row) for row in rows]
    lines = "".join(
        f"<tr>{''.join(_cell(value, names[at] if names else None) for at, value in enumerate(row))}</tr>\n"
        for row in given
    )
    # The head of a column of numbers stands above them.
    numbers = [bool(given) and all(not isinstance(row[at], str) for row in given) for at in range(len(names))]
    heads = "".join(
        f'<th scope="col"{_kind("number" if right else None)}>{name}</th>'
        for name, right in zip(names, numbers, strict=True)
    )
    top = f"<thead><tr>{heads}</tr></thead>\n" if heads else ""
    return f"<table{_kind('rows' if heads else None)}>\n{top}<tbody>\n{lines}</tbody>\n</table>"


def figure(drawn: Drawn, live: str | None = None) -> str:
    """A figure within the page, as matplotlib draws it.

    live: what stands for it where the browser runs scripts.
    """
    still = _inlined(drawn)
    shown = still if live is None else f"{live}\n<noscript>{still}</noscript>"
    wide = " wide" if drawn.figure.get_figwidth() > WIDE else ""
    return (
        f'<figure class="drawn{wide}" aria-labelledby="of-{drawn.name}">\n{shown}\n'
        f'<figcaption id="of-{drawn.name}">{escape(drawn.caption)}</figcaption>\n</figure>'
    )


def figures(drawn: Iterable[str]) -> str:
    """Figures, narrow ones beside each other where there is room."""
    return '<div class="figures">\n' + "\n".join(drawn) + "\n</div>"


def _inlined(drawn: Drawn) -> str:
    """A figure as an SVG element, whose ids no other element of the page has."""
    kept = io.BytesIO()
    how: Any = {"svg.fonttype": "none", "svg.hashsalt": drawn.name}
    with matplotlib.rc_context(how):
        drawn.figure.savefig(kept, format="svg", dpi=DPI, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    drawing = kept.getvalue().decode()
    # Its style sheet, which on a page would be that of all other elements, is in the page's own.
    drawing = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", drawing[drawing.find("<svg") :], flags=re.S)
    drawing = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{drawn.name}-", drawing)
    return drawing.replace("<svg ", f'<svg role="img" aria-labelledby="of-{drawn.name}" ', 1)


def _cell(value: str | float | int | None, head: str | None) -> str:
    named = "" if head is None else f' data-head="{head}"'
    if isinstance(value, str):
        return f"<td{named}>{escape(value)}</td>"
    said = "–" if value is None else number(value) if isinstance(value, float) else f"{value}"
    return f'<td class="number"{named}>{said}</td>'


def _kind(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""


def words(results: Results) -> str:
    """The summary for people."""
    found = results.summary
    low, high = found.interval
    lines = [
        f"{found.name}",
        f"  probability of failure  {found.probability_of_failure:.3f}  "
        f"({found.level:.0%} interval {low:.3f} to {high:.3f}; {found.estimator})",
    ]
    lines += [f"  {line}" for line in (unseen(found),) if line]
    for method, other in found.other_estimates.items():
        low, high = other.interval
        lines.append(f"  beside it: {method:<14} {other.probability:.3f}  ({low:.3f} to {high:.3f})")
    lines += [
        f"  rough grid     {found.samples} samples, {found.failures_rough} beyond the failure displacement, "
        f"{found.seconds['rough']:.0f} s",
        f"  refined grid   {found.refined_runs} runs, {found.failures_refined} failures, "
        f"{found.seconds['refined']:.0f} s",
    ]
    lines += [f"  {line}" for line in (_more(found), agreement(found)) if line]
    for mode, share in occurring(found).items():
        low, high = share.interval
        lines.append(f"  {mode:<13}  {share.ratio:.0%} of the failures ({low:.0%} to {high:.0%})")
    for name, spread in found.consequences_of_failures.items():
        if spread and name in labels(results):
            mean, largest = (_least(value, spread.at_least) for value in (spread.mean, spread.largest))
            limits = f"{number(spread.smallest)} to {largest}"
            lines.append(f"  {name:<13}  mean {mean} ({_interval(spread)}), {limits} ({units(results)[name]})")
    lines += [f"  BROKE OFF      {line}" for line in _broken(found)]
    lines += [f"  LEFT OUT       {line}" for line in results.left_out]
    lines += [f"  note: {note}" for note in found.notes]
    lines.append(f"  all of it, with figures: {results.store.folder / 'report.html'}")
    return "\n".join(map(printable, lines))


def _least(value: float, at_least: bool) -> str:
    """A number of what slides do in words, "at least" that where they would have gone on."""
    return ("at least " if at_least else "") + number(value)


def _or_least(value: float, at_least: bool) -> str | float:
    """The same for a table, which sets plain numbers to the right."""
    return _least(value, at_least) if at_least else value


def cut_off(found: Summary) -> str:
    """A sentence for figures of what slides do, empty where all came to rest."""
    cut = found.cut_off
    if not cut.at_t_end:
        return ""
    return f" It is at least that: {cut.at_t_end} of {cut.of} slides had not come to rest at {cut.t_end:g} s."


def _interval(spread: Spread) -> str:
    """Of a mean, in words."""
    alike = spread.interval is not None and spread.smallest == spread.largest
    return "all alike" if alike else _limits(spread.interval)


def distinct(results: Results) -> dict[str, dict[str, Fits]]:
    """Fits of all failures and of each mode, but not of a mode that all failures have."""
    fits = results.summary.fits
    modes = [fit for group, fit in fits.items() if group != "all"]
    kept = {"all": fits["all"]} if modes == [fits.get("all")] else fits
    # What is the same in all slides has no distribution.
    return {
        group: {name: fit for name, fit in each.items() if name in labels(results) and fit.fits}
        for group, each in kept.items()
    }


def occurring(found: Summary) -> dict[str, ModeShare]:
    """Modes that some refined run failed in."""
    return {mode: share for mode, share in (found.modes or {}).items() if share.count}


def labels(results: Results) -> dict[str, str]:
    """Axis label of each consequence, with its unit. In a section the influence area is the run-out, and is left
    out."""
    solid = results.ground.dimension == 3
    return {
        "displacement": "largest displacement $R_d$ [m]",
        "depth": "sliding depth $H$ [m]",
        "runout": "run-out $L$ [m]",
        "volume": f"sliding volume $V$ [{'m³' if solid else 'm³/m'}]",
    } | ({"area": "influence area $S$ [m²]"} if solid else {})


def units(results: Results) -> dict[str, str]:
    """Unit of each consequence in words."""
    each = "" if results.ground.dimension == 3 else " per metre of width"
    toe = results.ground.face is not None
    line = ", along the line that the scene draws" if results.ground.line else ""
    return {
        "displacement": "m",
        "depth": "m below the crest" if toe else "m below the surface",
        "runout": "m beyond the toe" if toe else f"m from its rear to its front{line}",
        "volume": f"m³{each}",
        "area": "m² beyond the toe" if toe else "m² at its end",
    }


def _soil(results: Results) -> str:
    volume, unit = results.summary.least_volume, "m3" if results.ground.dimension == 3 else "m2"
    return "soil" if volume is None else f"at least {volume:g} {unit} of soil"


def answer(results: Results) -> Iterator[str]:
    """The answer in a sentence, what it rests on, and what a reader must beware of."""
    found = results.summary
    chance, (low, high) = found.probability_of_failure, found.interval
    yield headline(
        "The slope fails with probability" if chance else "No run has failed: the slope fails with probability",
        f"{chance:.3g}",
        f"({found.level:.0%} interval {low:.3g} to {high:.3g}){in_slopes(chance)}.",
    )
    yield paragraph(
        f"It fails when {_soil(results)} moves farther than {found.failure_displacement:g} m. "
        f"{found.samples} random slopes ran on the rough grid, {found.refined_runs} of them on the refined one, "
        f"where {found.failures_refined} failed. {_reach(results)}".strip()
    )
    if not found.finished:
        yield paragraph(
            f"The campaign has not ended: this is what is known so far, from {found.samples} of "
            f"{found.planned_samples} samples on the rough grid and {found.refined_runs} refined runs.",
            "note",
        )
    for note in [*found.notes, *(f"broke off: {line}" for line in _broken(found))]:
        yield paragraph(note, "note")


def in_slopes(chance: float) -> str:
    """A probability as a count of slopes; empty where there is nothing to count."""
    if not 0 < chance < 1:
        return ""
    return (
        f": {chance * 100:.0f} in 100 such slopes"
        if chance > 0.095
        else f": one in {float(f'{1 / chance:.2g}'):.0f} such slopes"
    )


def _reach(results: Results) -> str:
    """How far one slope in ten, a hundred or a thousand goes, the rarest of which the runs tell; else empty."""
    curve, found = results.summary.exceedance.get("runout"), results.summary.estimate
    if not curve:
        return ""
    for many in (10, 100, 1000):
        if found.probability > 1.2 / many:
            reached = [at for at, chance in zip(curve.thresholds, curve.probability, strict=True)
                       if chance >= 1 / many]  # fmt: skip
            return (
                f"One slope in {many} slides to {reached[-1]:.3g} {units(results)['runout']} or farther."
                if reached
                else ""
            )
    return ""


def without_slides(found: Summary) -> str:
    """Why nothing is known of what slides do, in words; empty where some have come to their end."""
    if found.consequences_of_failures.get("depth"):
        return ""
    if not found.failures_refined:
        return "No refined run has failed, so there is no slide."
    if not found.slides_drawn:
        return f"No consequence was asked for: {NOT_ASKED}, and refined runs end once they have failed."
    return "No slide has come to its end yet."


def look(results: Results) -> Iterator[str]:
    """What the slides do on average, and which modes they have."""
    missing = without_slides(results.summary)
    yield paragraph(missing) if missing else _consequences(results)
    modes = occurring(results.summary)
    if len(modes) == 1:
        yield paragraph(f"All failures are {next(iter(modes))}.")
    elif modes:
        yield table(
            ["failure mode", "runs", "share of the failures", f"{results.summary.level:.0%} interval", "probability"],
            [[mode, each.count, each.ratio, _limits(each.interval), each.probability] for mode, each in modes.items()],
        )


def bought(results: Results) -> Iterator[str]:
    """What further refined runs would buy, and how long they would take."""
    found, estimate = results.summary, results.summary.estimate
    left = found.after_more_runs.samples_left
    if left == 0:
        yield paragraph("Every sample has run on the refined grid: only more samples would narrow the interval.")
        return
    if left is None or found.after_more_runs.coefficient_of_variation is None:
        yield paragraph("The runs do not tell what more of them would buy.")
        return
    each = found.seconds["refined"] / max(found.refined_runs, 1)
    counts = [*(count for count in MORE_RUNS if count < left), left]
    bought = {count: after_more_runs(estimate, count, samples=estimate.refined_runs + left) for count in counts}
    yield table(
        ["more refined runs", "coefficient of variation", "time of one machine, about"],
        [[count, float(cov), duration(count * each)] for count, cov in bought.items()],
    )
    yield paragraph(
        "The last row runs every sample: what doubt is left then is that of the number of samples, and only more of "
        "them would lessen it."
    )


def estimates(found: Summary) -> str:
    """Table of P_f by every estimator, with its interval."""
    own = OtherEstimate(found.probability_of_failure, found.interval)
    methods = {found.estimator: own, **found.other_estimates}
    cov = found.coefficient_of_variation
    return table(
        ["estimator", "probability", f"{found.level:.0%} interval", "coefficient of variation"],
        [
            [
                name,
                each.probability,
                "{:.3g} to {:.3g}".format(*each.interval),
                cov if name == found.estimator else None,
            ]
            for name, each in methods.items()
        ],
    )


def _consequences(results: Results) -> str:
    rows = [
        [
            name,
            units(results)[name],
            _or_least(spread.mean, spread.at_least),
            _interval(spread),
            spread.smallest,
            _or_least(spread.largest, spread.at_least),
        ]
        for name, spread in results.summary.consequences_of_failures.items()
        if spread and name in labels(results)
    ]
    columns = ["of the slides", "unit", "mean", f"{results.summary.level:.0%} interval", "smallest", "largest"]
    return table(columns, rows)


def risks(found: Summary, risk: Risk) -> Iterator[str]:
    """What comes over the exposed places and what is lost."""
    cut = found.cut_off
    rows: list[list[str | float | int | None]] = []
    known = {name: element for name, element in risk.places.items() if element is not None}
    if len(known) < len(risk.places):
        why = without_slides(found) or "No slide that has come to its end counts in the estimate so far."
        yield paragraph(f"Nothing is known of how likely a slide reaches {', '.join(risk.places)}. {why}", "note")
        return
    for name, element in known.items():
        reached, arrival, loss = element.reached, element.arrival, element.loss
        rows.append(
            [
                name,
                _or_least(reached.probability, reached.at_least),
                _limits(reached.interval),
                f"{_least(arrival.mean, arrival.at_least)} ({_interval(arrival)})"
                if arrival
                else f"not within {cut.t_end:g} s",
                *(_or_least(each.mean, each.at_least) if each else None for each in (element.thickness, element.speed)),
                _or_least(loss.expected, loss.at_least) if loss else None,
                _limits(loss.interval) if loss else None,
            ]
        )
    level = f"{found.level:.0%} interval" + (f" of what {cut.t_end:g} s show" if cut.at_t_end else "")
    heads = ["place", "probability of being reached", level, "arrival, s", "thickness, m", "speed, m/s"]
    yield table([*heads, "expected loss", level], rows)
    yield paragraph(
        "Arrival, thickness and speed are means over the slides that come, of the largest values at the place."
    )
    whole = risk.loss
    if not whole:
        return
    modes = ", ".join(f"{mode} slides make {share:.0%} of it" for mode, share in whole.modes.items() if share)
    most = ", ".join(f"{each.sample} ({each.share:.0%})" for each in whole.samples)
    yield paragraph(
        f"Expected loss per slope {_least(whole.expected, whole.at_least)} ({_limits(whole.interval)})"
        + (f"; {modes}" if modes else "")
        + (f"; most of it the samples {most}." if most else ".")
    )


def _limits(interval: Sequence[float] | None) -> str:
    if interval is None:
        return "too few for an interval"
    low, high = map(number, interval)
    return f"{low} to {high}" if interval[0] else f"at most {high}"


def best_fits(results: Results) -> Iterator[str]:
    """The distribution that fits each consequence best, and what had too few slides for one."""
    rows: list[list[str | float | int | None]] = []
    few: dict[str, int] = {}
    for group, fits in distinct(results).items():
        for name, fit in fits.items():
            best, *others = fit.fits
            close = [other.name for other in others if other.aic - best.aic < INDISTINCT]
            rows.append([group, name, fit.best_aic, fit.best_bic, ", ".join(close) or None])
            few |= {group: fit.samples} if fit.samples < ENOUGH else {}
    if few:
        said = ", ".join(f"{count} {group}" for group, count in few.items())
        yield paragraph(f"Too few failures to tell distributions apart ({said}): {ENOUGH} or more would do.", "note")
    yield table(["failures", "consequence", "best by AIC", "best by BIC", "hardly worse by AIC"], rows)


def run_table(results: Results) -> str:
    """Table of what ran on each grid, and with which settings and versions."""
    rows: list[list[str | float | int | None]] = []
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
    factors = results.summary.calibration
    if factors:
        rows.append(["calibration", f"rough strength times {factors.factor:.3f}"])
    return table([], rows)


def _ended(summary: Summary, status: str, count: int) -> str:
    """How many runs ended in which way."""
    if status != "FINISHED":
        return f"{count} {status}"
    return f"{count} FINISHED (at its end time{', not settled' if summary.settle else ''})"


def unseen(found: Summary) -> str:
    """How much of the interval is for what no run has looked at, in words; empty where it holds no such part."""
    if found.sampling_interval is None or not found.unseen:
        return ""
    low, high = found.sampling_interval
    cov = (
        ""
        if found.coefficient_of_variation is None
        else f" (coefficient of variation {found.coefficient_of_variation:.1%})"
    )
    return (
        f"Of sampling alone the interval is {low:.3g} to {high:.3g}{cov}; the rest allows for up to "
        f"{found.unseen:.2g} of all samples failing far down the ranking, where no run has looked."
    )


def _more(found: Summary) -> str:
    """What further refined runs would buy, in words; empty where nothing can be said."""
    more, now = found.after_more_runs, found.coefficient_of_variation
    runs, left, then = more.runs, more.samples_left, more.coefficient_of_variation
    if now is None or then is None or (left and not runs):
        return ""
    if not left:
        return f"All samples have run refined: only more would bring the coefficient of variation below {now:.1%}."
    if runs == left:
        return f"{_bring(runs, now, then)}, and then all have run refined: beyond that only more samples help."
    return f"{_bring(runs, now, then)}, and all {left} samples that are left to {more.all_samples:.1%}."


def _bring(runs: int, now: float, then: float) -> str:
    return f"Another {runs} refined runs would bring the coefficient of variation from {now:.1%} to {then:.1%}"


def finished(found: Summary) -> str:
    """Whether the campaign has ended, and why."""
    return f"The campaign has ended: {found.finished}." if found.finished else "The campaign has not ended yet."


def agreement(found: Summary) -> str:
    """How well the grids agree, in words."""
    grids = found.grids
    if not grids:
        return ""
    low, high = grids.interval
    return (
        f"Rank correlation of both grids {grids.spearman:.2f} ({low:.2f} to {high:.2f}), same class in "
        f"{grids.same_class:.1%}, over {grids.samples} samples."
        + (" Failures that did not slide on rank alike." if found.status["refined"].get("DECIDED") else "")
    )


def _broken(found: Summary) -> list[str]:
    return [
        f"sample {number} on the {grid} grid: {why}"
        for grid, broken in found.broke_off.items()
        for number, why in broken.items()
    ]
