"""What a cutoff that remembers the gap it has opened (`gap_memory`) does to classes, slides and soil thrown out.

`python -m benchmarks.settings.opened_soil` runs what benchmarks/data/opened_soil.csv lacks, one run after the other;
`python -m benchmarks opened_soil` summarises what the file holds. Every run with memory stands beside the same
one without: of the section both are there, of the slope in 3D the runs without are the study's, the four that left the
grid among them. `closed` is the volume that had opened at the end of some quarter of a second and was closed again at
the end of the run (m3, of a section m2): where there is less than `FEW` of the volume that slides, nothing counts as
closed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.csv_rows import ENDED, appending, optional, read_rows, size, whole, word
from benchmarks.measure import ROOT, Report
from benchmarks.study.cases import CASES as STUDY_CASES
from benchmarks.study.cases import FAILS_ABOVE, FAST, Changes, campaign_of
from benchmarks.study.rows import Rows, Run, read_study
from cooperative import runs
from cooperative.measure import MEASURES, SEVERITY, ReleaseHistory
from cooperative.runs import GridModel
from cooperative.scene import Campaign
from cooperative.store import FinishedRun
from jaxmpm import Result, State, Status, diagnostics, solve_each
from jaxmpm.run import Hooks, Midway, Rule

DATA = ROOT / "benchmarks" / "data" / "opened_soil.csv"
LENGTHS = ("displacement", "runout")
MEASURED = (*MEASURES, "runout_foremost")
LEFT = (94, 623, 661, 243)
"""Samples of the study whose refined slides left the grid."""
OTHERS = (135, 349, 188, 102, 696, 737, 86, 212, 363, 176)
"""Ten others of its refined slides, six progressive ones among them."""
CALIBRATED = 1.093
"""What the study divides the strength on the rough grid by."""
ANEW = {"campaign": {"seed": 2025}}
FEW = 1e-3
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Case:
    """Runs of a scene's grid. changes: of the scene. samples: their numbers, or the first so many. study: the case of
    the study whose slides have these numbers and are the runs without memory; None where they are run here."""

    scene: str
    changes: Changes
    grid: str
    samples: tuple[int, ...] | int
    study: str | None = None
    reduction: float = 1.0

    def numbers(self) -> list[int]:
        """Of the samples."""
        if not isinstance(self.samples, int):
            return list(self.samples)
        return list(range(self.samples)) if self.study is None else sorted(self.stored())[: self.samples]

    def stored(self) -> dict[int, Row]:
        """Slides of the study without memory, by sample."""
        return {
            run.sample: vars(outcome)
            for run, outcome in _study().items()
            if run == Run(str(self.study), self.grid, run.sample, self.reduction, "end")
        }


@cache
def _study() -> Rows:
    return read_study()


def _of_study(name: str, grid: str, samples: tuple[int, ...] | int, reduction: float = 1.0) -> Case:
    case = STUDY_CASES[name]
    return Case(case["scene"], case["changes"], grid, samples, name, reduction)


CASES = {
    "section, published": Case("paper_section", FAST, "refined", 100),
    "section, default": Case("section", FAST, "refined", 100),
    "3D, refined, left the grid": _of_study("published", "refined", LEFT),
    **{
        f"3D, calibrated, {name}": _of_study(name, "rough", slides, CALIBRATED)
        for name, slides in (("lx = ly = 60", 53), ("lx = 120", 54), ("lx = 30", 54), ("ly = 120", 39))
    },
    "section, published, other samples": Case("paper_section", {**FAST, **ANEW}, "refined", 100),
    "section, default, other samples": Case("section", {**FAST, **ANEW}, "refined", 100),
    "3D, refined, others": _of_study("published", "refined", OTHERS),
}
"""In the order in which they are run."""
COLUMNS = {
    **{"case": word(*CASES), "memory": whole, "number": whole, "status": word(*ENDED), "steps": whole},
    **dict.fromkeys(MEASURED, optional(size)),
    **{"mode": optional(word(*SEVERITY, "none")), "closed": optional(size)},
}


def read(path: Path) -> dict[tuple[str, bool], dict[int, Row]]:
    """The file: (case, with memory) -> number -> row. ValueError for a row that does not parse or occurs twice."""
    answer: dict[tuple[str, bool], dict[int, Row]] = {}
    for (case, memory, sample), row in read_rows(path, COLUMNS, ("case", "memory", "number")).items():
        answer.setdefault((case, memory == 1), {})[sample] = row
    return answer


def main() -> None:
    """Run what the file lacks, one run after the other."""
    done = read(DATA)
    with appending(DATA, COLUMNS) as put:
        for name, case in CASES.items():
            ways = (True, False) if case.study is None else (True,)
            missing = [(n, way) for n in case.numbers() for way in ways if n not in done.get((name, way), {})]
            models = cache(partial(_model, case))
            for sample, memory in missing:
                answer, closed = run_watched(models(memory), sample)
                measured = (_cell(answer.row.get(measure)) for measure in (*MEASURED, "mode"))
                put((name, int(memory), sample, answer.status, answer.steps, *measured, closed))


def campaign_of_case(case: Case, memory: bool) -> Campaign:
    """The campaign of a case. memory: whether its soil has one of the gap."""
    campaign = campaign_of(case.scene, {**case.changes, "soil": {"gap_memory": memory}})
    return replace(campaign, plan=replace(campaign.plan, fields=(), modes=("rough", "refined")))


def _model(case: Case, memory: bool) -> GridModel:
    campaign = campaign_of_case(case, memory)
    return replace(runs.build(campaign, case.grid, runs.random_soil(campaign)), strength_factor=1 / case.reduction)


def _cell(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else "" if value is None else value


def followed(
    model: GridModel,
    coefficients: np.ndarray,
    t_end: float,
    rules: Sequence[Rule],
    on_state: Callable[[float, State], None],
) -> tuple[Result, ReleaseHistory]:
    """Run one sample.

    Args:
        model: of the grid.
        coefficients: of the sample (modes,).
        t_end: last time (s).
        rules: by which the run ends earlier.
        on_state: called now and then with the time (s) and the state.

    Returns:
        The result and the motion of the particles.
    """
    past = ReleaseHistory.start(np.asarray(model.scene.particles.volume), model.campaign.run.failure_displacement)

    def observe(_: int, seconds: float, midway: Midway) -> None:
        nonlocal past
        if seconds > past.times[-1]:
            past = past.after(seconds, diagnostics.displacement(midway.state))
        on_state(seconds, midway.state)

    values_of_soil = {name: [values] for name, values in model.varied(jnp.asarray(coefficients)).items()}
    ((_, result),) = solve_each(
        model.scene, model.state, values_of_soil, width=1, t_end=t_end, rules=rules, hooks=Hooks(observe=observe)
    )
    return result, past


def run_watched(model: GridModel, sample: int) -> tuple[FinishedRun, str]:
    """A sample's run to its end, and the volume that it opened and closed again, nothing without memory."""
    coefficients = runs.coefficients_of(model.campaign, model.soil)[sample]
    volume, run = np.asarray(model.scene.particles.volume), model.campaign.run
    widest = model.state.gap

    def record_gap(_: float, state: State) -> None:
        nonlocal widest
        if widest is not None and state.gap is not None:
            widest = jnp.maximum(widest, state.gap)

    result, past = followed(model, coefficients, run.t_end, run.rules(), record_gap)
    answer = runs.finished_run(model, sample, coefficients, result, 0.0, past)
    if widest is None:
        return answer, ""
    most, end = (np.exp(np.asarray(gap, float)) for gap in (widest, result.state.gap))
    return answer, f"{np.sum(volume * (most - end)):.6g}"


