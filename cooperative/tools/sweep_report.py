"""Figures and table of a sweep: P_f, differences, fragility curves, displacement and modes, against what is varied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cooperative.measure import SEVERITY
from cooperative.reporting import (
    Cell,
    Drawn,
    document,
    heading,
    headline,
    limits,
    paragraph,
    tiled,
)
from cooperative.reporting import figures as interactive_figures
from cooperative.reporting import table as html_table
from cooperative.summary import Element, Summary
from cooperative.tools.sweep_differences import Difference
from cooperative.tools.sweep_fragility import Curve
from jaxmpm.support.text import csv_text, literal

LABELS = {
    "lx": "correlation length $l_x$ [m]",
    "ly": "correlation length $l_y$ [m]",
    "lz": "correlation length $l_z$ [m]",
    "cov": "coefficient of variation of $S_u$ [-]",
    "k_t": "standing samples in a row $k_t$ [-]",
}
PATHS = {
    "motion.scale": "scale of the record [-]",
    "run.k_h": "horizontal seismic coefficient $k_h$ [-]",
    "run.k_v": "vertical seismic coefficient $k_v$ [-]",
    "run.strength_factor": "factor on the strength [-]",
    "water.depth": "depth of the water table [m]",
    "water.level": "water level [m]",
}
"""Labels of paths that are often swept."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STYLES = dict(zip(SEVERITY, (("#D55E00", "o"), ("#CC79A7", "s"), ("#0072B2", "^"), ("#009E73", "v")), strict=True))
PEAK = "peak acceleration [g]"
BASE = "base"
"""Campaign of the scene as it is."""
RECORDS = "records"
"""Name of the curve of all records together."""
OF_PROBABILITY, OF_COST = (
    ("interval", "level", "estimator", "failures_refined"),
    ("refined_runs", "samples", "finished"),
)
"""Fields of the parts of a campaign's summary that `sweep.json` has of each point, beside P_f and the modes."""
P_F, SHARES = "probability of failure $P_f$ [-]", (-0.02, 1.02)


@dataclass(frozen=True)
class Point:
    """A value of a parameter, and its campaign.

    Args:
        value: of the parameter.
        campaign: name of its folder.
        summary: of the campaign.
        difference: of P_f to that of the base, of the same samples; None for the base itself.
        displacement: largest ones of the samples (m) on the rough grid, their median and 90 % quantile.
        peak: largest horizontal acceleration of a record (g), None without one.
    """

    value: float | str
    campaign: str
    summary: Summary
    difference: Difference | None = None
    displacement: tuple[float, ...] | None = None
    peak: float | None = None

    def as_json(self) -> dict[str, object]:
        """What `sweep.json` has of it."""
        fields = self.summary.as_json()
        displaced, change = self.displacement, self.difference
        return {
            "value": self.value,
            "campaign": self.campaign,
            "probability": self.summary.probability.value,
            **{name: fields["probability"][name] for name in OF_PROBABILITY},
            **{name: fields["cost"][name] for name in OF_COST},
            "modes": fields["modes"]["shares"],
            "difference": None if change is None else {**asdict(change), "resolved": change.resolved},
            "displacement": None if displaced is None else dict(zip(("median", "ninety"), displaced, strict=True)),
            "peak": self.peak,
            "elements_at_risk": {
                name: None if element is None else {**asdict(element.reached), "loss": _loss(element)}
                for name, element in self.summary.consequences.elements_at_risk.items()
            },
        }


def _loss(element: Element) -> float | None:
    """Expected loss at an element at risk, None where the scene gives it no value."""
    return None if element.loss is None else element.loss.expected


Parameters = Mapping[str, Sequence[Point]]
Fragility = Mapping[str, Sequence[Curve]]
"""Curves by parameter, the likeliest first."""


def label_of(parameter: str) -> str:
    """Label of a parameter's axis.

    Args:
        parameter: its key, or its path in the scene.
    """
    path, _, record = parameter.partition(" of ")
    return LABELS.get(parameter, PATHS.get(path, literal(path)) + (f", {literal(record)}" if record else ""))


COLUMNS = (
    "parameter",
    "value",
    "peak_g",
    "probability",
    "low",
    "high",
    "difference",
    "difference_low",
    "difference_high",
    "difference_resolved",
    "displacement_median_m",
    "displacement_90_m",
    "samples",
    "refined_runs",
    "campaign",
)
"""Of `sweep.csv`, a row for the base and for each value of each parameter; what a value does not have is empty.

Behind them stands the probability that slides reach each element at risk, by its name."""


