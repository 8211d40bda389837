"""The plane-strain section with 400 samples, all run on both grids: the populations that estimators are compared on.

`python -m benchmarks.statistics.section_pairs` writes `benchmarks/data/section_pairs.csv`, with the published settings,
and `section_pairs_default.csv`, with those that a scene has by default; it goes on where it was stopped. Each sample
runs three times: on the rough grid, on the rough grid with its strength calibrated by the factors of safety, and on the
refined grid."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.csv_rows import Row, appending, head, read_rows, size, text, whole
from benchmarks.measure import ROOT, machine, scene_campaign
from benchmarks.study.cases import campaign_of
from cooperative import runs
from cooperative.scene import Calibration, Campaign, factors_of_safety
from cooperative.store import FinishedRun

DATA = ROOT / "benchmarks" / "data"
STUDIES = {
    "published": ("paper_section", DATA / "section_pairs.csv"),
    "default": ("section", DATA / "section_pairs_default.csv"),
}
SAMPLES = 400
GRIDS = ("rough", "calibrated", "refined")
MEASURED = {"displacement": size, "mode": text, "steps": whole, "seconds": size}
COLUMNS = {"number": whole, **{f"{grid}_{what}": parse for what, parse in MEASURED.items() for grid in GRIDS}}


@dataclass(frozen=True)
class Pairs:
    """The population, by grid ("rough", "calibrated", "refined"): largest displacements (N,) m, modes (N,), seconds of
    each run (N,), and the seconds that measuring the factors of safety took. The seconds of a run are its steps times
    the grid's median time per step, so that other work on the machine does not show in one run more than in another."""

    displacement: dict[str, np.ndarray]
    mode: dict[str, np.ndarray]
    seconds: dict[str, np.ndarray]
    calibration_seconds: float


def read(of: str = "published") -> Pairs:
    """The data file of a study."""
    path = STUDIES[of][1]
    rows = _rows(path).values()
    displacement, mode, steps, seconds = (
        {grid: np.array([row[f"{grid}_{what}"] for row in rows]) for grid in GRIDS} for what in MEASURED
    )
    spent = {grid: steps[grid] * np.median(seconds[grid] / steps[grid]) for grid in GRIDS}
    return Pairs(displacement, mode, spent, head(path)["seconds"])


def _rows(path: Path) -> dict[tuple[Any, ...], Row]:
    return read_rows(path, COLUMNS, ("number",), comments=2)


def study(scene: str) -> Campaign:
    """A scene with the samples of this study, all of which get a mode.

    The scene with published settings has those of the study. Any particle counts as a failure.
    """
    campaign = campaign_of(scene, {}) if scene == STUDIES["published"][0] else scene_campaign(scene)
    plan = replace(campaign.plan, samples=SAMPLES, modes=("rough", "refined"))
    return replace(campaign, plan=plan, run=replace(campaign.run, least_volume=0.0))


def main() -> None:
    """Run what is missing, one sample after the other."""
    for scene, path in STUDIES.values():
        _complete(study(scene), path)


def _complete(campaign: Campaign, path: Path) -> None:
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    models = {grid: runs.build(campaign, grid, soil) for grid in ("rough", "refined")}
    if not path.exists():
        clock, here = time.perf_counter(), machine()
        factors = factors_of_safety(campaign, models)
        seconds = round(time.perf_counter() - clock, 1)
        path.write_text(
            f"# {json.dumps({'factors_of_safety': vars(factors), 'seconds': seconds})}\n"
            f"# displacement in m, seconds of one process on {here['processor']}, {here['versions']}\n"
            f"{','.join(COLUMNS)}\n"
        )
    factors = Calibration(**head(path)["factors_of_safety"])
    models["calibrated"] = replace(models["rough"], strength_factor=factors.factor)
    for model in models.values():
        _run(model, coefficients, 0)  # compiles
    done = {number for (number,) in _rows(path)}
    with appending(path, COLUMNS) as put:
        for number in sorted(set(range(SAMPLES)) - done):
            samples = [_run(models[grid], coefficients, number) for grid in GRIDS]
            measured = [
                (
                    f"{sample.row['displacement']:.6g}",
                    sample.row.get("mode", "broke off"),
                    sample.steps,
                    f"{sample.seconds:.3g}",
                )
                for sample in samples
            ]
            put((number, *chain(*zip(*measured, strict=True))))


def _run(model: runs.GridModel, coefficients: np.ndarray, number: int) -> FinishedRun:
    return next(iter(runs.run_samples(model, coefficients, [number], width=1)))


if __name__ == "__main__":
    main()
