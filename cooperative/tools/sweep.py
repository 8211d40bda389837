"""A sweep: campaigns that share their samples, and P_f, fragility and modes against what is varied.

A sweep is a scene with a table `[sweep]`, or with tables `[[scenario]]`. One parameter is changed at a time, the others
stay as the scene has them, as in Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, Figs. 10
and 20. Sample n has the same coefficients in every campaign, and a sample that one campaign's audit refines is
refined in all (`cooperative.tools.sweep_audit`), so that differences between campaigns scatter less than the
campaigns do (`cooperative.tools.sweep_differences`). All campaigns are screened first, since the shared draws
follow from the rough results of all. A target for the coefficient of variation holds for the base; the others take as
many refined runs as it did. Campaigns whose estimator has no audit draw as that estimator does. Where another shape
of ground changes the box that holds it, the terms of its field differ too, and samples have less in common; the
intervals of differences are wider then.

    sweep.toml                    the scene, verbatim
    campaign.json                 points and heights of the files that it names
    campaigns/base, lx-10 ...     campaigns, each as `cooperative.campaign.run` leaves it
    sweep.json                    P_f, differences to the base and mode ratios, with intervals; fragility curves
    sweep.csv                     the same as a table
    report.html                   the same as a page, with the figures
    figures/probability.png, difference.png, fragility.png, displacement.png, modes.png
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from cooperative.campaign import run as run_campaign
from cooperative.estimate import (
    Audited,
    Population,
    Published,
    rank_samples,
    stopping_rank,
)
from cooperative.reporting import save
from cooperative.runs import check_size, phases_of, release_programs, rows_reader, samples_of, stop_by_signals
from cooperative.scene import (
    BASE,
    RANKED,
    SCALES,
    SCENARIO,
    Measured,
    Variant,
    campaign_of,
    check_samples,
    keep,
    parse,
    source_of,
    stored_measured,
    variants,
    with_measured_of_base,
)
from cooperative.store import GRIDS, Rows, Source, open_store, own_folder, read_store, source_from, write_aside
from cooperative.summary import Summary, summarise
from cooperative.tools import sweep_report as figures
from cooperative.tools.sweep_audit import shared_audit
from cooperative.tools.sweep_differences import by_sample, covariance_of, paired_difference, unit_of
from cooperative.tools.sweep_fragility import Curve, fit_fragility
from cooperative.tools.sweep_report import LABELS, RECORDS, Point
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import files
from jaxmpm.support.text import printable

__all__ = ["LABELS", "Content", "Variant", "run", "variants"]

SWEEP, BESIDE = "sweep.toml", "campaign.json"
FEWEST = 3
"""Levels of a fragility curve."""


class Content(TypedDict):
    """What `sweep.json` holds."""

    name: str
    base: dict[str, object]
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
    source, there = source_of(scene), _stored_source(folder)
    source = source if there is None else source.completed(there)
    parts = variants(source)
    if workers < 1:
        raise ValueError(f"workers = {workers}: give 1 or more")
    for part in parts:
        campaign = parse(part.source)
        check_samples(campaign)
        check_size(campaign, workers)
    _claim(folder, source)
    with stop_by_signals():
        _share_audit(parts, folder, workers=workers, progress=progress)
        return _run_all(parts, folder, workers=workers, progress=progress)


class _ScreenedError(Exception):
    """Ends a campaign once all its samples have run on the rough grid."""


def _after_screening(phase: str) -> None:
    if phase == "audit":
        raise _ScreenedError


def _share_audit(parts: list[Variant], folder: Path, *, workers: int, progress: bool) -> None:
    """Screen all campaigns that audit their rough results, and keep the audit that they share in the folder of each."""
    audited = [part for part in parts if isinstance(parse(part.source).estimator, Audited)]
    where = {part.name: own_folder(folder / "campaigns" / part.name) for part in audited}
    if len(audited) < 2 or all(stored_measured(path).shared for path in where.values()):
        return
    populations = []
    for part in audited:
        if progress:
            print(f"{part.name}, rough grid:", flush=True)
        with suppress(_ScreenedError):
            run_campaign(
                with_measured_of_base(part, folder), where[part.name], workers=workers, progress=progress,
                on_phase=_after_screening,
            )  # fmt: skip
        release_programs()
        populations.append(_population(where[part.name]))
    shared = shared_audit(populations)
    for path in where.values():
        _write_measured(path, replace(stored_measured(path), shared=shared))


def _population(folder: Path) -> Population:
    """First phase of a campaign whose samples have all run on the rough grid."""
    store = read_store(folder)
    campaign = campaign_of(store)
    population = phases_of(campaign, *map(rows_reader(store, samples_of(campaign)), GRIDS)).population
    assert population is not None
    return population


def _take_runs_of_base(folder: Path, base: Summary) -> None:
    """Have a campaign refine as many samples as the base did, where a target decides of them."""
    measured = stored_measured(folder)
    if measured.shared is not None and measured.shared.runs is None:
        _write_measured(folder, replace(measured, shared=replace(measured.shared, runs=base.probability.runs)))


def _write_measured(folder: Path, measured: Measured) -> None:
    """Keep numbers in the database of one campaign."""
    with open_store(folder, read_store(folder).source) as store:
        keep(store, measured)


def _run_all(parts: list[Variant], folder: Path, *, workers: int, progress: bool) -> Content:
    """All campaigns in turn, and their `sweep.json` and figures."""
    points: dict[str, list[Point]] = {}
    counted: dict[str, np.ndarray] = {}
    variance: dict[str, float] = {}
    unit = 1.0
    base: Point | None = None
    for part in parts:
        where = own_folder(folder / "campaigns" / part.name)
        if progress:
            print(f"{part.name}:", flush=True)
        if base is not None and getattr(parse(part.source).estimator, "target_cov", None) is not None:
            _take_runs_of_base(where, base.summary)
        summary = run_campaign(with_measured_of_base(part, folder), where, workers=workers, progress=progress)
        release_programs()
        if part.name != RANKED:
            counted[part.name], of_runs = _counted(where)
            unit = max(unit, of_runs)
            pf = summary.probability
            variance[part.name] = ((pf.coefficient_of_variation or 0.0) * pf.value) ** 2
        if part.name == BASE:
            base = _compared(Point(BASE, BASE, summary), where, counted, variance, unit)
        for parameter, value in part.points:
            if part.name == RANKED:
                point = Point(value, part.name, _ranked(where, int(value)))
            else:
                point = _compared(Point(value, part.name, summary), where, counted, variance, unit)
            points.setdefault(parameter, []).append(point)
    assert base is not None
    parameters = {
        parameter: rows if parameter == SCENARIO else sorted(rows, key=lambda row: row.value)
        for parameter, rows in points.items()
    }
    fragility = _fragility(parameters, counted, variance, unit)
    text = json.dumps(
        {
            "name": base.summary.name,
            "base": base.as_json(),
            "parameters": {parameter: [row.as_json() for row in rows] for parameter, rows in parameters.items()},
            "fragility": {parameter: list(map(asdict, curves)) for parameter, curves in fragility.items()},
        },
        indent=1,
    )
    write_aside(folder / "sweep.json", text.encode())
    write_aside(folder / "sweep.csv", figures.table(base, parameters).encode())
    pictures = list(figures.draw(base, parameters, fragility))
    for figure in pictures:
        save(figure.figure, own_folder(folder / "figures") / f"{figure.name}.png")
    scene = _stored_source(folder)
    assert scene is not None
    write_aside(folder / "report.html", figures.page(base, parameters, pictures, scene.words).encode())
    if progress:
        for line in figures.in_words(base, parameters, fragility).splitlines():
            print(printable(line), flush=True)
    content: Content = json.loads(text)
    return content


def _stored_source(folder: Path) -> Source | None:
    """What the sweep in a folder was made from, None where none has begun there."""
    if not all(os.path.lexists(folder / name) for name in (SWEEP, BESIDE)):
        return None
    try:
        text, beside = (files.read_plain(folder / name).decode("utf-8-sig") for name in (SWEEP, BESIDE))
    except UnicodeDecodeError as error:
        raise ValueError(f"{folder / SWEEP} is not text in UTF-8: {error}") from error
    return source_from(text, beside, str(folder / SWEEP))


def _claim(folder: Path, source: Source) -> None:
    """Make the folder, or see that it is this sweep's."""
    there = _stored_source(folder)
    if there is not None and there.tables != source.tables:
        raise ValueError(f"folder {folder} belongs to another sweep: give another folder, or the scene it has")
    if there is None and folder.exists() and any(path.name != BESIDE for path in folder.iterdir()):
        raise ValueError(f"folder {folder} is not empty, and no sweep has begun there: give a new or empty folder")
    folder.mkdir(parents=True, exist_ok=True)
    if there is None:
        # First, so that no scene is ever without what goes with it; alone it is no sweep yet.
        write_aside(folder / BESIDE, json.dumps(source.beside).encode())
        write_aside(folder / SWEEP, (source.text or "").encode())
    for name in ("campaigns", "figures"):
        own_folder(folder / name)