def table(base: Point, parameters: Parameters) -> str:
    """The points of a sweep as CSV.

    Args:
        base: the scene as it is.
        parameters: points of `sweep.json` by parameter.
    """
    elements = list(base.summary.consequences.elements_at_risk)
    rows: list[Sequence[object]] = [[*COLUMNS, *(f"reached_{name}" for name in elements)]]
    for name, points in {BASE: [base], **parameters}.items():
        for point in points:
            change, summary = point.difference, point.summary
            compared = ("", "", "", "") if change is None else (change.difference, *change.interval, change.resolved)
            answer = summary.probability.value, *summary.probability.interval
            counts = summary.cost.samples, summary.cost.refined_runs, point.campaign
            places = [summary.consequences.elements_at_risk.get(element) for element in elements]
            reached = ["" if place is None else place.reached.probability for place in places]
            displaced = point.displacement or ("", "")
            rows.append([name, point.value, point.peak, *answer, *compared, *displaced, *counts, *reached])
    return csv_text(rows)


def in_words(base: Point, parameters: Parameters, fragility: Fragility) -> str:
    """A sweep for a terminal: P_f and its difference to the base at each value, and the fitted curves.

    Args:
        base: the scene as it is.
        parameters: points of `sweep.json` by parameter.
        fragility: its curves by parameter, the likelier first.
    """
    lines = [_point(base)]
    for name, points in parameters.items():
        lines += [name, *map(_point, points)]
        lines += [_line(curve) for curve in fragility.get(name, ())[:1]]
    if RECORDS in fragility:
        lines += [f"all records, {PEAK}", _line(fragility[RECORDS][0])]
    return "\n".join(lines)


def _point(point: Point) -> str:
    """P_f at a value, and its difference to the base."""
    summary, change = point.summary, point.difference
    line = f"  {_value(point):<12} P_f {summary.probability.value:.3g} {_limits(summary.probability.interval)}"
    if change is not None:
        line += f", {change.difference:+.3g} {_limits(change.interval)} to the base{_unresolved(change)}"
    return line


def _value(point: Point) -> str:
    return point.value if isinstance(point.value, str) else f"{point.value:g}"


def _unresolved(change: Difference) -> str:
    return "" if change.resolved else ", sign not resolved"


def _line(curve: Curve) -> str:
    return (
        f"  curve        {curve.form}, median {curve.median:.3g} {_limits(curve.median_interval)}, {_kind(curve)} "
        f"{curve.deviation:.2g} {_limits(curve.deviation_interval)}"
    )


def _limits(interval: Sequence[float]) -> str:
    return f"({interval[0]:.3g} to {interval[1]:.3g})"


def draw(base: Point, parameters: Parameters, fragility: Fragility) -> Iterator[Drawn]:
    """The figures of a sweep, those that there are data for.

    Args:
        base: the scene as it is.
        parameters: points of `sweep.json` by parameter.
        fragility: its curves by parameter, the likelier first.
    """
    yield Drawn(
        "probability",
        "Probability of failure with its interval. The dashed line is the base, the scene as it is.",
        probabilities(parameters, base),
    )
    compared = {name: rows for name, rows in parameters.items() if any(row.difference for row in rows)}
    if compared:
        yield Drawn(
            "difference",
            "Difference of the probability of failure to the base, of the same samples and the same refined runs.",
            differences(compared),
        )
    if fragility:
        yield Drawn("fragility", "Fragility curves with their bands.", fragility_curves(parameters, fragility))
    if compared:
        caption = "Largest displacement of the samples on the rough grid."
        yield Drawn("displacement", caption, displacements(compared))
    yield Drawn("modes", "Share of each mode among the failures.", mode_ratios(parameters))


def page(base: Point, parameters: Parameters, figures: Sequence[Drawn], scene: str) -> str:
    """The page of a sweep: P_f of the base, what each value changes, elements at risk, figures, scene.

    Args:
        base: the scene as it is.
        parameters: points of `sweep.json` by parameter.
        figures: as `draw` gives them.
        scene: its text.
    """
    return document(base.summary.name, _parts(base, parameters, figures, scene))


