"""Fully refined populations with what their slides brought over each column of cells, for
`benchmarks.statistics.hazard`.

`python -m benchmarks.statistics.hazard_populations` writes `benchmarks/data/hazard_section.npz`, the 400 sections of
`benchmarks.statistics.section_pairs` with the published settings, and `hazard_solid.npz`, a small slope in 3D on two
cheap grids. It goes on where it was stopped, with the runs stored in `out/hazard`. Of the sections only those run
that the file of pairs calls failed, for 12 s at CFL 0.9, which changes no class; what stands brings nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, scene_campaign
from benchmarks.statistics.section_pairs import DATA, SAMPLES, read
from cooperative import runs
from cooperative.scene import Campaign, Hazard, parse
from cooperative.store import FinishedRun

STORED = ROOT / "out" / "hazard"
LIMIT = 1.0
SLID = 12.0
"""Seconds after which a slide of the section has gone 99 per cent of its way."""
SOLID = """
name = "a small slope in 3D, on cheap grids"
[slope]
crest = 6.0
height = 6.0
run_per_rise = 1.0
toe = 12.0
foundation = 2.0
width = 16.0
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
softening_modulus = 85e3
residual_ratio = 0.5
tension_cutoff = 0.0
[strength]
mean = 24e3
cov = 0.4
length = [20.0, 8.0, 4.0]
energy = 0.95
[rough]
cell = 2.0
spacing = [1.0, 2.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 1.0, 0.5]
[run]
t_end = 6.0
[campaign]
samples = 300
seed = 7
[hazard]
"""
NUMBERS = ("displacement", "area", "area_columns", "volume")


@dataclass(frozen=True)
class Population:
    """Samples that all ran refined. rough, refined: largest displacement (N,) m. numbers: name -> (N,), 0 of those that
    stand. columns: name -> (N, ...), as a sample keeps them, 0 of those that stand. least: thickness from which on soil
    counts as there (m). plan area of a column: `cell_area`. beyond: first column along x beyond the toe."""

    rough: np.ndarray
    refined: np.ndarray
    numbers: dict[str, np.ndarray]
    columns: dict[str, np.ndarray]
    least: float
    cell_area: float
    beyond: int

    @property
    def fails(self) -> np.ndarray:
        """Which samples fail (N,) bool."""
        return self.refined > LIMIT


def path_of(name: str) -> Path:
    """Data file of a population, "section" or "solid"."""
    return DATA / f"hazard_{name}.npz"


def population(name: str) -> Population:
    """A population from its data file."""
    with np.load(path_of(name), allow_pickle=False) as file:
        stored = {key: file[key] for key in file.files}
    fails = stored["refined"] > LIMIT

    def spread(values: np.ndarray) -> np.ndarray:
        whole = np.zeros((fails.size, *values.shape[1:]))
        whole[fails] = values
        return whole

    return Population(
        rough=stored["rough"],
        refined=stored["refined"],
        numbers={key: spread(stored[key]) for key in NUMBERS},
        columns={key: spread(stored[key].astype(float)) for key in runs.COLUMNS},
        least=float(stored["least"]),
        cell_area=float(stored["cell_area"]),
        beyond=int(stored["beyond"]),
    )


def campaign_of(name: str) -> Campaign:
    """What makes a population."""
    if name == "solid":
        return parse(SOLID)
    campaign = scene_campaign("paper_section")
    plan, run = replace(campaign.plan, samples=SAMPLES), replace(campaign.run, t_end=SLID)
    return replace(campaign, plan=plan, run=run, hazard=Hazard(("0.5 m", "1 m", "1 m/s"), 20))


def _run(name: str, model: runs.GridModel, coefficients: np.ndarray, numbers: np.ndarray) -> Iterator[FinishedRun]:
    """The samples of a population with these numbers, run unless they are stored."""
    for number in numbers.tolist():
        stored = STORED / f"{name}-{model.grid}-{number}.npz"
        if stored.exists():
            with np.load(stored, allow_pickle=False) as file:
                row = {key: float(file[key]) for key in file.files if key not in runs.COLUMNS}
                fields = {key: file[key] for key in file.files if key in runs.COLUMNS}
            yield FinishedRun(number, "", 0, 0.0, np.zeros(0), row, fields)
            continue
        sample = next(iter(runs.run_samples(model, coefficients, [number], width=1)))
        numbers_of = {key: value for key, value in sample.row.items() if not isinstance(value, str)}
        columns = {key: values for key, values in sample.fields.items() if key in runs.COLUMNS}
        np.savez(stored, **numbers_of, **columns)  # type: ignore[arg-type]
        yield sample


def make(name: str) -> None:
    """Run what is missing of a population, and write its file."""
    STORED.mkdir(parents=True, exist_ok=True)
    campaign = campaign_of(name)
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    refined = runs.build(campaign, "refined", soil)
    if name == "solid":
        every = np.arange(campaign.plan.samples)
        rough = runs.build(campaign, "rough", soil)
        pairs = [
            np.array([float(sample.row["displacement"]) for sample in _run(name, model, coefficients, every)])
            for model in (rough, refined)
        ]
    else:
        pairs = [read("published").displacement[grid] for grid in ("rough", "refined")]
    slides = list(_run(name, refined, coefficients, np.flatnonzero(pairs[1] > LIMIT)))
    # Runs that broke off while they slid have no end; the population does without these samples.
    lost = [slide.number for slide in slides if slide.row["broke_off"]]
    slides = [slide for slide in slides if slide.number not in lost]
    pairs = [np.delete(displacement, lost) for displacement in pairs]
    plan = refined.columns
    columns = refined.state.columns
    assert columns is not None
    stored: dict[str, Any] = {"rough": pairs[0], "refined": pairs[1], "least": columns.least, "cell_area": plan.area}
    stored |= {"beyond": plan.beyond(refined.campaign.site.shape.face).start}
    stored |= {key: np.array([float(slide.row[key]) for slide in slides]) for key in NUMBERS}
    stored |= {key: np.stack([slide.fields[key] for slide in slides]).astype(np.float16) for key in runs.COLUMNS}
    np.savez_compressed(path_of(name), **stored)


if __name__ == "__main__":
    for name in ("section", "solid"):
        make(name)
