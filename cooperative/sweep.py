"""A sweep: campaigns that share their samples, and P_f, fragility and modes against what is varied.

A sweep is a scene with a table `[sweep]`, or with tables `[[scenario]]`. One parameter is changed at a time, the others
stay as the scene has them, as in Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Figs. 10 and
20. Sample n has the same coefficients in every campaign, so that differences between campaigns scatter less than the
campaigns do (`cooperative.estimate.paired_difference`). Where another shape of ground changes the box that holds it,
the terms of its field differ too, and samples have less in common; the intervals of differences are wider then.

    sweep.toml                    the scene, verbatim
    campaigns/base, lx-10 ...     campaigns, each as `cooperative.campaign.run` leaves it
    sweep.json                    P_f, differences to the base and mode ratios, with intervals; fragility curves
    sweep.csv                     the same as a table
    figures/probability.png, difference.png, fragility.png, displacement.png, modes.png
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from cooperative.campaign import run as run_campaign
from cooperative.estimate import (
    Curve,
    Published,
    by_sample,
    covariance_of,
    fit_fragility,
    paired_difference,
    rank_samples,
    stopping_rank,
)
from cooperative.reporting import save
from cooperative.reporting import sweeps as figures
from cooperative.reporting.sweeps import LABELS, RECORDS, Point
from cooperative.runs import check_size, phases_of, release_programs, rows_reader, samples_of, stop_by_signals
from cooperative.scene import (
    BASE,
    RANKED,
    SCALES,
    SCENARIO,
    Variant,
    campaign_of,
    parse,
    settled,
    variants,
    with_measured_of_base,
)
from cooperative.store import CAMPAIGN, GRIDS, Rows, Source, read_store, stored_source, write_aside
from cooperative.summary import summarise
from cooperative.values import Summary
from foundation.text import printable
from jaxmpm.soil import STANDARD_GRAVITY

__all__ = ["LABELS", "Content", "Variant", "run", "variants"]

SWEEP = "sweep.toml"
FEWEST = 3
"""Levels of a fragility curve."""


class Content(TypedDict):
    """What `sweep.json` holds."""

    name: str
    parameters: dict[str, list[dict[str, object]]]
    fragility: dict[str, list[dict[str, object]]]


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
        return _ran(parts, folder, workers=workers, progress=progress)


def _ran(parts: list[Variant], folder: Path, *, workers: int, progress: bool) -> Content:
    """All campaigns in turn, and their `sweep.json` and figures."""
    points: dict[str, list[Point]] = {}
    counted: dict[str, np.ndarray] = {}
    variance: dict[str, float] = {}
    name = "sweep"
    for part in parts:
        where = folder / "campaigns" / part.name
        if progress:
            print(f"{part.name}:", flush=True)
        summary = run_campaign(with_measured_of_base(part, folder), where, workers=workers, progress=progress)
        release_programs()
        name = summary.name
        if part.name != RANKED:
            counted[part.name] = _counted(where)
            variance[part.name] = ((summary.coefficient_of_variation or 0.0) * summary.probability_of_failure) ** 2
        for parameter, value in part.points:
            if part.name == RANKED:
                point = Point(value, part.name, _ranked(where, int(value)))
            else:
                point = _compared(Point(value, part.name, summary), where, counted, variance)
            points.setdefault(parameter, []).append(point)
    parameters = {
        parameter: rows if parameter == SCENARIO else sorted(rows, key=lambda row: row.value)
        for parameter, rows in points.items()
    }
    fragility = _fragility(parameters, counted, variance)
    text = json.dumps(
        {
            "name": name,
            "parameters": {parameter: [row.as_json() for row in rows] for parameter, rows in parameters.items()},
            "fragility": {parameter: list(map(asdict, curves)) for parameter, curves in fragility.items()},
        },
        indent=1,
    )
    write_aside(folder / "sweep.json", text.encode())
    write_aside(folder / "sweep.csv", figures.table(parameters).encode())
    _draw(parameters, fragility, folder / "figures")
    if progress:
        for line in figures.in_words(parameters, fragility).splitlines():
            print(printable(line), flush=True)
    content: Content = json.loads(text)
    return content


def _draw(parameters: figures.Parameters, fragility: figures.Fragility, target: Path) -> None:
    target.mkdir(exist_ok=True)
    save(figures.probabilities(parameters), target / "probability.png")
    save(figures.mode_ratios(parameters), target / "modes.png")
    compared = {name: rows for name, rows in parameters.items() if any(row.difference for row in rows)}
    if compared:
        save(figures.differences(compared), target / "difference.png")
        save(figures.displacements(compared), target / "displacement.png")
    if fragility:
        save(figures.fragility_curves(parameters, fragility), target / "fragility.png")


def _claim(folder: Path, source: Source) -> None:
    """Make the folder, or see that it is this sweep's."""
    there = stored_source(folder, SWEEP)
    if there is not None and there.tables != source.tables:
        raise ValueError(f"folder {folder} belongs to another sweep: give another folder, or the scene it has")
    if there is None and folder.exists() and any(each.name != CAMPAIGN for each in folder.iterdir()):
        raise ValueError(f"folder {folder} is not empty, and no sweep has begun there: give a new or empty folder")
    (folder / "campaigns").mkdir(parents=True, exist_ok=True)
    if there is None:
        source.write(folder, SWEEP)


