"""The probability of failure against time, and what fails then, as figures, tables and a page."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cooperative.estimate import annual
from cooperative.folder import Results, read_results
from cooperative.measure import MEASURES, SEVERITY
from cooperative.names import DRAWN_SLIDES
from cooperative.reporting import (
    HOW,
    Cell,
    Drawn,
    any_interactive,
    appearance,
    document,
    draw_slides,
    figures,
    heading,
    headline,
    limits,
    panels,
    paragraph,
    risks,
    save,
    script,
    table,
    units_of_campaign,
)
from cooperative.store import FAILED_AT, SLIDES_IN_TIME
from cooperative.tools.in_time._answer import InTime, first_lines
from cooperative.tools.in_time._slides import SlidesInTime
from cooperative.tools.seepage import clock, csv_text, draw_load, in_hours, write_texts
from jaxmpm.support.text import literal

COLOURS = dict(zip((*SEVERITY, "none"), ("#D55E00", "#CC79A7", "#0072B2", "#009E73", "#777777"), strict=True))


def write_in_time(
    result: InTime,
    folder: Path,
    slides: SlidesInTime | None = None,
    *,
    drawn: int = DRAWN_SLIDES,
    again: bool = False,
) -> list[Path]:
    """Write what a scene's samples do in time.

    `probability.png` and `.csv`, `failures.png` and `.csv` with how many fail first at each time, `first_failures.csv`
    with when each sample does, `slides.csv` with each slide, `report.html` and `probability.json`; in `slides/figures`
    what slides reach and how they look.

    Args:
        result: of `probability_in_time`.
        folder: that it kept its answers in, to write to.
        slides: of `slides_in_time`, None without.
        drawn: slides drawn at several times.
        again: whether to run these again and draw more moments.

    Returns:
        Paths of the files.

    Raises:
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = _drawn(result, slides)
    slid = read_results(folder / SLIDES_IN_TIME) if slides is not None and slides.at.size else None
    of_slides = [] if slid is None else draw_slides(slid, slides=drawn, again=again)
    paths = [folder / f"{picture.name}.png" for picture in pictures]
    for picture, path in zip(pictures, paths, strict=True):
        save(picture.figure, path)
    texts = {
        "probability.csv": _table(result), "failures.csv": _failures(result, slides),
        "first_failures.csv": _samples(result), "probability.json": _json(result, slides),
    }  # fmt: skip
    if slides is not None:
        texts["slides.csv"] = _slides(result, slides)
    texts["report.html"] = document(
        result.campaign.name, [*_page(result, slides, pictures), *_what_slides_do(slid, result.times[-1], of_slides)]
    )
    return [*paths, *write_texts(folder, texts)]


def _drawn(result: InTime, slides: SlidesInTime | None) -> list[Drawn]:
    """The figures of the page."""
    when = "How many samples fail first at each time, above the rain or the level."
    if slides is not None and slides.at.size:
        when = "How many samples fail first at each time, how far those that slid ran out, and the rain or the level."
    return [
        Drawn("probability", "Probability that the slope has failed by each time.", _probability(result)),
        Drawn("failures", when, _when_they_fail(result, slides)),
    ]


def _probability(result: InTime) -> Figure:
    """P_f with its interval above the rain or the level."""
    figure, axes = panels(2, 1, size=(7.0, 2.9))
    unit, _ = clock(result.times[-1])
    times = np.array(result.times) / unit
    low, high = np.array([estimate.interval for estimate in result.estimates]).T
    axes[0].fill_between(times, low, high, color="#D55E00", alpha=0.25, lw=0, label="95 % interval at each time")
    chances = [estimate.probability for estimate in result.estimates]
    axes[0].plot(times, chances, "o-", color="#D55E00", label="probability $P_f$", clip_on=False)
    axes[0].set(ylabel="probability of having failed", ylim=(0, None))
    axes[0].set_title(literal(result.campaign.name), loc="left")
    axes[0].legend(frameon=False, fontsize="small")
    draw_load(axes, result.campaign)
    return figure