def _ranked(folder: Path, k_t: int) -> Summary:
    """Summary that a campaign by the published rule would have had with this k_t."""
    store = read_store(folder)
    campaign = replace(parse(store.source), estimator=Published(k_t))
    rough, refined = map(rows_reader(store, samples_of(campaign)), GRIDS)
    order = rank_samples(rough.columns["displacement"], rough.columns["broke_off"].astype(bool)).order
    ran = order[: stopping_rank(order, phases_of(campaign, rough, refined).answers, k_t)]
    ranked_rows = np.isin(refined.columns["sample"], ran)
    return summarise(campaign, rough, Rows({name: c[ranked_rows] for name, c in refined.columns.items()}, ()))


def _counted(folder: Path) -> tuple[np.ndarray, float]:
    """Failures counted at each sample of a campaign (N,), and how many samples a refined run in doubt stands for."""
    store = read_store(folder)
    campaign = campaign_of(store)
    phases = phases_of(campaign, *map(rows_reader(store, samples_of(campaign)), GRIDS))
    assert phases.failures is not None
    samples, shared = campaign.plan.samples, campaign.measured.shared
    unit = unit_of(phases.weights, samples, None if shared is None else shared.doubt)
    return by_sample(phases.failures, phases.estimate.probability, samples), unit


def _compared(
    point: Point, folder: Path, counted: Mapping[str, np.ndarray], variance: Mapping[str, float], unit: float
) -> Point:
    """A point beside the base: with the difference of P_f, the displacement, and the peak acceleration."""
    difference = None
    if point.campaign != BASE:
        both = variance[BASE], variance[point.campaign]
        difference = paired_difference(counted[BASE], counted[point.campaign], both, unit=unit)
    store = read_store(folder)
    campaign = campaign_of(store)
    rough = rows_reader(store, samples_of(campaign))("rough")
    displacement = displacement_of(rough.columns["displacement"], rough.columns["broke_off"].astype(bool))
    motion, peak = campaign.shaking, None
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
    parameters: figures.Parameters, counted: Mapping[str, np.ndarray], variance: Mapping[str, float], unit: float
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
        spread = covariance_of(z, [variance[row.campaign] for _, row in rows], unit=unit)
        levels, shares = [at for at, _ in rows], [float(values.mean()) for values in z]
        fitted = fit_fragility(levels, shares, spread, z[0].size, even=name == RECORDS)
        if fitted:
            curves[name] = fitted
    return curves