def _ranked(folder: Path, k_t: int) -> Summary:
    """Summary that a campaign by the published rule would have had with this k_t."""
    store = read_store(folder)
    campaign = replace(parse(store.source), estimator=Published(k_t))
    rough, refined = map(rows_reader(store, samples_of(campaign)), GRIDS)
    order = rank_samples(rough.columns["displacement"], rough.columns["broke_off"].astype(bool)).order
    ran = order[: stopping_rank(order, phases_of(campaign, rough, refined).answers, k_t)]
    ranked_rows = np.isin(refined.columns["sample"], ran)
    return summarise(campaign, rough, Rows({name: c[ranked_rows] for name, c in refined.columns.items()}, ()))


def _counted(folder: Path) -> np.ndarray:
    """Failures counted at each sample of a campaign (N,)."""
    store = read_store(folder)
    campaign = campaign_of(store)
    phases = phases_of(campaign, *map(rows_reader(store, samples_of(campaign)), GRIDS))
    assert phases.failures is not None
    return by_sample(phases.failures, phases.estimate.probability, campaign.plan.samples)


def _compared(point: Point, folder: Path, counted: Mapping[str, np.ndarray], variance: Mapping[str, float]) -> Point:
    """A point beside the base: with the difference of P_f, the displacement, and the peak acceleration."""
    difference = None
    if point.campaign != BASE:
        both = variance[BASE], variance[point.campaign]
        difference = paired_difference(counted[BASE], counted[point.campaign], both)
    store = read_store(folder)
    campaign = campaign_of(store)
    rough = rows_reader(store, samples_of(campaign))("rough")
    displacement = displacement_of(rough.columns["displacement"], rough.columns["broke_off"].astype(bool))
    motion, peak = campaign.run.motion, None
    if motion is not None:
        peak = float(np.abs(motion.acceleration[:-1]).max()) / STANDARD_GRAVITY
    return replace(point, difference=difference, displacement=displacement, peak=peak)


def displacement_of(displacement: np.ndarray, broke_off: np.ndarray) -> tuple[float, ...] | None:
    """Median and 90 % quantile of the largest displacements of samples.

    Args:
        displacement: (N,) m.
        broke_off: (N,) bool, runs that mostly moved farther than all others; None of the quantiles is known where one
            of them would be such a run's.
    """
    if not displacement.size:
        return None
    with np.errstate(invalid="ignore"):
        quantiles = np.quantile(np.where(broke_off, np.inf, displacement), (0.5, 0.9))
    return tuple(quantiles.tolist()) if np.isfinite(quantiles).all() else None


def _fragility(
    parameters: figures.Parameters, counted: Mapping[str, np.ndarray], variance: Mapping[str, float]
) -> dict[str, tuple[Curve, ...]]:
    """Curves of each parameter that is a path to a number, and of all records together."""
    groups = {name: [(float(row.value), row) for row in rows]
              for name, rows in parameters.items() if name not in (*LABELS, SCENARIO)}  # fmt: skip
    of_records = [row for name, rows in parameters.items() if name.startswith(f"{SCALES} of ") for row in rows]
    if len({row.campaign.rpartition("-")[0] for row in of_records}) > 1:
        groups[RECORDS] = [(row.peak or 0.0, row) for row in of_records]
    curves: dict[str, tuple[Curve, ...]] = {}
    for name, rows in groups.items():
        if len(rows) < FEWEST:
            continue
        z = [counted[row.campaign] for _, row in rows]
        spread = covariance_of(z, [variance[row.campaign] for _, row in rows])
        levels, shares = [at for at, _ in rows], [float(each.mean()) for each in z]
        fitted = fit_fragility(levels, shares, spread, z[0].size, even=name == RECORDS)
        if fitted:
            curves[name] = fitted
    return curves
