"""What is lost and what is saved by ending a slide once its deposit rests, instead of at 20 s.

`python -m benchmarks.settings.rest` runs what benchmarks/data/rest.csv lacks: the first failures of the section's
refined grid, with published and with default settings, and of the published slope in 3D on its calibrated rough grid,
each once with the rule and once without. `python -m benchmarks rest` tells what the file holds.

Then it runs what benchmarks/data/rest_25_s.csv lacks: the slides of the section once more, without the rule and on to
25 s, measured at 20 s too. `moved_20_to_25_max_cells` is the most that a length changes in these 5 s, that is
displacement, depth or run-out; `moved_20_to_25_max_share` is that of volume and area; `moved_20_to_25_any_max_cells` is
that of displacement and run-out with detached grains. The same runs tell when the masses of progressive slides let go
(`second_release_after_max_s`), which rest.csv does not hold. All are null until the file is there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.csv_rows import ENDED, Row, appending, optional, read_rows, size, whole, word
from benchmarks.measure import ROOT, Report, scene_campaign
from benchmarks.statistics.section_pairs import study
from cooperative import runs
from cooperative.measure import SEVERITY, Motion
from cooperative.runs import GridModel
from cooperative.store import Sample
from jaxmpm import Result, Settle, State, solve_each
from jaxmpm.run import Midway

DATA = ROOT / "benchmarks" / "data" / "rest.csv"
LONGER = ROOT / "benchmarks" / "data" / "rest_25_s.csv"
LENGTHS = ("displacement", "depth", "runout")
"""Measures in metres."""
AMOUNTS = ("volume", "area")
ANY = ("displacement_any", "runout_any")
"""Lengths with detached grains."""
TIMES = (20.0, 25.0)
"""When the slides of LONGER are measured (s)."""
TWICE = tuple(f"{name}_{time:g}" for time in TIMES for name in (*LENGTHS, *AMOUNTS, *ANY))
RELEASES = ("onset", "onset_second")
"""When the first mass and, of a progressive slide, the second let go (s)."""


@dataclass(frozen=True)
class Case:
    """Slides of a scene's grid: how many, a factor on the strength, and whether they are run on to 25 s too."""

    scene: str
    grid: str
    slides: int
    factor: float = 1.0
    longer: bool = False


CASES = {
    "section, published": Case("paper_section", "refined", 50, longer=True),
    "section, default": Case("section", "refined", 50, longer=True),
    "3D, published, rough grid calibrated": Case("paper", "rough", 10, 1.18 / 1.29),
}
MODE = optional(word(*SEVERITY))
COLUMNS = {
    **{"case": word(*CASES), "rest": whole, "number": whole, "status": word(*ENDED), "steps": whole},
    **dict.fromkeys((*LENGTHS, *AMOUNTS), optional(size)),
    "mode": MODE,
}
COLUMNS_LONGER = {
    **{"case": word(*CASES), "number": whole, "status": word(*ENDED), "steps": whole},
    **dict.fromkeys(TWICE, optional(size)),
    "mode": MODE,
    **dict.fromkeys(RELEASES, optional(size)),
}


def read(path: Path) -> dict[tuple[str, bool], dict[int, Row]]:
    """The file: (case, with the rule) -> number -> row. ValueError for a row that does not parse or occurs twice."""
    answer: dict[tuple[str, bool], dict[int, Row]] = {}
    for (case, rest, sample), row in read_rows(path, COLUMNS, ("case", "rest", "number")).items():
        answer.setdefault((case, rest == 1), {})[sample] = row
    return answer


def read_longer(path: Path) -> dict[str, dict[int, Row]]:
    """The file of the slides that ran on: case -> number -> row. ValueError as for `read`."""
    answer: dict[str, dict[int, Row]] = {}
    for (case, sample), row in read_rows(path, COLUMNS_LONGER, ("case", "number")).items():
        answer.setdefault(case, {})[sample] = row
    return answer


def main() -> None:
    """Run what is missing, one slide after the other."""
    done = read(DATA)
    with appending(DATA, COLUMNS) as put:
        for name, case in CASES.items():
            with_rule, without = (set(done.get((name, rest), {})) for rest in (True, False))
            if len(with_rule) < case.slides:
                for row in _rows(name, case, with_rule, without):
                    put(row)
    slid, longer = read(DATA), read_longer(LONGER)
    with appending(LONGER, COLUMNS_LONGER) as put:
        for name, case in CASES.items():
            left = slid.get((name, True), {}).keys() - longer.get(name, {}).keys()
            if case.longer and left:
                for row in _rows_longer(name, case, sorted(left)):
                    put(row)