def compared(name: str, case: Case, remembers: Mapping[int, Row], forgets: Mapping[int, Row]) -> dict[str, Any]:
    """Runs with memory beside the same ones without: what broke off, classes that changed, and by how many cells the
    lengths of slides changed, where no opened soil closed again and where some did."""
    both = [(remembers[n], forgets[n]) for n in sorted(remembers.keys() & forgets.keys())]
    slid = [(new, old) for new, old in both if None not in (new["runout"], old["runout"])]
    chosen = [(new, old) for new, old in slid if _fails(new) and _fails(old)]
    cell = campaign_of(case.scene, case.changes).grids[case.grid].cell
    changes = {
        closed: np.array(
            [
                max(abs(new[length] - old[length]) / cell for length in LENGTHS)
                for new, old in chosen
                if (new["closed"] > FEW * new["volume"]) == closed
            ]
        )
        for closed in (False, True)
    }

    def broke_off(rows: list[Row]) -> int:
        return sum(Status[row["status"]] > Status.DECIDED for row in rows)

    figures = {
        "case": name,
        "runs": len(both),
        "broke_off_without": broke_off([old for _, old in both]),
        "broke_off_with": broke_off([new for new, _ in both]),
        "fail": sum(_fails(new) for new, _ in both),
        "classes_changed": sum(_fails(new) != _fails(old) for new, old in both),
        "modes_changed": sum(new["mode"] != old["mode"] for new, old in chosen),
        "steps_over_those_without": round(
            sum(new["steps"] for new, _ in chosen) / max(1, sum(old["steps"] for _, old in chosen)), 3
        ),
    }
    for closed, words in ((False, "nothing_closes"), (True, "soil_closes")):
        answer = changes[closed]
        figures |= {
            f"slides_{words}": answer.size,
            f"median_change_{words}_cells": round(float(np.median(answer)), 4) if answer.size else None,
            f"largest_change_{words}_cells": round(float(answer.max()), 4) if answer.size else None,
        }
    for name in ("runout", "runout_foremost"):
        grows = [new[name] - old[name] for new, old in chosen]
        figures[f"median_{name}_grows_by_m"] = round(float(np.median(grows)), 3) if grows else None
    return figures


def _fails(row: Row) -> bool:
    return bool(row["displacement"] > FAILS_ABOVE)


def run(quick: bool) -> Report:
    """What the file holds; `quick` changes nothing, there is nothing to run."""
    del quick
    answer = read(DATA)
    rows = [
        compared(name, case, answer[name, True], answer.get((name, False), {}) if case.study is None else case.stored())
        for name, case in CASES.items()
        if (name, True) in answer
    ]

    def total(name: str) -> int:
        return sum(row[name] for row in rows)

    def largest(name: str) -> float | None:
        return max((row[name] for row in rows if row[name] is not None), default=None)

    names = ("runs", "fail", "broke_off_without", "broke_off_with", "classes_changed", "modes_changed")
    return Report(
        {
            **{name: total(name) for name in names},
            "slides_nothing_closes": total("slides_nothing_closes"),
            "median_change_nothing_closes_cells": largest("median_change_nothing_closes_cells"),
            "slides_soil_closes": total("slides_soil_closes"),
            "median_change_soil_closes_cells": largest("median_change_soil_closes_cells"),
            "largest_change_soil_closes_cells": largest("largest_change_soil_closes_cells"),
        },
        rows,
    )


if __name__ == "__main__":
    main()
