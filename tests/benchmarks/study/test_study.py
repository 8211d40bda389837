"""The study's pieces: rows that survive, damage that is named, resuming, and what each piece wants next."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import Normalize

from benchmarks.study import __main__ as command
from benchmarks.study import study, study_pieces, study_runs, study_slides
from benchmarks.study.study_table import Outcome, Run, merged, read_table, write_table
from cooperative.estimate import AuditPlan, two_phase
from tests import ROOT

STOOD = Outcome("SETTLED", 0.05, 2.0, 500, 1.5)
FAILED = Outcome("DECIDED", 1.2, 3.0, 800, 2.5)
SLID = Outcome("FINISHED", 14.0, 20.0, 5000, 9.0, 12.5, 13.0, 4e3, 900.0, "deep", 1, 1.5)


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "study_fos.csv"
    rows = {Run("mean strength", "rough", reduction=1.26): STOOD, Run("published", "refined", 7, until="end"): SLID}
    write_table(path, rows, study_runs.CASES)
    return path, rows


def test_rows_come_back_as_they_were(table):
    path, rows = table
    assert read_table(path, study_runs.CASES) == rows


@settings(max_examples=30, deadline=None)
@given(
    displacement=st.floats(0, 1e3), sample=st.integers(0, 10**6), reduction=st.integers(1, 300).map(lambda n: n / 100)
)
def test_any_row_comes_back_to_six_digits(tmp_path_factory, displacement, sample, reduction):
    path = tmp_path_factory.mktemp("rows") / "study_fos.csv"
    run = Run("published", "rough", sample, reduction)
    write_table(path, {run: Outcome("SETTLED", displacement, 1.0, 1, 0.0)}, study_runs.CASES)
    assert read_table(path, study_runs.CASES)[run].displacement == pytest.approx(displacement, rel=1e-5, abs=1e-300)


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ("0.05", "0.05x", r"study_fos\.csv, line 3: displacement = '0.05x' is no number: mend or delete the line"),
        ("0.05", "", r"line 3: displacement = '' is no number"),
        ("0.05", "nan", r"line 3: displacement = 'nan' is not finite"),
        ("0.05", "inf", r"line 3: displacement = 'inf' is not finite"),
        ("0.05", "-0.05", r"line 3: displacement = '-0.05' is not at least 0: mend"),
        (",2,500,", ",0,500,", r"line 3: time = 0, steps = 500 of a run that is SETTLED: both are above 0, mend"),
        (",2,500,", ",2,0,", r"line 3: time = 2, steps = 0 of a run that is SETTLED"),
        (",2,500,", ",-2,500,", r"line 3: time = '-2' is not at least 0"),
        (",2,500,", ",2,-500,", r"line 3: steps = '-500' is no whole number of 0 or more: mend"),
        (",2,500,", ",2,5e2,", r"line 3: steps = '5e2' is no whole number"),
        ("500,1.5", "500,-1.5", r"line 3: seconds = '-1.5' is not at least 0"),
        ("1.26,", "0,", r"line 3: reduction = '0' is not above 0"),
        ("rough,0,", "rough,-1,", r"line 3: sample = '-1' is no whole number"),
        ("SETTLED", "DECIDE", r"line 3: status = 'DECIDE' is none of FINISHED, SETTLED, DECIDED, NOT_FINITE, .*: mend"),
        ("SETTLED", "RUNNING", r"line 3: status = 'RUNNING' is none of"),
        ("SETTLED", "", r"line 3: status = '' is none of"),
        (",deep,", ",deap,", r"line 4: mode = 'deap' is none of progressive, compound, deep, shallow: mend"),
        (",1,1.5,", ",1,inf,", r"line 4: onset = 'inf' is not finite"),
        (",cpu", ",", r"line 3: device is empty"),
        ("mean strength,rough,", "mean strength,", r"line 3: 20 cells instead of 21"),
        ("published,refined", "published,fine", r"line 4: grid = 'fine' is none of rough, refined"),
        ("published,refined", '"published,refined', r"line 4: "),
        ("cpu", "x" * 200_000, r"line 3: field larger than field limit"),
        ("case,grid", "case,Grid", r"line 2: columns case, Grid"),
        ("# {", "# ", r"line 1: no definitions"),
        ('{"cases": {', '{"cases": 5, "x": {', r"line 1: no definitions"),
        ('"cov": 0.0', '"cov": 0.1', r"line 3: case 'mean strength' was .*0\.1.* and is .*0\.0"),
    ],
)
def test_a_damaged_row_is_named_and_nothing_is_lost(table, tmp_path, was, becomes, message):
    path = table[0]
    damaged = path.read_text().replace(was, becomes, 1)
    assert damaged != path.read_text()
    path.rename(tmp_path / "study_fos_rough.csv")
    (tmp_path / "study_fos_rough.csv").write_text(damaged)
    with pytest.raises(ValueError, match=message.replace("study_fos", "study_fos_rough")):
        study.carry_on(tmp_path, ["fos_rough"], do=lambda runs, lanes: pytest.fail("ran"))
    with pytest.raises(ValueError, match="line"):
        study.collect(tmp_path, tmp_path / "other")
    assert (tmp_path / "study_fos_rough.csv").read_text() == damaged


def test_text_that_is_not_utf_8_is_named_with_its_file_and_line(table):
    path = table[0]
    path.write_bytes(path.read_bytes().replace(b"published,refined", b"published,re\xfffined"))
    with pytest.raises(ValueError, match=r"study_fos\.csv, line 4: byte \d+ is no UTF-8: mend or delete the line"):
        read_table(path, study_runs.CASES)


def test_a_run_that_broke_off_at_once_has_taken_no_time(tmp_path):
    rows = {Run("published", "rough"): Outcome("BAD_PARAMETER", 0.0, 0.0, 0, 0.1)}
    write_table(tmp_path / "study_screening.csv", rows, study_runs.CASES)
    assert read_table(tmp_path / "study_screening.csv", study_runs.CASES) == rows


def test_a_row_that_stands_there_twice_is_refused(table):
    path = table[0]
    path.write_text(path.read_text() + path.read_text().splitlines()[2] + "\n")
    with pytest.raises(ValueError, match=r"line 5: .* stands there twice"):
        read_table(path, study_runs.CASES)


def each(do):
    """Done one by one."""
    return lambda runs, lanes: [do(run) for run in runs]


def model_slope(run):
    """Fails from R = 1.29 on the rough grid and 1.17 on the refined one."""
    return FAILED if run.reduction >= (1.285 if run.grid == "rough" else 1.165) else STOOD


def test_the_search_finds_the_least_factor_that_fails_with_few_runs(tmp_path):
    study.carry_on(tmp_path, ["fos_rough", "fos_refined", "slide"], do=each(model_slope))
    tables = study.read_study(tmp_path)
    rows = merged(tables.values())
    assert study_pieces.factor_of_safety(rows, "mean strength", "rough") == 1.29
    assert study_pieces.factor_of_safety(rows, "mean strength", "refined") == 1.17
    assert study_pieces.factor_of_safety(rows, "mean strength, default", "rough") is None
    assert study_pieces.calibration(rows) == pytest.approx(1.29 / 1.17, abs=5e-4)
    assert len(tables["fos_refined"]) <= 6
    assert list(tables["slide"]) == [Run("mean strength", "refined", reduction=1.17, until="end")]


@pytest.mark.parametrize("answer", [STOOD, FAILED, Outcome("INVERTED", 0.5, 1.0, 10, 1.0)])
def test_no_factor_is_made_up_beyond_the_bracket_or_after_a_run_that_broke_off(tmp_path, answer):
    study.carry_on(tmp_path, ["fos_rough", "slide"], do=each(lambda run: answer))
    rows = merged(study.read_study(tmp_path).values())
    assert rows
    assert study_pieces.factor_of_safety(rows, "mean strength", "rough") is None
    assert list(study_pieces.missing("slide", rows)) == []


def test_a_second_call_runs_nothing_again_and_a_budget_begins_nothing(tmp_path):
    study.carry_on(tmp_path, ["fos_rough"], minutes=1e-9, do=lambda runs, lanes: pytest.fail("ran"))
    study.carry_on(tmp_path, ["fos_rough"], do=each(model_slope))
    before = (tmp_path / "study_fos_rough.csv").read_text()
    study.carry_on(tmp_path, ["fos_rough"], do=lambda runs, lanes: pytest.fail("ran"))
    assert (tmp_path / "study_fos_rough.csv").read_text() == before


def test_runs_that_failed_in_python_leave_the_others(tmp_path):
    def breaks(run):
        if run.reduction == 1.22:
            raise MemoryError("no room")
        return model_slope(run)

    with pytest.raises(MemoryError):
        study.carry_on(tmp_path, ["fos_rough"], do=each(breaks))
    assert len(study.read_study(tmp_path)["fos_rough"]) == 2


def test_bad_calls_are_refused(tmp_path):
    with pytest.raises(ValueError, match="piece 'fos': give some of fos_rough"):
        study.carry_on(tmp_path, ["fos"])
    with pytest.raises(ValueError, match="workers = 0"):
        study.carry_on(tmp_path, ["slide"], workers=0)
    with pytest.raises(ValueError, match="lanes = 0"):
        study.carry_on(tmp_path, ["slide"], lanes=0)
    with study._alone_in(tmp_path), pytest.raises(ValueError, match="another process is at work"):
        study.carry_on(tmp_path, ["fos_rough"], do=each(model_slope))
    with pytest.raises(ValueError, match="case 'none': give one of"):
        study_runs.campaign_of("none")


def test_every_case_is_a_scene():
    for case in study_runs.CASES:
        assert set(study_runs.campaign_of(case).grids) == {"rough", "refined"}


def made_up(sample):
    """Rough and refined outcome of one of 60 samples whose ranks agree but for a little."""
    strength = (sample * 37 % 60) / 60
    return (
        Outcome("SETTLED", 0.2 - 0.15 * strength, 2.0, 1, 2.0) if strength > 0.1 else FAILED,
        FAILED if strength + 0.1 * np.sin(sample) < 0.4 else STOOD,
    )


def test_audit_wants_what_the_estimator_draws_and_ends(tmp_path):
    rows = {Run("published", "rough", n): made_up(n)[0] for n in range(60)}
    wanted = study_pieces.audit("published", 60, AuditPlan(runs=30, seed=3))
    assert wanted({run: outcome for run, outcome in rows.items() if run.sample}) == []
    while runs := [run for run in wanted(rows) if run not in rows]:
        rows[runs[0]] = made_up(runs[0].sample)[1]
    refined = study_pieces.refined_classes(rows, "published")
    assert len(refined) == 30
    found = two_phase(study_pieces.population(rows, "published", 60), refined, AuditPlan(runs=30, seed=3))
    assert found.refined_runs == 30
    assert found.interval[0] <= np.mean([made_up(n)[1] is FAILED for n in range(60)]) <= found.interval[1]


def test_the_published_rule_ends_after_k_t_that_stand():
    rows = {Run("published", "rough", n): made_up(n)[0] for n in range(60)}
    wanted = study_pieces.in_rank_order("published", 60, 5)
    while runs := [run for run in wanted(rows) if run not in rows]:
        rows[runs[0]] = made_up(runs[0].sample)[1]
    ranked = sorted(range(60), key=lambda n: -study_pieces.score(rows[Run("published", "rough", n)]))
    ran = [n for n in ranked if Run("published", "refined", n) in rows]
    assert ran == ranked[: len(ran)]
    assert [made_up(n)[1] for n in ran[-5:]] == [STOOD] * 5


def test_slopes_that_fail_sooner_rank_above_and_all_above_those_that_stand():
    sooner, later = Outcome("DECIDED", 1.1, 2.0, 1, 1.0), Outcome("DECIDED", 1.3, 4.0, 1, 1.0)
    assert study_pieces.score(sooner) > study_pieces.score(later) > 1.0 > study_pieces.score(STOOD)
    assert np.isnan(study_pieces.score(Outcome("INVERTED", 3.0, 1.0, 1, 1.0)))


def test_collecting_adds_rows_and_changes_none(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    study.carry_on(there, ["fos_rough"], do=each(model_slope))
    other = Outcome("SETTLED", 0.5, 2.0, 500, 1.5)
    first = Run("mean strength", "rough", reduction=1.3)
    here.mkdir()
    write_table(here / "study_fos_rough.csv", {first: other}, study_runs.CASES)
    count = len(study.read_study(there)["fos_rough"])
    assert study.collect(there, here) == {"fos_rough": count - 1}
    assert study.read_study(here)["fos_rough"][first] == other
    assert study.collect(there, here) == {}


TINY = {"scene": "demo", "changes": {"rough": {"cell": 4.0, "spacing": [2.0, 2.0]}, "run": {"t_end": 2.0}}}
RUNS = [Run("tiny", "rough", number, 1.4) for number in range(6)]
PROCESS = f"""
import sys
from dataclasses import replace
from pathlib import Path
from benchmarks.study import study, study_pieces, study_runs, study_slides
from benchmarks.study.study_table import Run
study_runs.CASES["tiny"] = {TINY!r}
study_pieces.PIECES["tiny"] = lambda rows: {RUNS!r}
study.carry_on(Path(sys.argv[1]), ["tiny"])
"""


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setitem(study_runs.CASES, "tiny", TINY)
    monkeypatch.setitem(study_pieces.PIECES, "tiny", lambda rows: RUNS)


@pytest.mark.slow
def test_a_killed_study_goes_on_with_the_same_answers(tiny, tmp_path):
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    process = subprocess.Popen(
        [sys.executable, "-c", PROCESS, str(killed)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    for _ in range(2):
        assert "sample" in process.stdout.readline()
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    before = study.read_study(killed)["tiny"]
    assert len(before) >= 2
    for folder in (killed, whole):
        study.carry_on(folder, ["tiny"])
    after, expected = study.read_study(killed)["tiny"], study.read_study(whole)["tiny"]
    assert {run: after[run] for run in before} == before
    assert list(expected) == RUNS
    assert [after[run].displacement for run in RUNS] == [expected[run].displacement for run in RUNS]
    assert len({outcome.displacement for outcome in expected.values()}) == len(RUNS)


def test_runs_side_by_side_answer_as_those_one_after_the_other(tiny, tmp_path):
    study.carry_on(tmp_path / "alone", ["tiny"])
    study.carry_on(tmp_path / "lanes", ["tiny"], lanes=3)
    alone, lanes = (study.read_study(tmp_path / name)["tiny"] for name in ("alone", "lanes"))
    assert list(lanes) == list(alone) == RUNS
    for run in RUNS:
        assert replace(lanes[run], seconds=0.0) == replace(alone[run], seconds=0.0)
        assert lanes[run].seconds > 0


def test_only_runs_that_differ_in_their_sample_alone_go_side_by_side():
    runs = [*RUNS[:3], replace(RUNS[3], until="end"), *RUNS[4:]]
    assert study_runs.alike(runs, 2) == tuple(RUNS[:2])
    assert study_runs.alike(runs, 9) == tuple(RUNS[:3])
    assert study_runs.alike(runs[3:], 9) == (runs[3],)
    assert study_runs.alike([], 9) == ()


def test_a_slide_has_consequences_and_a_mode_and_a_class_has_none(tiny):
    to_the_end = study_runs.carry_out([Run("tiny", "rough", 0, 4.0, "end")])[0]
    to_its_class = study_runs.carry_out([Run("tiny", "rough", 0, 4.0)])[0]
    assert to_the_end.time > to_its_class.time
    assert to_the_end.displacement > to_its_class.displacement > 1
    assert to_the_end.volume > 0
    assert to_the_end.mode in ("shallow", "deep", "compound", "progressive")
    assert to_its_class.volume is None
    assert to_its_class.mode is None


WIDE = {"slope": {"width": 8.0}, "strength": {"length": [60.0, 60.0, 2.0]}, "rough": {"cell": 4.0}}
WIDE |= {"rough": {"cell": 4.0, "spacing": [2.0] * 3}, "refined": {"cell": 4.0, "spacing": [2.0] * 3}}
WIDE |= {"run": {"t_end": 2.0}}


@pytest.mark.slow
def test_a_typical_slide_of_each_mode_is_run_again_and_drawn(monkeypatch, tmp_path):
    monkeypatch.setitem(study_runs.CASES, "published", {"scene": "demo", "changes": WIDE})
    study_runs.prepared.cache_clear()
    rows = {
        Run("published", "refined", n, 4.0, "end"): replace(SLID, mode=mode, volume=volume)
        for n, (mode, volume) in enumerate((("deep", 10.0), ("deep", 30.0), ("deep", 31.0), ("shallow", 5.0)))
    }
    chosen = study_slides.typical(rows | {Run("published", "refined", 9): FAILED})
    assert {mode: run.sample for mode, run in chosen.items()} == {"deep": 1, "shallow": 3}
    slide = study_slides.run_again(chosen["deep"], (1.0, 20.0))
    assert slide.times == (1.0, 2.0)
    moved = np.linalg.norm(slide.displacement, axis=1).max(axis=1)
    assert moved[1] > moved[0] > 0
    x, y, height, value = study_slides.surface(slide.position, slide.position[2], 4.0)
    assert (len(x), len(y)) == height.shape == (33, 2)
    assert height == pytest.approx(value)
    assert height[0] == pytest.approx(15.0)
    assert height[-1] == pytest.approx(3.0)
    cut = study_slides.deepest_section(slide)
    assert np.ptp(slide.position[1, cut]) < 1e-3
    figure = study_slides.drawing(slide, study_slides.titled("deep", chosen["deep"]))
    assert study_slides.save(figure, tmp_path / "slide.png").stat().st_size > 10_000
    study_runs.prepared.cache_clear()


def made_up_slide(slip):
    """A block of 16 x 4 x 6 particles 0.5 m apart. slip: of each of its 4 layers, how many particles high the soil is
    that stands; what lies above has moved 0.25 m along x first and 3 m in the end."""
    place = np.stack(np.meshgrid(*(np.arange(n) for n in (16, 4, 6)), indexing="ij")).reshape(3, -1)
    step = np.zeros((2, *place.shape))
    step[:, 0] = np.outer((0.25, 3.0), place[2] >= np.array(slip)[place[1]])
    return study_slides.Slide(
        0.5 * place + 0.25, np.full(3, 0.25), 4e4 + 1e3 * place[2], (2.0, 20.0), step, 1.0
    )  # fmt: skip


def test_the_section_is_the_layer_with_the_lowest_soil_that_slid():
    slide = made_up_slide((4, 3, 2, 5))
    assert set(slide.position[1, study_slides.deepest_section(slide)]) == {1.25}
    wider = replace(slide, displacement=slide.displacement * (slide.position[1] < 1.0))
    assert set(wider.position[1, study_slides.deepest_section(wider)]) == {0.75}
    still = replace(slide, displacement=0 * slide.displacement)
    assert set(still.position[1, study_slides.deepest_section(still)]) == {0.25}


def test_a_slide_is_drawn_in_views_and_sections_at_each_time_and_named():
    slide = made_up_slide((4, 3, 2, 5))
    figure = study_slides.drawing(slide, study_slides.titled("deep", Run("published", "refined", 7)))
    assert figure.get_suptitle() == "Typical deep slide: sample 7 of 'published', refined grid"
    above, below = figure.subfigs
    assert [ax.get_title("left") for ax in above.axes] == ["t = 2 s", "t = 20 s"]
    assert [ax.get_title("right").strip() for ax in below.axes[:3]] == ["t = 2 s", "t = 20 s", "strength before"]
    early, late = (below.axes[n].collections[0].get_array() for n in range(2))
    # Soil that moved a quarter of a metre counts as standing; what lies above the second particle has slid.
    assert early.mask.all()
    assert late.compressed() == pytest.approx(3.0)
    x, y, z, colours = study_slides.tiles(slide, slide.displacement[0], Normalize(0, 3))
    assert (len(x), len(y), z.shape, colours.shape) == (10, 3, (10, 3), (9, 2, 3))
    assert z[1, 1] == pytest.approx(3.0)


def test_a_slope_that_stands_is_drawn_too():
    slide = made_up_slide((6, 6, 6, 6))
    figure = study_slides.drawing(slide, "stands")
    assert all(ax.collections[0].get_array().mask.all() for ax in figure.subfigs[1].axes[:2])


def test_a_typical_slide_that_breaks_off_leaves_the_others(monkeypatch, tmp_path, capsys):
    rows = {
        Run("published", "refined", n, until="end"): replace(SLID, mode=mode)
        for n, mode in enumerate(("compound", "deep", "shallow"))
    }
    write_table(study.file_of(tmp_path, "slides"), rows, study_runs.CASES)

    def run_again(run):
        if run.sample == 1:
            raise FloatingPointError("a particle left the grid: lengthen toe")
        return run

    monkeypatch.setattr(study_slides, "run_again", run_again)
    monkeypatch.setattr(study_slides, "drawing", lambda slide, title: slide)
    monkeypatch.setattr(study_slides, "save", lambda figure, path, dpi: path)
    monkeypatch.setattr(command, "FIGURES", Path("figures"))
    monkeypatch.setattr(sys, "argv", ["benchmarks.study", "--draw", "--folder", str(tmp_path)])
    assert command.main() == 1
    told = capsys.readouterr()
    assert told.out.split() == ["figures/published_slide_compound.png", "figures/published_slide_shallow.png"]
    assert "deep: sample 1 of 'published' broke off" in told.err
    assert "lengthen toe" in told.err
