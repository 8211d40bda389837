"""A parameter sweep: campaigns that share their coefficients, and P_f and modes against each parameter.

A sweep is a scene with a table `[sweep]`: lists of lx, ly, lz (correlation lengths, m), cov and k_t. One parameter is
changed at a time, the others stay as the scene has them, as in Jiang, Li, Ma and Rezania (2024), Computers and
Geotechnics 172, 106413, Figs. 10 and 20. Sample n has the same coefficients in every campaign, so that differences
between campaigns scatter less than the campaigns do.

    sweep.toml                    the scene, verbatim
    campaigns/base, lx-10 ...     campaigns, each as `cooperative.campaign.run` leaves it
    sweep.json                    P_f and mode ratios, with intervals, by parameter and value
    figures/probability.png, figures/modes.png
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypedDict, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import kl
from cooperative.campaign import run as run_campaign
from cooperative.estimate import Published, Sampling, rank_samples, stopping_rank
from cooperative.measure import SEVERITY
from cooperative.reporting import panels, save
from cooperative.runs import check_size, phases_of, release_programs, rows_reader, samples_of, stop_by_signals
from cooperative.scene import parse, settled, source_of, stored_measured, to_toml
from cooperative.scene import tables as known
from cooperative.store import CAMPAIGN, GRIDS, Rows, Source, read_store, stored_source, write_aside
from cooperative.summary import summarise
from cooperative.values import Summary

SWEEP = "sweep.toml"
LENGTHS = ("lx", "ly", "lz")
LABELS = {
    "lx": "correlation length $l_x$ [m]",
    "ly": "correlation length $l_y$ [m]",
    "lz": "correlation length $l_z$ [m]",
    "cov": "coefficient of variation of $S_u$ [-]",
    "k_t": "standing samples in a row $k_t$ [-]",
}
STYLES = dict(zip(SEVERITY, (("#D55E00", "o"), ("#CC79A7", "s"), ("#0072B2", "^"), ("#009E73", "v")), strict=True))


class Point(TypedDict):
    """A value of a parameter in `sweep.json`: its campaign, and fields of the summary."""

    value: float
    campaign: str
    probability: float
    interval: list[float]
    level: float
    estimator: str
    refined_runs: int
    samples: int
    failures_refined: int
    modes: dict[str, ModePart] | None
    finished: str | None


class ModePart(TypedDict):
    """A failure mode of a point."""

    count: int
    ratio: float
    interval: list[float]
    probability: float


class Content(TypedDict):
    """What `sweep.json` holds."""

    name: str
    parameters: dict[str, list[Point]]


@dataclass(frozen=True)
class Variant:
    """One campaign of a sweep.

    Args:
        name: its folder.
        source: its scene.
        points: the (parameter, value) it answers for.
    """

    name: str
    source: Source
    points: tuple[tuple[str, float], ...]


def run(scene: Source | str | Path, folder: Path, *, workers: int = 1, progress: bool = False) -> Content:
    """Run all campaigns of a sweep in its folder, or go on where it was.

    Ctrl-C and SIGTERM end it as they end `cooperative.campaign.run`.

    Args:
        scene: TOML text, or its file.
        folder: of the sweep.
        workers: as for `cooperative.campaign.run`.
        progress: as for `cooperative.campaign.run`.

    Returns:
        What `sweep.json` holds.

    Raises:
        ValueError: a sweep that will not do, before anything is run, or a folder of another sweep.
    """
    folder = Path(folder)
    source = settled(scene, folder, SWEEP)
    parts = variants(source)
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    for part in parts:
        check_size(parse(part.source), workers)
    _claim(folder, source)
    with stop_by_signals():
        return _ran(parts, folder, list(_sweep(source.tables)), workers=workers, progress=progress)


def _ran(parts: list[Variant], folder: Path, names: list[str], *, workers: int, progress: bool) -> Content:
    """All campaigns in turn, and their `sweep.json` and figures."""
    points: dict[str, list[Point]] = {name: [] for name in names}
    name = "sweep"
    for part in parts:
        where = folder / "campaigns" / part.name
        if progress:
            print(f"{part.name}:", flush=True)
        summary = run_campaign(_with_factors(part, folder), where, workers=workers, progress=progress)
        release_programs()
        name = summary.name
        for parameter, value in part.points:
            answer = _ranked(where, int(value)) if parameter == "k_t" else summary
            points[parameter].append(_point(value, part.name, answer))
    parameters = {parameter: sorted(rows, key=lambda row: row["value"]) for parameter, rows in points.items()}
    content: Content = {"name": name, "parameters": parameters}
    write_aside(folder / "sweep.json", json.dumps(content, indent=1).encode())
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    save(probabilities(parameters), target / "probability.png")
    save(mode_ratios(parameters), target / "modes.png")
    return content


def variants(scene: Source | str | Path) -> list[Variant]:
    """The campaigns of a sweep.

    Args:
        scene: with a table `[sweep]`: TOML text, or its file.

    Raises:
        ValueError: the table `[sweep]` is missing or holds what cannot be swept.
    """
    source = source_of(scene)
    sweep, base_scene = _sweep(source.tables), {name: each for name, each in source.tables.items() if name != "sweep"}

    def variant(name: str, *points: tuple[str, float], **changed: object) -> Variant:
        return Variant(name, Source(to_toml({**base_scene, **changed}), begun=source.begun), points)

    campaign = parse(variant("base").source)
    if campaign.plan.coefficients is not kl.latin_hypercube:
        raise ValueError("[sweep] shares coefficients between fields of different lengths: take 'latin hypercube'")
    estimator, first = campaign.estimator, Sampling(campaign.plan.samples, campaign.run.failure_displacement)
    if estimator.rough_runs(first) != campaign.plan.samples:
        name = estimator.name
        raise ValueError(f"[sweep] shares samples, which estimator = {name!r} makes one by one: take another estimator")
    dimension, strength = campaign.dimension, campaign.random.get("strength")
    if strength is None or "strength" not in base_scene:
        raise ValueError("a sweep varies the field of undrained strength: give the scene a table [strength]")
    base = {"cov": strength.cov, **dict(zip(_axes(dimension), strength.length, strict=True))}
    unknown = [name for name in sweep if name not in base and name != "k_t"]
    if unknown:
        raise ValueError(f"[sweep] {unknown[0]} cannot be swept in this scene: give {', '.join((*base, 'k_t'))}")
    points = [(name, value) for name, values in sweep.items() if name in base for value in values]
    campaigns = [variant("base", *(each for each in points if each[1] == base[each[0]]))]
    for parameter, value in points:
        if value != base[parameter]:
            changed = {**base, parameter: value}
            length = [changed[axis] for axis in _axes(dimension)]
            table = {**base_scene["strength"], "cov": changed["cov"], "length": length}
            campaigns.append(variant(f"{parameter}-{value:g}", (parameter, value), strength=table))
    if "k_t" in sweep:
        # All values of k_t follow from the runs that the largest asks for.
        plan = {k: v for k, v in base_scene["campaign"].items() if k not in ("refined_runs", "target_cov")}
        plan |= {"estimator": "published", "k_t": int(max(sweep["k_t"]))}
        campaigns.append(variant("ranked", *(("k_t", value) for value in sweep["k_t"]), campaign=plan))
    return campaigns


def probabilities(parameters: dict[str, list[Point]]) -> Figure:
    """P_f with its interval against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, axes = _panels(parameters)
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        _errorbar(ax, rows, [row["probability"] for row in rows], [row["interval"] for row in rows], "#0072B2", "o", "")
        ax.set(xlabel=LABELS[name], ylabel="probability of failure $P_f$ [-]")
        ax.set_ylim(bottom=0)
    return figure