def _parts(base: Point, parameters: Parameters, figures: Sequence[Drawn], scene: str) -> Iterator[str]:
    summary = base.summary
    level = f"{summary.probability.level:.0%} interval"
    yield heading(summary.name, 1)
    yield headline(
        "As the scene is, the slope fails with probability",
        f"{summary.probability.value:.3g}",
        f"({level} {limits(summary.probability.interval)}).",
    )
    yield paragraph(
        "Each row below changes one value of the scene. All campaigns have the same random samples and refine the same "
        "of them, so a difference to the base is sharper than the two probabilities. Where its interval holds 0, the "
        "runs do not tell whether the change raises or lowers the probability of failure."
    )
    yield html_table(
        ["parameter", "value", "probability of failure", level, "difference to the base", level, "sign"],
        [_cells(name, point) for name, point in _rows(base, parameters)],
    )
    if summary.consequences.elements_at_risk:
        yield heading("Elements at risk")
        yield html_table(
            ["parameter", "value", "element", "probability of being reached", level, "expected loss"],
            [
                [name, _value(point), place, element.reached.probability, limits(element.reached.interval),
                 _loss(element)]
                for name, point in _rows(base, parameters)
                for place, element in point.summary.consequences.elements_at_risk.items() if element is not None
            ],
        )  # fmt: skip
    yield interactive_figures(figures)
    yield heading("Scene")
    yield f"<pre>{escape(scene)}</pre>"


def _rows(base: Point, parameters: Parameters) -> Iterator[tuple[str, Point]]:
    """Name of the parameter and point, the base first."""
    yield BASE, base
    yield from ((name, point) for name, points in parameters.items() for point in points)


def _cells(name: str, point: Point) -> list[Cell]:
    summary, change = point.summary, point.difference
    answer: list[Cell] = [name, _value(point), summary.probability.value, limits(summary.probability.interval)]
    if change is None:
        return [*answer, None, None, None]
    sign = ("higher" if change.difference > 0 else "lower") if change.resolved else "not resolved"
    return [*answer, change.difference, limits(change.interval), sign]


def probabilities(parameters: Parameters, base: Point | None = None) -> Figure:
    """P_f with its interval against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
        base: the scene as it is, a dashed line in each panel.
    """
    figure, panels = _by_parameter(parameters, P_F)
    for ax, rows in panels:
        if base is not None:
            ax.axhline(base.summary.probability.value, color="0.4", lw=1.0, ls="--")
        _chances(ax, [row.value for row in rows], rows, COLOURS[0])
        ax.set_ylim(bottom=0)
    return figure


def differences(parameters: Parameters) -> Figure:
    """Difference of P_f to the base, of the same samples, with its interval against each parameter.

    Args:
        parameters: points of `sweep.json` by parameter, with differences.
    """
    figure, panels = _by_parameter(parameters, "difference of $P_f$ to the base [-]")
    for ax, rows in panels:
        pairs = [(row.value, change) for row in rows if (change := row.difference)]
        values, changes = [value for value, _ in pairs], [change for _, change in pairs]
        ax.axhline(0.0, color="0.6", lw=0.8)
        _errorbar(
            ax, values, [change.difference for change in changes], [change.interval for change in changes], COLOURS[0]
        )
    return figure


def fragility_curves(parameters: Parameters, fragility: Fragility) -> Figure:
    """Fragility curves with the points that they are fitted to; of records all in one panel.

    Args:
        parameters: points of `sweep.json` by parameter.
        fragility: its curves by parameter, the likelier first.
    """
    of_records = [name for name in parameters if parameters[name][0].peak is not None]
    alone = [name for name in fragility if name in parameters and name not in of_records]
    figure, axes = _panels(len(alone) + bool(of_records))
    for ax, name in zip(axes, alone, strict=False):
        _band(ax, fragility[name][0], COLOURS[0])
        _chances(ax, [row.value for row in parameters[name]], parameters[name], "0.15", line="none")
        ax.set(xlabel=label_of(name), ylabel=P_F, ylim=SHARES)
    if of_records:
        _records(axes[-1], parameters, fragility, of_records)
    return figure


