"""Runs behind `benchmarks.settings.early`: each until its class is known, with what the early rule decides on the way.

`python -m benchmarks.settings.early_runs [CASE COUNT]` runs what its file lacks, as a campaign does when classes alone
are asked for. The rule looks on after each chunk of steps and ends nothing, so one run gives both answers.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.csv_rows import ENDED, Parser, appending, number, read_rows, whole, word
from benchmarks.measure import ROOT, scene_campaign
from cooperative import runs
from jaxmpm import Scene, State, Status, solve_each
from jaxmpm.run import Early, Hooks, Midway
from jaxmpm.run._early import START, measures
from jaxmpm.run._stopping import farthest

DATA = ROOT / "benchmarks" / "data" / "early.csv"


@dataclass(frozen=True)
class Case:
    """scene: of benchmarks/scenes. samples: to run. chosen_on: the first of them, on which the rule was chosen (with
    default settings when clay had F-bar)."""

    scene: str
    grid: str
    samples: int
    chosen_on: int = 0


CASES = {
    "section, rough": Case("paper_section", "rough", 400, 400),
    "section, refined": Case("paper_section", "refined", 400, 43),
    "section, default, rough": Case("section", "rough", 400),
    "section, default, refined": Case("section", "refined", 400, 336),
    "layers, rough": Case("new/section", "rough", 200),
    "layers, refined": Case("new/section", "refined", 200),
    "3D, rough": Case("paper", "rough", 300, 30),
    "3D, default, rough": Case("slope", "rough", 200, 20),
    "3D, refined": Case("paper", "refined", 30),
    "3D, default, refined": Case("slope", "refined", 30),
}
MEASURED = ("steps", "time", "displacement", "early_time", "early_displacement")
COLUMNS: dict[str, Parser] = {
    "case": word(*CASES),
    "number": whole,
    "status": word(*ENDED),
    "early_status": word(*ENDED),
    **dict.fromkeys(MEASURED, number),
}


@dataclass(frozen=True)
class Run:
    """A run: its end by the rules of before, and by the early one. The early displacement is the projected one of a
    sample that fails."""

    status: str
    early_status: str
    steps: float
    time: float
    displacement: float
    early_time: float
    early_displacement: float


def read() -> dict[str, dict[int, Run]]:
    """The file: case -> number -> run. ValueError for a line that does not parse, or whose run stands there twice."""
    answer: dict[str, dict[int, Run]] = {}
    for (case, sample), row in read_rows(DATA, COLUMNS, ("case", "number")).items():
        if row["early_time"] > row["time"]:
            raise ValueError(f"{DATA.name}: {case} {sample}: early_time is after the end of the run: delete the line")
        answer.setdefault(case, {})[sample] = Run(**{name: row[name] for name in ("status", "early_status", *MEASURED)})
    return answer


class Watched:
    """What the early rule decides about runs that go on.

    early: the rule. limit: displacement of a failure (m).
    """

    def __init__(self, scene: Scene, early: Early, limit: float, least_volume: float | None) -> None:
        self.scene, self.early, self.limit, self.least_volume = scene, early, limit, least_volume
        self.memory: dict[int, tuple[np.ndarray, float]] = {}
        self.decided: dict[int, tuple[str, float, float]] = {}

    def observe(self, sample: int, seconds: float, midway: Midway) -> None:
        """Look at a run after a chunk of steps."""
        memory, before = self.memory.get(sample, (START, 0.0))
        strain, half_period = map(np.asarray, _measures(self.scene, midway.state))
        displacement = np.asarray(farthest(self.scene, midway.state, None, self.least_volume))
        memory, stands, speeds_up = self.early.judged(memory, seconds - before, half_period, strain, displacement)
        self.memory[sample] = memory, seconds
        projected = float(self.early.projected(displacement, np.asarray(seconds)))
        if sample in self.decided or int(midway.state.status) != Status.RUNNING:
            return
        if stands:
            self.decided[sample] = Status.SETTLED.name, seconds, float(displacement)
        elif speeds_up and projected > self.limit:
            self.decided[sample] = Status.DECIDED.name, seconds, projected


@jax.jit
def _measures(scene: Scene, state: State) -> tuple[jax.Array, jax.Array]:
    return measures(scene, state)


def main(name: str | None = None, count: int | None = None) -> None:
    """Run what is missing of one case or all, up to so many samples."""
    done = read()
    with appending(DATA, COLUMNS) as put:
        for case in CASES if name is None else [name]:
            numbers = range(min(CASES[case].samples, count or CASES[case].samples))
            for row in _rows(CASES[case], sorted(set(numbers) - done.get(case, {}).keys())):
                put((case, *row))


def _rows(case: Case, numbers: list[int]) -> Iterator[tuple[object, ...]]:
    if not numbers:
        return
    campaign = scene_campaign(case.scene)
    campaign = replace(campaign, plan=replace(campaign.plan, samples=case.samples))
    soil, run = runs.random_soil(campaign), campaign.run
    model = runs.build(campaign, case.grid, soil)
    coefficients = runs.coefficients_of(campaign, soil)
    watched = Watched(
        model.scene, Early(run.t_end, run.failure_displacement), run.failure_displacement, campaign.failing_volume
    )
    strengths = (model.varied(jnp.asarray(coefficients[sample]))["strength"] for sample in numbers)
    rules = replace(campaign, run=replace(run, early=False)).rules(run.failure_displacement)
    for sample, result in solve_each(
        model.scene, model.state, {"strength": strengths}, numbers=numbers, width=1, t_end=run.t_end, rules=rules,
        hooks=Hooks(observe=watched.observe),
    ):  # fmt: skip
        displacement = float(farthest(model.scene, result.state, None, campaign.failing_volume))
        steps, status = int(result.state.step), Status(int(result.status)).name
        time = steps * float(result.time_step)
        early = watched.decided.get(sample, (status, time, displacement))
        values = (steps, time, displacement, *early[1:])
        yield (sample, status, early[0], *(f"{value:.6g}" for value in values))


if __name__ == "__main__":
    main(sys.argv[1] if sys.argv[1:] else None, int(sys.argv[2]) if sys.argv[2:] else None)