def mode_ratios(parameters: dict[str, list[Point]]) -> Figure:
    """Share of each mode among the failures, with its interval, against each parameter, one panel each.

    Args:
        parameters: points of `sweep.json` by parameter.
    """
    figure, axes = _panels(parameters)
    handles: dict[str, Artist] = {}
    for ax, (name, rows) in zip(axes, parameters.items(), strict=True):
        with_failures = [(row, modes) for row in rows if (modes := row["modes"])]
        for number, (mode, (colour, marker)) in enumerate(STYLES.items()):
            parts = [modes[mode] for _, modes in with_failures]
            if any(part["count"] for part in parts):
                ratio, limits = [part["ratio"] for part in parts], [part["interval"] for part in parts]
                drawn = [row for row, _ in with_failures]
                _errorbar(ax, drawn, ratio, limits, colour, marker, mode, shift=number - 1.5)
        ax.set(xlabel=LABELS[name], ylabel="share of the failures [-]", ylim=(-0.02, 1.02))
        handles |= {label: handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    if handles:
        shown = [mode for mode in STYLES if mode in handles]
        figure.legend([handles[mode] for mode in shown], shown, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _panels(parameters: dict[str, list[Point]]) -> tuple[Figure, list[Axes]]:
    """A panel for each parameter, at most three beside each other, so that a page's width leaves them legible."""
    rows = -(-len(parameters) // 3)
    columns = -(-len(parameters) // rows)
    figure, axes = panels(rows, columns, size=(3.0, 3.2))
    for ax in axes[len(parameters) :]:
        ax.set_axis_off()
    return figure, axes[: len(parameters)]


def _errorbar(
    ax: Axes, rows: list[Point], middle: list[float], limits: list[list[float]], colour: str, marker: str,
    label: str, *, shift: float = 0.0,
) -> None:  # fmt: skip
    """A line with intervals, moved a little sideways so that intervals do not lie on each other."""
    at = np.array([row["value"] for row in rows], float)
    at = at + shift * 0.008 * (np.ptp(at) if at.size > 1 else 1.0)
    off = [[m - low for m, (low, _) in zip(middle, limits, strict=True)],
           [high - m for m, (_, high) in zip(middle, limits, strict=True)]]  # fmt: skip
    ax.margins(x=0.08)
    ax.errorbar(at, middle, np.maximum(off, 0.0), color=colour, marker=marker, ms=5, lw=1.4, capsize=2, label=label)


def _axes(dimension: int) -> tuple[str, ...]:
    return LENGTHS if dimension == 3 else ("lx", "lz")


def _sweep(tables: Mapping[str, object]) -> dict[str, list[float]]:
    """The table `[sweep]`, checked as far as it can be without the scene."""
    table = tables.get("sweep")
    if not isinstance(table, dict) or not table:
        raise ValueError("the scene has no table [sweep]: give one, for example with lx = [10, 30, 60, 120]")
    known.read(known.Sweep, table, "sweep")
    return table


def _claim(folder: Path, source: Source) -> None:
    """Make the folder, or see that it is this sweep's."""
    there = stored_source(folder, SWEEP)
    if there is not None and there.tables != source.tables:
        raise ValueError(f"folder {folder} belongs to another sweep: give another folder, or the scene it has")
    if there is None and folder.exists() and any(each.name != CAMPAIGN for each in folder.iterdir()):
        raise ValueError(f"folder {folder} holds something, but no sweep.toml: give a new or empty folder")
    (folder / "campaigns").mkdir(parents=True, exist_ok=True)
    if there is None:
        source.write(folder, SWEEP)


def _with_factors(part: Variant, folder: Path) -> Source:
    """The variant's scene; where it is calibrated, with the factors of safety that the base campaign measured."""
    campaign = parse(part.source)
    if part.name == "base" or not campaign.plan.calibrate or campaign.measured.calibration is not None:
        return part.source
    measured = stored_measured(folder / "campaigns" / "base").calibration
    assert measured is not None
    return Source(to_toml({**part.source.tables, "calibration": asdict(measured)}))


def _ranked(folder: Path, k_t: int) -> Summary:
    """Summary that a campaign by the published rule would have had with this k_t."""
    store = read_store(folder)
    campaign = replace(parse(store.source), estimator=Published(k_t))
    rough, refined = map(rows_reader(store, samples_of(campaign)), GRIDS)
    order = rank_samples(rough.columns["displacement"], rough.columns["broke_off"].astype(bool)).order
    ran = order[: stopping_rank(order, phases_of(campaign, rough, refined).answers, k_t)]
    ranked_rows = np.isin(refined.columns["sample"], ran)
    return summarise(campaign, rough, Rows({name: c[ranked_rows] for name, c in refined.columns.items()}, ()))


def _point(value: float, campaign: str, summary: Summary) -> Point:
    """What `sweep.json` has of one campaign."""
    names = ("interval", "level", "estimator", "refined_runs", "samples", "failures_refined", "modes", "finished")
    fields = summary.as_json()
    point = {"value": value, "campaign": campaign, "probability": summary.probability_of_failure}
    return cast(Point, point | {name: fields[name] for name in names})