def prepared(case: Case) -> tuple[GridModel, np.ndarray]:
    """The model of a case, whose runs end as its scene says, and the coefficients of its samples (samples, modes)."""
    campaign = scene_campaign(case.scene)
    if case.grid == "refined":
        campaign = study(campaign)
    campaign = replace(campaign, soil=replace(campaign.soil, gap_memory=False))
    campaign = replace(campaign, plan=replace(campaign.plan, fields=(), modes=(case.grid,)))
    soil = runs.random_soil(campaign)
    model = replace(runs.build(campaign, case.grid, soil), strength_factor=case.factor)
    return model, runs.coefficients_of(campaign, soil)


def _rows(name: str, case: Case, with_rule: set[int], without: set[int]) -> Iterator[tuple[object, ...]]:
    """Sample after sample to its end under the rule; of those that slid, once more without."""
    ruled, coefficients = prepared(case)
    campaign = ruled.campaign
    unruled = replace(ruled, campaign=replace(campaign, run=replace(campaign.run, settle=Settle())))
    limit = campaign.run.failure_displacement
    slid = len(with_rule)
    for sample in range(max(with_rule, default=-1) + 1, len(coefficients)):
        if slid >= case.slides:
            break
        (first,) = runs.run_samples(ruled, coefficients, [sample], width=1, stop_at=limit)
        if float(first.row["displacement"]) <= limit:
            continue
        slid += 1
        for rest, model in ((0, unruled), (1, ruled)):
            if sample not in (with_rule if rest else without):
                (done,) = runs.run_samples(model, coefficients, [sample], width=1)
                measured = [done.row.get(each, "") for each in (*LENGTHS, *AMOUNTS, "mode")]
                yield name, rest, sample, done.status, done.steps, *measured


def _rows_longer(name: str, case: Case, samples: Sequence[int]) -> Iterator[tuple[object, ...]]:
    model, coefficients = prepared(case)
    for sample in samples:
        answer = run_on(model, coefficients, sample, TIMES)
        measured = [time.row.get(each, "") for time in answer for each in (*LENGTHS, *AMOUNTS, *ANY)]
        end = answer[-1]
        at_end = [end.row.get(each, "") for each in ("mode", *RELEASES)]
        yield name, sample, end.status, end.steps, *measured, *at_end


def followed(
    model: GridModel,
    coefficients: np.ndarray,
    t_end: float,
    settle: Settle | None,
    look: Callable[[float, State], None],
) -> tuple[Result, Motion]:
    """Run one sample.

    Args:
        model: of the grid.
        coefficients: of the sample (modes,).
        t_end: last time (s).
        settle: rule by which the run ends earlier.
        look: called now and then with the time (s) and the state.

    Returns:
        The result and the motion of the particles.
    """
    past = Motion.start(np.asarray(model.scene.particles.volume), model.campaign.run.failure_displacement)

    def observe(_: int, seconds: float, midway: Midway) -> None:
        nonlocal past
        if seconds > past.times[-1]:
            past = past.after(seconds, np.linalg.norm(np.asarray(midway.state.displacement), axis=0))
        look(seconds, midway.state)

    own = {name: [values] for name, values in model.varied(jnp.asarray(coefficients)).items()}
    ((_, result),) = solve_each(model.scene, model.state, own, width=1, t_end=t_end, settle=settle, observe=observe)
    return result, past


def run_on(
    model: GridModel, coefficients: np.ndarray, sample: int, times: tuple[float, float]
) -> tuple[Sample, Sample]:
    """A sample at the first and at the second of the times (s) of one run without the rule, the mode beside the second.
    Both are as at its last step where it breaks off."""
    first: list[State] = []

    def look(seconds: float, state: State) -> None:
        if not first and seconds >= times[0]:
            first.append(state)

    result, past = followed(model, coefficients[sample], times[1], Settle(), look)

    def sample_at(state: State, motion: Motion | None) -> Sample:
        return runs.finished(model, sample, coefficients[sample], replace(result, state=state), 0.0, motion)

    return sample_at(first[0] if first else result.state, None), sample_at(result.state, past)