def _when_they_fail(result: InTime, slides: SlidesInTime | None) -> Figure:
    """Counts of first failures by failure mode, run-out of the slides, and the rain or the level."""
    slid = slides is not None and slides.at.size > 0
    figure, axes = panels(3 if slid else 2, 1, size=(7.0, 2.3))
    unit, _ = clock(result.times[-1])
    times = np.array(result.times) / unit
    width = min(0.35 * np.diff(times).min(), 0.05 * np.ptp(times)) if times.size > 1 else 1.0
    bars = {"rough": (result.rough.size, "#999999"), "refined": (len(result.refined), "#0072B2")}
    shown = [grid for grid, (samples, _) in bars.items() if samples]
    for number, grid in enumerate(shown):
        samples, colour = bars[grid]
        place, label = times + (number - (len(shown) - 1) / 2) * width, f"{grid} grid, of {samples} samples"
        axes[0].bar(place, result.counts(grid), width, color=colour, label=label)
    most = max(int(result.counts(grid).max()) for grid in shown)
    axes[0].set(ylabel="samples that fail first", ylim=(0, 1.4 * max(most, 1)))  # room for the legend
    axes[0].set_title(literal(result.campaign.name), loc="left")
    axes[0].yaxis.set_major_locator(MaxNLocator(integer=True))
    axes[0].legend(frameon=False, fontsize="small")
    if slides is not None and slid:
        mode = np.asarray(slides.columns.get("mode", np.full(slides.at.size, "none")))
        for name, colour in COLOURS.items():
            here = (mode == name) | ((name == "none") & ~np.isin(mode, list(COLOURS)))
            if here.any():
                axes[1].plot(
                    times[slides.at[here]], slides.column("runout")[here], "o", color=colour, alpha=0.7,
                    label=name if name in SEVERITY else "slides",
                )  # fmt: skip
        axes[1].set(ylabel="run-out [m]", ylim=(min(0.0, np.nanmin(slides.column("runout"), initial=0.0)), None))
        axes[1].legend(frameon=False, fontsize="small")
    draw_load([axes[0], axes[-1]], result.campaign)
    margin = width * 1.2
    for ax in axes:
        ax.set(xlim=(-margin, times[-1] + margin))
    return figure


def _table(result: InTime) -> str:
    rows: list[list[object]] = [
        [time, estimate.probability, *estimate.interval, estimate.cov, estimate.refined_runs]
        for time, estimate in zip(result.times, result.estimates, strict=True)
    ]
    return csv_text(["t [s]", "P_f", "low", "high", "cov", "runs"], rows)


def _of_time(result: InTime, slides: SlidesInTime | None, at: int) -> list[Cell]:
    """How many samples fail first at a time on each grid, and what those that slid did."""
    counts: list[Cell] = [
        int(result.counts("rough")[at]),
        int(result.counts("refined")[at]) if result.refined else None,
    ]
    if slides is None:
        return counts
    here = slides.at == at
    measured = [slides.column(name)[here] for name in ("runout", "volume")]
    finite = [values[np.isfinite(values)] for values in measured]
    means: list[Cell] = [float(f"{values.mean():.4g}") if values.size else None for values in finite]
    return [*counts, int(here.sum()), *means, *slides.modes(at).values()]


def _heads(result: InTime, slides: SlidesInTime | None) -> list[str]:
    """Names of these columns."""
    head, volume = ["fail first, rough", "fail first, refined"], "m3" if result.campaign.dimension == 3 else "m3/m"
    return head if slides is None else [*head, "slides", "mean run-out [m]", f"mean volume [{volume}]", *SEVERITY]


def _failures(result: InTime, slides: SlidesInTime | None) -> str:
    rows = [
        [time, *("" if cell is None else cell for cell in _of_time(result, slides, at))]
        for at, time in enumerate(result.times)
    ]
    return csv_text(["t [s]", *_heads(result, slides)], rows)


def _when(result: InTime, first: int) -> object:
    """The time of a first failure (s) in words."""
    return "broke off" if first < 0 else "none" if first == len(result.times) else result.times[first]


def _samples(result: InTime) -> str:
    rows: list[list[object]] = [
        [
            number, _when(result, int(first)),
            _when(result, result.refined[number]) if number in result.refined else "",
            *(round(float(factor), 4) for factor in result.factors[number]),
        ]
        for number, first in enumerate(result.rough)
    ]  # fmt: skip
    head = ["sample", "first failure, rough [s]", "first failure, refined [s]"]
    return csv_text([*head, *(f"factor at {time:g} s" for time in result.times)], rows)


def _slides(result: InTime, slides: SlidesInTime) -> str:
    """Each slide as a row."""
    units = units_of_campaign(result.campaign)
    mode = np.asarray(slides.columns.get("mode", np.full(slides.at.size, "")))
    columns = [slides.column(name) for name in MEASURES]
    rows = [
        [
            int(sample),
            slides.grid,
            time,
            *("" if np.isnan(column[n]) else float(column[n]) for column in columns),
            mode[n],
        ]
        for n, (sample, time) in enumerate(zip(slides.columns["sample"], slides.column(FAILED_AT), strict=True))
    ]
    return csv_text(["sample", "grid", "t [s]", *(f"{name} [{units[name]}]" for name in MEASURES), "mode"], rows)


