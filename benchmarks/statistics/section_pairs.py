"""The plane-strain section with 400 samples, all run on both grids: the populations that estimators are compared on.

`python -m benchmarks.statistics.section_pairs` writes `benchmarks/data/section_pairs.csv`, with the published settings,
and `section_pairs_default.csv`, with those that a scene has by default; it goes on where it was stopped. Each sample
runs three times: on the rough grid, on the rough grid with its strength calibrated by the factors of safety, and on the
refined grid."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measure import ROOT, machine, scene_campaign
from cooperative import runs
from cooperative.scene import Calibration, Campaign, factors_of_safety
from cooperative.store import Sample

DATA = ROOT / "benchmarks" / "data"
STUDIES = {
    "published": ("paper_section", DATA / "section_pairs.csv"),
    "default": ("section", DATA / "section_pairs_default.csv"),
}
SAMPLES = 400
GRIDS = ("rough", "calibrated", "refined")
COLUMNS = ("number", *(f"{grid}_{what}" for what in ("displacement", "mode", "steps", "seconds") for grid in GRIDS))


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
    rows = list(_rows(path))
    spent = {}
    for grid in GRIDS:
        seconds, steps = (np.array([float(row[f"{grid}_{what}"]) for row in rows]) for what in ("seconds", "steps"))
        spent[grid] = steps * np.median(seconds / steps)
    return Pairs(
        {grid: np.array([float(row[f"{grid}_displacement"]) for row in rows]) for grid in GRIDS},
        {grid: np.array([row[f"{grid}_mode"] for row in rows]) for grid in GRIDS},
        spent,
        json.loads(path.read_text().splitlines()[0].removeprefix("# "))["seconds"],
    )


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open() as file:
        yield from csv.DictReader(line for line in file if not line.startswith("#"))


def study(campaign: Campaign) -> Campaign:
    """A scene with the samples of this study, all of which get a mode, as it was when its files were made."""
    campaign = replace(campaign, soil=replace(campaign.soil, gap_memory=False))
    rough, refined = (replace(campaign.grids[grid], cfl=0.5) for grid in ("rough", "refined"))
    return replace(
        campaign, rough=rough, refined=refined, plan=replace(campaign.plan, samples=SAMPLES, modes=("rough", "refined"))
    )


def main() -> None:
    """Run what is missing, one sample after the other."""
    for scene, path in STUDIES.values():
        _complete(study(scene_campaign(scene)), path)


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
    factors = Calibration(**json.loads(path.read_text().splitlines()[0].removeprefix("# "))["factors_of_safety"])
    models["calibrated"] = replace(models["rough"], strength_factor=factors.factor)
    for model in models.values():
        _run(model, coefficients, 0)  # compiles
    done = {int(row["number"]) for row in _rows(path)}
    with path.open("a") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        for number in sorted(set(range(SAMPLES)) - done):
            row: dict[str, object] = {"number": number}
            for grid in GRIDS:
                sample = _run(models[grid], coefficients, number)
                row[f"{grid}_displacement"] = f"{sample.row['displacement']:.6g}"
                row[f"{grid}_mode"] = sample.row.get("mode", "broke off")
                row[f"{grid}_steps"] = sample.steps
                row[f"{grid}_seconds"] = f"{sample.seconds:.3g}"
            writer.writerow(row)
            file.flush()


def _run(model: runs.GridModel, coefficients: np.ndarray, number: int) -> Sample:
    return next(iter(runs.run_samples(model, coefficients, [number], width=1)))


if __name__ == "__main__":
    main()