def run(quick: bool) -> Report:
    """What the file holds; `quick` changes nothing, there is nothing to run."""
    del quick
    answer, longer = read(DATA), read_longer(LONGER)
    rows = [
        compared(name, case, answer[name, True], answer[name, False])
        for name, case in CASES.items()
        if (name, True) in answer and (name, False) in answer
    ]
    values: dict[str, Any] = {
        "slides": sum(row["slides"] for row in rows),
        "modes_changed": sum(row["modes_changed"] for row in rows),
        "largest_change_of_a_length_cells": max((row["largest_change_cells"] for row in rows), default=None),
        "largest_change_of_an_amount": max((row["largest_change_share"] for row in rows), default=None),
    }
    values |= {f"saved_{n}": row["steps_saved"] for n, row in enumerate(rows)}
    later = [changes_after(name, case, longer[name]) for name, case in CASES.items() if name in longer]
    return Report(values | values_after(later), [*rows, *later])


def values_after(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """The largest moves from 20 to 25 s over the cases; None without slides."""

    def largest(*names: str) -> float | None:
        return max((row[name] for row in rows for name in names if row[name] is not None), default=None)

    return {
        "moved_20_to_25_slides": sum(row["slides"] for row in rows) or None,
        "moved_20_to_25_broke_off": sum(row["broke_off"] for row in rows) if rows else None,
        "moved_20_to_25_max_cells": largest(*(f"moved_{name}_cells" for name in LENGTHS)),
        "moved_20_to_25_max_share": largest(*(f"moved_{name}_share" for name in AMOUNTS)),
        "moved_20_to_25_any_max_cells": largest(*(f"moved_{name}_cells" for name in ANY)),
        "second_release_after_max_s": largest("second_release_after_max_s"),
    }


def changes_after(name: str, case: Case, rows: Mapping[int, Row]) -> dict[str, Any]:
    """Slides that ran on: how far each measure moves from 20 to 25 s at most, lengths in cells and amounts as shares,
    and the longest time between two releases."""
    whole_runs = [row for row in rows.values() if row["mode"]]
    cell = scene_campaign(case.scene).grids[case.grid].cell
    before, after = (f"_{time:g}" for time in TIMES)

    def largest(measure: str, in_cells: bool) -> float | None:
        pairs = [(row[measure + before], row[measure + after]) for row in whole_runs]
        moves = [abs(b - a) / (cell if in_cells else max(a, 1e-9)) for a, b in pairs]
        return round(max(moves), 4) if moves else None

    gaps = [row["onset_second"] - row["onset"] for row in whole_runs if row["onset_second"] is not None]
    return {
        "case": name,
        "from_s": TIMES[0],
        "to_s": TIMES[1],
        "slides": len(rows),
        "broke_off": len(rows) - len(whole_runs),
        **{f"moved_{measure}_cells": largest(measure, True) for measure in (*LENGTHS, *ANY)},
        **{f"moved_{measure}_share": largest(measure, False) for measure in AMOUNTS},
        "progressive": sum(row["mode"] == "progressive" for row in whole_runs),
        "second_release_after_max_s": round(max(gaps), 2) if gaps else None,
    }


def compared(name: str, case: Case, ruled: dict[int, Row], unruled: dict[int, Row]) -> dict[str, Any]:
    """Slides that ran both ways: the share of steps saved, the largest change of any measure, modes that changed."""
    both = [(ruled[n], unruled[n]) for n in sorted(ruled.keys() & unruled.keys())]
    whole = [(a, b) for a, b in both if a["mode"] and b["mode"]]
    cell = scene_campaign(case.scene).grids[case.grid].cell

    def largest(measures: tuple[str, ...], scale: float | None) -> float:
        changes = [abs(a[each] - b[each]) / (scale or max(b[each], 1e-9)) for a, b in whole for each in measures]
        return round(max(changes, default=0.0), 4)

    steps = [sum(row["steps"] for row in column) for column in zip(*both, strict=True)]
    return {
        "case": name,
        "slides": len(both),
        "broke_off": len(both) - len(whole),
        "progressive": sum(b["mode"] == "progressive" for _, b in both),
        "at_rest": sum(a["status"] == "SETTLED" for a, _ in both),
        "steps_saved": round(1 - steps[0] / steps[1], 4),
        "largest_change_cells": largest(LENGTHS, cell),
        "largest_change_share": largest(AMOUNTS, None),
        "modes_changed": sum(a["mode"] != b["mode"] for a, b in whole),
    }


if __name__ == "__main__":
    main()