def displacements(parameters: Parameters) -> Figure:
    """Displacement of the samples on the rough grid against each parameter: median and 90 % quantile.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, panels = _by_parameter(parameters, "largest displacement, rough grid [m]")
    for ax, rows in panels:
        pairs = [(row.value, displacement) for row in rows if (displacement := row.displacement)]
        at, displaced = [value for value, _ in pairs], np.maximum([values for _, values in pairs], 1e-4)
        ax.plot(at, displaced[:, 1], "^-", color=COLOURS[1], label="90 % quantile")
        ax.plot(at, displaced[:, 0], "o-", color=COLOURS[0], label="median")
        ax.set_yscale("log")
        ax.legend(frameon=False, fontsize=7)
    return figure


def mode_ratios(parameters: Parameters) -> Figure:
    """Share of each mode among the failures, with its interval, against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, panels = _by_parameter(parameters, "share of the failures [-]")
    handles: dict[str, Artist] = {}
    for ax, rows in panels:
        pairs = [(row.value, modes) for row in rows if (modes := row.summary.modes.shares)]
        for number, (mode, (colour, marker)) in enumerate(STYLES.items()):
            parts = [modes[mode] for _, modes in pairs]
            if any(part.count for part in parts):
                ratio, limits = [part.ratio for part in parts], [part.interval for part in parts]
                values, shift = [value for value, _ in pairs], number - 1.5
                _errorbar(ax, values, ratio, limits, colour, marker=marker, label=mode, shift=shift)
        ax.set_ylim(SHARES)
        handles |= {label: handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    if handles:
        shown = [mode for mode in STYLES if mode in handles]
        figure.legend([handles[mode] for mode in shown], shown, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _records(ax: Axes, parameters: Parameters, fragility: Fragility, names: Sequence[str]) -> None:
    """Curves of records against their peak acceleration, and that of all together."""
    for number, name in enumerate(names, start=1):
        rows, label = parameters[name], literal(name.partition(" of ")[2])
        _chances(ax, [row.peak or 0.0 for row in rows], rows, COLOURS[number % len(COLOURS)], label=label)
    if RECORDS in fragility:
        _band(ax, fragility[RECORDS][0], "0.3", "all records")
    ax.set(xlabel=PEAK, ylabel=P_F, ylim=SHARES)
    ax.legend(frameon=False, fontsize=7, loc="best")


def _band(ax: Axes, curve: Curve, colour: str, label: str = "") -> None:
    """A curve in the band of its interval, its form, median and deviation above."""
    ax.fill_between(curve.level, curve.low, curve.high, color=colour, alpha=0.2, lw=0)
    ax.plot(curve.level, curve.probability, color=colour, lw=1.4, label=label)
    words = f"{curve.form}: median {curve.median:.3g}, {_kind(curve)} {curve.deviation:.2g}"
    ax.set_title(words, fontsize=8)


def _kind(curve: Curve) -> str:
    """What a curve's deviation is called."""
    return "dispersion" if curve.form == "lognormal" else "deviation"


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """So many panels, at most three beside each other, so that a page's width leaves them legible."""
    rows = -(-count // 3)
    columns = -(-count // rows)
    return tiled(count, columns, (3.4 if columns == 1 else 3.0, 3.2))


def _by_parameter(parameters: Parameters, label: str) -> tuple[Figure, list[tuple[Axes, Sequence[Point]]]]:
    """A panel for each parameter with its points, their axes labelled."""
    figure, axes = _panels(len(parameters))
    for ax, name in zip(axes, parameters, strict=True):
        ax.set(xlabel=label_of(name), ylabel=label)
    return figure, list(zip(axes, parameters.values(), strict=True))


def _chances(
    ax: Axes, values: Sequence[float | str], rows: Sequence[Point], colour: str, *, label: str = "", line: str = "-"
) -> None:
    """P_f with its interval of points at these values."""
    middle, limits = [row.summary.probability.value for row in rows], [row.summary.probability.interval for row in rows]
    _errorbar(ax, values, middle, limits, colour, label=label, line=line)


def _errorbar(
    ax: Axes, values: Sequence[float | str], middle: Sequence[float], limits: Sequence[tuple[float, float]],
    colour: str, *, marker: str = "o", label: str = "", shift: float = 0.0, line: str = "-",
) -> None:  # fmt: skip
    """A line with intervals, displaced a little sideways so that intervals do not lie on each other."""
    named = any(isinstance(value, str) for value in values)
    at = np.arange(len(values), dtype=float) if named else np.array(values, float)
    if named:
        ax.set_xticks(at, [literal(str(value)) for value in values], rotation=20, ha="right")
        line = "none"
    at = at + shift * 0.008 * (np.ptp(at) if at.size > 1 else 1.0)
    low, high = np.reshape(limits, (-1, 2)).T
    off = np.maximum([middle - low, high - middle], 0.0)
    ax.margins(x=0.08)
    ax.errorbar(
        at, middle, off, color=colour, marker=marker, ms=5, lw=1.4, ls=line, capsize=2, elinewidth=1.4, label=label
    )