def _page(result: InTime, slides: SlidesInTime | None, pictures: list[Drawn]) -> Iterator[str]:
    """The page."""
    campaign, last = result.campaign, result.estimates[-1]
    yield heading(campaign.name, 1)
    yield headline(
        f"By {in_hours(result.times[-1])} the slope has failed with probability", f"{last.probability:.3g}",
        f"({limits(last.interval)}, 95 per cent).",
    )  # fmt: skip
    if (often := campaign.plan.annual_frequency) is not None:
        low, high = (annual(chance, often) for chance in last.interval)
        yield paragraph(
            f"Such storms come {often:g} times a year: it fails with an annual probability of "
            f"{annual(last.probability, often):.3g} ({low:.3g} to {high:.3g})."
        )
    yield paragraph(
        f"{result.rough.size} samples on the rough grid, {len(result.refined)} of them on the refined one; "
        f"{result.runs['rough']} and {result.runs['refined']} runs. A sample that has failed at a time counts as "
        "failed after it."
    )
    for note in dict.fromkeys(note for estimate in result.estimates for note in estimate.notes):
        yield paragraph(note, "note")
    rows = [
        [in_hours(time), float(f"{estimate.probability:.4g}"), limits(estimate.interval), *_of_time(result, slides, at)]
        for at, (time, estimate) in enumerate(zip(result.times, result.estimates, strict=True))
    ]
    heads = ["time", "P_f", "95 %", *_heads(result, slides)]
    # A mode that no slide has needs no column.
    shown = [at for at, head in enumerate(heads) if head not in SEVERITY or any(row[at] for row in rows)]
    yield table([heads[at] for at in shown], [[row[at] for at in shown] for row in rows])
    if slides is not None:
        ended = int((np.asarray(slides.columns["broke_off"], float) == 1).sum()) if slides.at.size else 0
        lost = f" {ended} of them broke off, and have no run-out." if ended else ""
        yield paragraph(
            f"{slides.at.size} of {len(result.first)} failing samples slid to their end on the {slides.grid} grid, "
            f"from rest under the pressure of the time at which they fail first.{lost}"
        )
    yield figures(pictures)


def _what_slides_do(slid: Results | None, last: float, pictures: list[Drawn]) -> Iterator[str]:
    """What the slides reach and how they look, by the last time (s)."""
    if slid is None:
        return
    summary = slid.summary
    yield heading("What the slides do")
    yield paragraph(
        f"Each slide stands for as many of all failures by {in_hours(last)}: probabilities here are those by that time."
    )
    if any_interactive(pictures):
        yield paragraph(HOW)
    for note in (*summary.warnings, *summary.notes):
        yield paragraph(note, "note")
    yield from appearance(slid)
    if summary.consequences.risk is not None:
        yield heading("Elements at risk")
        yield from risks(summary, summary.consequences.risk)
    yield figures(pictures)
    if any_interactive(pictures):
        yield script()


def _json(result: InTime, slides: SlidesInTime | None) -> str:
    often = result.campaign.plan.annual_frequency
    last = result.estimates[-1]
    content = {
        "name": result.campaign.name,
        "runs": result.runs,
        "annual": None
        if often is None
        else {
            "frequency": often, "probability": annual(last.probability, often),
            "interval": [annual(chance, often) for chance in last.interval],
        },
        "times": [
            {
                "time": time, "probability": estimate.probability, "interval": list(estimate.interval),
                "level": estimate.level, "cov": estimate.cov if np.isfinite(estimate.cov) else None,
                "method": estimate.method, "notes": list(estimate.notes),
                **dict(zip(_heads(result, slides), _of_time(result, slides, at), strict=True)),
            }
            for at, (time, estimate) in enumerate(zip(result.times, result.estimates, strict=True))
        ],
    }  # fmt: skip
    return json.dumps(content, indent=1) + "\n"


def lines(result: InTime, slides: SlidesInTime | None = None) -> Iterator[str]:
    """The answer in words, for a terminal.

    Args:
        result: of `probability_in_time`.
        slides: of `slides_in_time`, None without.
    """
    yield from first_lines(result.campaign.name, result.rough.size, len(result.refined), result.runs)
    yield "  time       P_f    (95 %)            fail first"
    for at, (time, estimate) in enumerate(zip(result.times, result.estimates, strict=True)):
        low, high = estimate.interval
        first = f"{result.counts('rough')[at]:4d}{_slid(slides, at)}"
        yield f"  {in_hours(time):>8}  {estimate.probability:6.3f}  ({low:.3f} to {high:.3f})  {first}"
    of_times = (note for estimate in result.estimates for note in estimate.notes)
    for note in dict.fromkeys([*of_times, *(slides.notes if slides else ())]):
        yield f"    {note}"
    yield "    a sample that has failed at a time counts as failed after it"


def _slid(slides: SlidesInTime | None, at: int) -> str:
    """What those that fail first at a time did, in words; nothing where none slid."""
    if slides is None or not (slides.at == at).any():
        return ""
    reach = slides.column("runout")[slides.at == at]
    modes = ", ".join(f"{count} {mode}" for mode, count in slides.modes(at).items() if count)
    far = f", run-out {np.nanmin(reach):.3g} to {np.nanmax(reach):.3g} m" if np.isfinite(reach).any() else ""
    return f"; {int((slides.at == at).sum())} slid{far}{f', {modes}' if modes else ''}"
