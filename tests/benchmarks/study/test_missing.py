"""Runs that are added to the study."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from benchmarks.study import cases, factors, missing
from benchmarks.study.rows import Outcome, Run, factor_of_safety, read_study, read_table
from cooperative import build, random_soil
from cooperative.runs import Stopped
from jaxmpm import reduced, solve

TINY: dict[str, dict[str, Any]] = {
    "slope": {"width": 8.0},
    "strength": {"mean": 20e3, "cov": 0.0, "length": [60.0, 60.0, 2.0]},
}
TINY |= {"run": {"t_end": 4.0}} | {grid: {"cell": 4.0, "spacing": [2.0] * 3} for grid in ("rough", "refined")}
CLASS = Outcome("DECIDED", 1.1, 2.0, 300, 1.0)
STOOD = Outcome("SETTLED", 0.1, 4.0, 600, 1.0)
BROKE_OFF = Outcome("OUTSIDE_GRID", 3.0, 4.0, 600, 1.0)
GRIDS = ("rough", "refined")
SLID = Outcome("FINISHED", 4.5, 4.0, 540, 13.6, 2.5, 3.0, 14.0, 1216.0, 12.9, "deep", 1, 2.1, None, 4.5, 3.0)


@pytest.fixture
def few_cases(monkeypatch):
    """A slope without and one with a random field, four samples of which two are refined."""
    known = {name: cases.CASES[name] for name in (factors.DEFAULT, "default", "ly = 10", "lx = ly = 60")}
    monkeypatch.setattr(missing, "CASES", known)
    monkeypatch.setattr(missing, "SWEEP_SAMPLES", 4)
    monkeypatch.setattr(missing, "SWEEP_AUDIT", replace(cases.SWEEP_AUDIT, runs=2, first_wave=2))


def run_all(fails, rows):
    """The runs that a study with these rows lacks, in order. fails: whether a run does."""
    asked = []
    while run := next((run for run in missing.missing_runs(rows) if run not in rows), None):
        asked.append(run)
        rows[run] = CLASS if fails(run) else STOOD
    return asked


def test_what_is_missing_is_searched_ranked_audited_and_slid(few_cases):
    rows = {
        Run("lx = ly = 60", "refined", 7): CLASS,
        Run("ly = 10", "refined", 8): CLASS,
        Run("ly = 10", "refined", 9): STOOD,
        Run("ly = 10", "rough", 5, 1.1): CLASS,
        Run("ly = 10", "rough", 6, 1.1): STOOD,
    }
    asked = run_all(lambda run: run.reduction > 1.135 or run.sample in (1, 2), rows)
    tried = {
        grid: [run.reduction for run in asked if (run.case, run.grid) == (factors.DEFAULT, grid)] for grid in GRIDS
    }
    assert tried["rough"] == [1.3, 1.14, 1.06, 1.1, 1.12, 1.13]
    assert tried["refined"] == [*tried["rough"], 1.14]
    assert factor_of_safety(rows, factors.DEFAULT, "refined") == 1.14
    of_samples = [run for run in asked if run.case == "default"]
    assert [run.sample for run in of_samples if run.grid == "rough"] == [0, 1, 2, 3]
    assert len({run.sample for run in of_samples if run.grid == "refined"}) == 2
    assert [run for run in asked if run.until == "end"] == [
        Run(factors.DEFAULT, "refined", 0, 1.14, "end"),
        Run("ly = 10", "refined", 8, 1.0, "end"),
        Run("ly = 10", "rough", 5, 1.1, "end"),
    ]


def test_slides_of_the_mean_strength_follow_a_search_that_has_ended(monkeypatch):
    name = "mean strength, cells of 0.75 m"
    monkeypatch.setattr(missing, "CASES", {name: cases.CASES[name]})
    rows = {Run(name, "refined", 0, r): CLASS if r > 1.155 else STOOD for r in (1.3, 1.14, 1.22, 1.18, 1.16, 1.15)}
    assert run_all(lambda run: False, rows) == [Run(name, "refined", 0, 1.16, "end")]


def test_slides_of_the_audit_that_break_off_run_once_more_with_more_air(monkeypatch):
    monkeypatch.setattr(missing, "CASES", {})
    monkeypatch.setattr(missing, "SAMPLES", 40)
    monkeypatch.setattr(missing, "AUDIT", replace(cases.AUDIT, runs=8, first_wave=4))
    rows = {Run("published", "rough", n): replace(STOOD, displacement=0.02 * (n + 1)) for n in range(40)}
    rows |= {Run("published", "refined", n): CLASS if n > 9 else STOOD for n in range(40)}
    asked = run_all(lambda run: False, dict(rows))
    drawn = [run.sample for run in asked]
    assert drawn
    assert min(drawn) > 9
    assert asked == [replace(run, until="end") for run in map(partial(Run, "published", "refined"), drawn)]
    rows[asked[0]] = BROKE_OFF
    assert replace(asked[0], case=cases.MORE_AIR) in run_all(lambda run: False, rows)


@pytest.mark.parametrize(("rows", "reduction"), [({}, "1.3"), ({1.3: CLASS, 1.14: BROKE_OFF}, "1.14")])
def test_a_search_without_an_answer_is_named(few_cases, rows, reduction):
    known = {Run(factors.DEFAULT, "rough", 0, each): outcome for each, outcome in rows.items()}
    with pytest.raises(ValueError, match=f"'mean strength, default', rough: at a reduction of {reduction} the slope"):
        run_all(lambda run: False, known)


def test_rows_are_added_to_a_file_of_the_study(tmp_path):
    path = tmp_path / "study_slides_added.csv"
    runs = [Run("ly = 10", "refined", sample, 1.0, "end") for sample in (8, 9)]
    for run in runs:
        missing.add(path, run, SLID)
    assert read_table(path) == dict.fromkeys(runs, SLID)
    assert '"ly = 10": ' in path.read_text().splitlines()[0]
    assert '"default": ' not in path.read_text()


@pytest.mark.parametrize("run", [run for run in read_study() if run.until == "end"][::40], ids=str)
def test_a_slide_goes_to_the_file_of_the_study_that_has_it(run):
    assert run in read_table(missing.file_of(run.case, run.grid))


@pytest.mark.slow
def test_a_slide_is_that_of_reduced_strength_and_goes_on_where_it_was_stopped(monkeypatch, tmp_path):
    monkeypatch.setitem(cases.CASES, factors.DEFAULT, {"scene": "demo", "changes": TINY})
    run = Run(factors.DEFAULT, "refined", 0, 1.5, "end")
    looks = iter([False, False])
    with pytest.raises(Stopped):
        missing.outcome_of(run, tmp_path / "slide", lambda: next(looks, True))
    outcome = missing.outcome_of(run, tmp_path / "slide")
    campaign = cases.campaign_of("demo", TINY)
    model = build(campaign, "refined", random_soil(campaign))
    scene, state = model.of_sample()
    # A lane ends with its chunk of steps, a little beyond t_end.
    result = solve(reduced(scene, 1.5), state, t_end=outcome.time, rules=campaign.rules()).raise_if_failed()
    far = float(np.linalg.norm(np.asarray(result.state.displacement), axis=0).max())
    assert outcome.displacement_any == pytest.approx(far, rel=1e-3)
    assert outcome.steps == int(result.state.step)
    assert outcome.time == pytest.approx(float(result.state.step * scene.numerics.time_step), rel=1e-4)
    assert outcome.mode == "deep"
    assert outcome.runout is not None
    assert outcome.runout > 0
