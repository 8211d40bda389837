"""What a person sees of a campaign: its figures and its summary in words, read from the folder alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cooperative import campaign, plots, screening
from cooperative.config import Config, parse
from cooperative.store import Rows, Store, read_rows, read_sample, read_store

MEASURES = {
    "displacement": "largest displacement $R_d$ [m]",
    "depth": "sliding depth $H$ [m]",
    "runout": "run-out $L$ [m]",
    "volume": "sliding volume $V$",
    "area": "influence area $S$",
}


def report(folder: str | Path) -> str:
    """Draw the figures of a campaign into `figures/` of its folder and return its summary in words.

    Raises ValueError where the folder holds no campaign, or none with a finished sample.
    """
    store = read_store(folder)
    config = parse(store.scene_text)
    rough, refined = read_rows(store, "rough"), read_rows(store, "refined")
    if not rough.numbers:
        raise ValueError(f"folder {folder} has no finished sample yet: start the run first")
    target = Path(folder) / "figures"
    target.mkdir(exist_ok=True)
    for name, figure in figures(config, store, rough, refined).items():
        plots.save(figure, target / f"{name}.png")
    return words(campaign.summarise(config, rough, refined), target)


def figures(config: Config, store: Store, rough: Rows, refined: Rows) -> dict[str, Any]:
    """The figures by file name."""
    drawn = {"ranked": _ranked(config, rough, refined)}
    worst = _worst(refined if refined.numbers else rough)
    expansion = screening.expansion_of(config)
    models = {grid: screening.build(config, grid, expansion) for grid in ("rough", "refined")}
    sample = read_sample(store, "refined" if refined.numbers else "rough", worst)
    planes = {grid: _plane(model, sample) for grid, model in models.items()}
    drawn["field"] = plots.strength_fields(
        {grid: (_section(models[grid], planes[grid]), _half(models[grid])) for grid in models},
        {grid: np.asarray(model.strength(sample.coefficients), float)[planes[grid]] for grid, model in models.items()},
    )
    if {"displacement", "plastic_strain"} <= sample.fields.keys():
        model, plane = models["refined"], planes["refined"]
        moved = sample.fields["displacement"][[0, -1]][:, plane]
        drawn["slope"] = plots.before_and_after(
            _section(model, plane), moved, sample.fields["plastic_strain"][plane], _half(model)
        )
    failures = np.asarray([answer is True for answer in campaign.refined_answers(config, refined).values()], bool)
    if failures.any():
        per = " [m$^3$]" if config.slope.dimension == 3 else " [m$^2$]"
        labels = MEASURES | {
            "volume": MEASURES["volume"] + (per if config.slope.dimension == 3 else " [m$^3$/m]"),
            "area": MEASURES["area"] + (" [m$^2$]" if config.slope.dimension == 3 else " [m$^2$/m]"),
        }
        drawn["consequences"] = plots.histograms({name: refined.columns[name][failures] for name in MEASURES}, labels)
    return drawn


def words(summary: dict[str, Any], figures_folder: Path) -> str:
    """The summary for people."""
    low, high = summary["interval"]
    lines = [
        f"{summary['name']}",
        f"  probability of failure  {summary['probability_of_failure']:.3f}  "
        f"({summary['level']:.0%} interval {low:.3f} to {high:.3f}; {summary['estimator']})",
        f"  rough grid     {summary['samples']} samples, {summary['failures_rough']} beyond the failure displacement, "
        f"{summary['seconds']['rough']:.0f} s",
        f"  refined grid   {summary['refined_runs']} runs, {summary['failures_refined']} failures, "
        f"{summary['seconds']['refined']:.0f} s",
    ]
    for method, other in summary["other_estimates"].items():
        low, high = other["interval"]
        lines.insert(2, f"  beside it: {method:<14} {other['probability']:.3f}  ({low:.3f} to {high:.3f})")
    for name, spread in summary["consequences_of_failures"].items():
        if spread:
            lines.append(
                f"  {name:<13}  mean {spread['mean']:.4g}, {spread['smallest']:.4g} to {spread['largest']:.4g} "
                f"({_UNITS[name]}, failed samples)"
            )
    for grid, broken in summary["broke_off"].items():
        for number, why in broken.items():
            lines.append(f"  BROKE OFF      sample {number} on the {grid} grid: {why}")
    lines += [f"  note: {note}" for note in summary["notes"]]
    return "\n".join([*lines, f"  figures in {figures_folder}"])


_UNITS = {
    "displacement": "m",
    "depth": "m below the crest",
    "runout": "m beyond the toe",
    "volume": "m3, per metre of width in a section",
    "area": "m2 beyond the toe, per metre of width in a section",
}


def _ranked(config: Config, rough: Rows, refined: Rows) -> Any:
    """Both displacements of every sample."""
    both = {number: i for i, number in enumerate(rough.numbers)}
    second = np.full(len(rough.numbers), np.nan)
    for number, value in zip(refined.numbers, refined.columns.get("displacement", ()), strict=True):
        second[both[number]] = value
    first = np.where(rough.columns["broke_off"].astype(bool), np.nan, rough.columns["displacement"])
    return plots.ranked_displacements({"rough": first, "refined": second}, threshold=config.run.failure_displacement)


def _worst(rows: Rows) -> int:
    return rows.numbers[int(np.argmax(rows.columns["displacement"]))]


def _plane(model: screening.GridModel, sample: Any) -> np.ndarray:
    """Particles (N,) of the section to draw: all of them in 2D, in 3D the slice that moved farthest."""
    position = np.asarray(model.scene.particles.position)
    if len(position) == 2:
        return np.ones(position.shape[1], bool)
    width, half = model.config.slope.width or 0.0, model.half_size[1]
    centre = width / 2
    moved = sample.fields.get("displacement")
    if moved is not None and moved.shape == position.shape:
        centre = float(position[1, np.argmax(np.linalg.norm(moved, axis=0))])
    nearest = position[1, np.argmin(np.abs(position[1] - centre))]
    return np.abs(position[1] - nearest) < half


def _section(model: screening.GridModel, plane: np.ndarray) -> np.ndarray:
    return np.asarray(model.scene.particles.position, float)[[0, -1]][:, plane]


def _half(model: screening.GridModel) -> np.ndarray:
    return model.half_size[[0, -1]]
