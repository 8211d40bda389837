"""Tables and verdicts of the published study, from files that are made up."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.study import published, published_modes, published_probability, study_pieces, study_runs
from benchmarks.study.published_answers import Found, Hours, Line, difference, mean_seconds, paired_change
from benchmarks.study.study import DATA, file_of, read_study
from benchmarks.study.study_table import Outcome, Rows, Run, merged, write_table
from cooperative.estimate import two_phase, wilson_interval
from tests.benchmarks.study.test_study import FAILED, SLID, STOOD, made_up

NO_TIME = Hours(0.0, 0.0)


def keep(folder, piece: str, rows: Rows):
    write_table(file_of(folder, piece), rows, study_runs.CASES)


def reported(folder):
    report = published.report(folder)
    return report.values, {row["what"]: row for row in report.rows}


def search(fails: float, grid: str, case: str = "mean strength") -> Rows:
    """What the search for a factor of safety leaves."""
    rows: Rows = {}
    while runs := study_pieces.bisection(rows, case, grid):
        rows[runs[0]] = FAILED if runs[0].reduction > fails - 0.005 else STOOD
    return rows


def test_nothing_is_made_up_where_nothing_ran(tmp_path):
    values, rows = reported(tmp_path)
    assert values == {}
    assert len(rows) > 40
    assert all(row["verdict"].startswith("not run yet") for row in rows.values())
    assert all(row["ours"] == "none" for row in rows.values())


def test_factors_of_safety_agree_within_a_step_or_are_told_with_what_was_measured(tmp_path):
    rollers = search(1.24, "rough", "mean strength, rollers")
    keep(tmp_path, "fos_rough", search(1.29, "rough") | rollers)
    keep(tmp_path, "fos_refined", search(1.16, "refined"))
    slide = Run("mean strength", "refined", reduction=1.16, until="end")
    keep(tmp_path, "slide", {slide: replace(SLID, runout=14.5)})
    values, rows = reported(tmp_path)
    assert (values["fos_rough_3d"], values["fos_refined_3d"], values["fos_rough_3d_rollers"]) == (1.29, 1.16, 1.24)
    assert values["runout_refined_3d_m"] == 14.5
    assert rows["factor of safety in 3D, refined, as published"]["verdict"] == "agrees"
    assert rows["run-out in 3D at that factor, refined (m)"]["verdict"] == "agrees"
    rough = rows["factor of safety in 3D, rough, as published"]["verdict"]
    assert rough == "differs by +0.03: measured with y ends fixed 1.29, y ends on rollers 1.24"
    assert "fos_rough_3d_default" not in values
    assert values["hours_total"] > 0


def test_half_a_search_has_no_value(tmp_path):
    rows = search(1.29, "rough")
    keep(tmp_path, "fos_rough", dict(list(rows.items())[:3]))
    values, rows = reported(tmp_path)
    assert set(values) == {"hours_total", "gpu_hours_total"}
    assert "3 runs of the search" in rows["factor of safety in 3D, rough, as published"]["verdict"]


@pytest.fixture
def campaign(monkeypatch):
    """60 samples on both grids where an audit of 40 wants them, and the slides of those that fail."""
    for module in (study_runs, study_pieces):
        monkeypatch.setattr(module, "SAMPLES", 60)
    monkeypatch.setattr(study_pieces, "AUDIT", replace(study_pieces.AUDIT, runs=40))
    screened: Rows = {Run("published", "rough", n): made_up(n)[0] for n in range(60)}
    audited: Rows = {}
    wanted = study_pieces.audit("published", 60, study_pieces.AUDIT)
    while runs := [run for run in wanted(screened | audited) if run not in audited]:
        audited[runs[0]] = made_up(runs[0].sample)[1]
    return screened, audited


def test_probability_of_failure_is_the_estimators_and_needs_its_screening(tmp_path, campaign):
    screened, audited = campaign
    keep(tmp_path, "audit", audited)
    keep(tmp_path, "screening", dict(list(screened.items())[:59]))
    values, rows = reported(tmp_path)
    assert "pf_3d" not in values
    assert "59 of 60 rough samples" in rows["P_f in 3D"]["verdict"]
    keep(tmp_path, "screening", screened)
    values, rows = reported(tmp_path)
    together = screened | audited
    population = study_pieces.population(together, "published", 60)
    expected = two_phase(population, study_pieces.refined_classes(together, "published"), study_pieces.AUDIT)
    assert values["pf_3d"] == pytest.approx(expected.probability, abs=1e-4)
    assert (values["pf_3d_low"], values["pf_3d_high"]) == pytest.approx(expected.interval, abs=1e-4)
    assert values["refined_runs_3d"] == 40
    assert values["spearman_3d"] > 0.8
    verdict = rows["P_f in 3D"]["verdict"]
    assert (verdict == "agrees") == (expected.interval[0] <= 0.244 <= expected.interval[1])
    assert "60 rough samples, 40 refined" in rows["P_f in 3D"]["rests on"]


def test_a_few_refined_runs_short_of_a_wave_are_no_estimate(tmp_path, campaign):
    screened, audited = campaign
    keep(tmp_path, "screening", screened)
    keep(tmp_path, "audit", dict(list(audited.items())[:5]))
    values, rows = reported(tmp_path)
    assert "pf_3d" not in values
    assert "no wave of the audit is whole" in rows["P_f in 3D"]["verdict"]


def test_shares_of_modes_weigh_all_failures_of_the_draws_that_are_whole(tmp_path, campaign):
    screened, audited = campaign
    fallen = [run for run, outcome in audited.items() if study_pieces.failed(outcome)]
    slides = {
        replace(run, until="end"): replace(SLID, mode="progressive" if run.sample % 4 else "deep") for run in fallen
    }
    for piece, rows in (("screening", screened), ("audit", audited), ("slides", slides)):
        keep(tmp_path, piece, rows)
    values, _ = reported(tmp_path)
    assert values["share_deep"] + values["share_progressive"] == pytest.approx(1.0, abs=1e-3)
    assert 0 < values["share_deep"] < 0.6
    assert values["share_shallow"] == 0
    keep(tmp_path, "slides", dict(list(slides.items())[: len(slides) // 2]))
    fewer, rows = reported(tmp_path)
    told = rows["share of deep failures"]["rests on"]
    assert "share_deep" in fewer
    assert f"failures of {study_pieces.AUDIT.runs} draws" not in told
    lost = next(run for run, slide in slides.items() if slide.mode == "deep")
    keep(tmp_path, "slides", slides | {lost: replace(FAILED, status="OUTSIDE_GRID")})
    without, rows = reported(tmp_path)
    told = rows["share of deep failures"]["rests on"]
    assert f"{len(slides) - 1} refined slides of {len(slides)} failures" in told
    assert "the others broke off and stand for" in told
    assert without["share_deep"] < values["share_deep"]
    # The one that was lost may have been deep.
    assert rows["share of deep failures"]["high"] > values["share_deep"]
    # On a higher grid it ended.
    left = merged((screened, audited, slides | {lost: replace(FAILED, status="OUTSIDE_GRID")}))
    (again,) = study_pieces.PIECES["slides_more_air"](left)
    assert (again.sample, again.case) == (lost.sample, study_runs.MORE_AIR)
    keep(tmp_path, "slides_more_air", {again: slides[lost]})
    assert reported(tmp_path)[0]["share_deep"] == values["share_deep"]


def test_the_interval_of_a_share_leaves_slides_that_broke_off_any_mode():
    """16 of 36 slides that ended are deep; the four others would have been any mode."""
    slides = published_modes.Slides([], np.ones(36), 4 / 40, "")
    low, high = published_modes.share_found(np.arange(36) < 16, slides, NO_TIME, "").interval
    for deep in range(5):
        would_be = wilson_interval(16 + deep, 40)
        assert low <= would_be[0]
        assert would_be[1] <= high
    whole = published_modes.Slides([], np.ones(40), 0.0, "")
    assert published_modes.share_found(np.arange(40) < 20, whole, NO_TIME, "").interval == wilson_interval(20, 40)


def test_hours_are_those_of_the_runs_that_an_answer_rests_on(tmp_path, campaign):
    screened, audited = campaign
    beside = {Run("published", "refined", n): made_up(n)[1] for n in range(60)}
    keep(tmp_path, "screening", screened)
    keep(tmp_path, "audit", audited)
    before = reported(tmp_path)[1]
    keep(tmp_path, "ranked", beside)
    after = reported(tmp_path)[1]
    for what in ("P_f in 3D", "refined runs behind P_f in 3D", "rank correlation of the grids in 3D (Spearman)"):
        assert after[what]["hours"] == before[what]["hours"]
    assert after["core hours of the whole study"]["ours"] > before["core hours of the whole study"]["ours"]


def test_slides_too_few_for_a_median_are_named(tmp_path, campaign):
    screened, audited = campaign
    fallen = [run for run, outcome in audited.items() if study_pieces.failed(outcome)]
    slides = {
        replace(run, until="end"): replace(SLID, mode="deep" if n else "compound") for n, run in enumerate(fallen)
    }
    for piece, kept in (("screening", screened), ("audit", audited), ("slides", slides)):
        keep(tmp_path, piece, kept)
    _, rows = reported(tmp_path)
    assert "a median wants 5" in rows["median area of compound failures (m2)"]["verdict"]
    assert rows["median area of deep failures (m2)"]["verdict"] == "no other mode to rank"
    assert "not resolved: none was found, up to" in rows["share of shallow failures"]["verdict"]
    both = rows["share of progressive or compound failures"]["ours"]
    assert both == rows["share of compound failures"]["ours"] > 0


def test_common_samples_count_once_in_a_pool_of_lengths():
    """Slides of one sample at several lengths are alike: the interval is that of the samples."""
    rows = {
        Run(case, "rough", n, 1.1, until): replace(SLID, mode="deep") if until == "end" else FAILED
        for case in study_pieces.sweep_cases()
        for n in range(200)
        for until in ("class", "end")
    }
    pooled = published_modes.rough_shares(rows, study_pieces.sweep_cases(), ("shallow",))
    single = published_modes.rough_shares(rows, study_pieces.sweep_cases()[:1], ("shallow",))
    assert pooled.interval == pytest.approx(wilson_interval(0, 200))
    assert pooled.interval == pytest.approx(single.interval)


@pytest.mark.parametrize("shares", [(0.1, 0.4), (0.05, 0.1), (0.3, 0.3)])
def test_the_interval_of_a_difference_covers(shares):
    rng, held = np.random.default_rng(6), 0
    for _ in range(1000):
        ends = [rng.binomial(40, share) for share in shares]
        answers = [Found(n / 40, wilson_interval(n, 40), "", NO_TIME) for n in ends]
        change, (low, high) = difference(*answers)
        assert low <= change <= high
        held += low <= shares[1] - shares[0] <= high
    assert 0.93 < held / 1000 < 0.99


def test_few_runs_have_a_range_in_place_of_an_interval():
    middle, limits, words = mean_seconds(np.array([10.0, 20.0, 60.0]))
    assert (middle, limits) == (30.0, (10.0, 60.0))
    assert "from the least to the most" in words
    rng, held = np.random.default_rng(7), 0
    for _ in range(1000):
        _, (low, high), words = mean_seconds(rng.normal(100, 20, 8))
        held += low <= 100 <= high
    assert words == ""
    assert 0.93 < held / 1000 < 0.97


def test_readings_are_paired_and_need_enough_common_samples(tmp_path):
    def section(name, fails, count):
        runs = (Run(f"section, {name}", "refined", n) for n in range(count))
        return {run: FAILED if fails(run.sample) else STOOD for run in runs}

    rows = section("as here", lambda n: n % 4 == 0, 40) | section("CFL 0.9", lambda n: n % 4 == 0, 40)
    rows |= section("F-bar", lambda n: n % 2 == 0, 40) | section("stress last (USL)", lambda n: n % 2 == 0, 10)
    keep(tmp_path, "section", rows)
    values, rows = reported(tmp_path)
    change = "P_f of the section, change by: "
    assert rows[f"{change}F-bar"]["ours"] == 0.25
    assert rows[f"{change}F-bar"]["low"] > 0.1
    assert rows[f"{change}CFL 0.9"]["ours"] == 0
    assert rows[f"{change}CFL 0.9"]["low"] < 0 < rows[f"{change}CFL 0.9"]["high"]
    assert rows[f"{change}stress last (USL)"]["verdict"] == "not run yet: 10 of 400 samples are there"
    assert rows["P_f of the section"]["ours"] == 0.25
    assert set(values) == {"hours_total", "gpu_hours_total"}


def test_the_interval_of_a_change_covers():
    """2000 repetitions of 60 pairs with known probabilities of a gain and a loss."""
    rng, held = np.random.default_rng(5), 0
    for _ in range(2000):
        kind = rng.choice(3, 60, p=[0.1, 0.05, 0.85])
        _, (low, high) = paired_change((kind == 1).tolist(), (kind == 0).tolist())
        held += low <= 0.05 <= high
    assert 0.93 < held / 2000 < 0.985


def sweep(rise: bool) -> tuple[Rows, Rows]:
    """All lengths screened and audited; where P_f rises, the longer half fails twice as often."""
    screened, audited = {}, {}
    for case in study_pieces.sweep_cases():
        share = 0.5 if rise and case.endswith(("60", "120")) else 0.2
        strength = (np.arange(200) * 77 % 200 + 0.5) / 200
        for n in range(200):
            screened[Run(case, "rough", n, 1.103)] = replace(STOOD, displacement=0.5 - 0.4 * float(strength[n]))
            audited[Run(case, "refined", n)] = FAILED if strength[n] < share else STOOD
    return screened, audited


@pytest.mark.parametrize("rise", [True, False])
def test_lengths_are_told_to_rise_only_where_they_do(tmp_path, rise):
    screened, audited = sweep(rise)
    keep(tmp_path, "fos_rough", search(1.29, "rough"))
    keep(tmp_path, "fos_refined", search(1.17, "refined"))
    keep(tmp_path, "sweep", screened)
    keep(tmp_path, "sweep_audit", audited)
    values, rows = reported(tmp_path)
    told = rows["rise of P_f from lx = 10 m to 120 m"]["verdict"]
    assert told == ("rises, as published" if rise else "not resolved")
    assert rows["rough grid alone: rise of P_f from lx = 10 m to 120 m"]["verdict"] == "not resolved"
    assert rows["rough grid alone: P_f at ly = 30 m"]["ours"] == 0
    for axis, length, share in (("lx", 10, 0.2), ("ly", 120, 0.5 if rise else 0.2)):
        row = rows[f"P_f in 3D, {axis} = {length} m, the other 60 m"]
        assert row["low"] <= share <= row["high"]
        assert values[f"pf_{axis}_{length}"] == row["ours"]


def test_rough_modes_are_told_once_all_slides_of_a_length_are_there_and_pooled_once_all_are(tmp_path):
    keep(tmp_path, "fos_rough", search(1.29, "rough"))
    keep(tmp_path, "fos_refined", search(1.17, "refined"))
    runs = [Run(case, "rough", n, 1.103) for case in study_pieces.sweep_cases() for n in range(200)]
    screened = {run: FAILED if run.sample < 50 else STOOD for run in runs}
    slides = {
        replace(run, until="end"): replace(SLID, mode="deep" if run.sample < 40 else "shallow")
        for run in runs
        if run.sample < 50
    }
    keep(tmp_path, "sweep", screened)
    keep(tmp_path, "sweep_slides", dict(list(slides.items())[:-1]))
    deep = "share of deep failures, rough grid calibrated, "
    rows = reported(tmp_path)[1]
    assert rows[f"{deep}lx = 10 m"]["ours"] == 0.8
    assert "shallow 0.20" in rows[f"{deep}lx = 10 m"]["verdict"]
    assert rows[f"{deep}all lengths"]["verdict"] == "not run yet: 349 slides of 350 failures are there"
    keep(tmp_path, "sweep_slides", slides)
    rows = reported(tmp_path)[1]
    assert rows[f"{deep}all lengths"]["ours"] == 0.8
    assert rows[f"{deep}all lengths"]["verdict"].startswith("differs by +0.143")


@pytest.mark.parametrize(
    ("line", "verdict"),
    [
        (Line("a", "a", 1.0, "3 runs are there"), "not run yet: 3 runs are there"),
        (Line("a", "a", 1.0, Found(1.1, (1.0, 1.2), "b", NO_TIME)), "agrees"),
        (Line("a", "a", 1.3, Found(1.1, (1.0, 1.2), "b", NO_TIME), "locking"), "differs by -0.2: locking"),
        (Line("a", "a", 1.3, Found(1.1, (1.0, 1.2), "b", NO_TIME)), "differs by -0.2: cause not measured yet"),
        (Line("a", "a", None, Found(1.1, (1.0, 1.2), "b", NO_TIME)), "not published"),
        (Line("a", "a", 0.1, Found(0.0, (0.0, 0.13), "b", NO_TIME)), "not resolved: none was found, up to 0.13 may be"),
        (
            Line("a", "a", 0.24, Found(0.29, (0.25, 0.4), "b", NO_TIME), "", (0.21, 0.27)),
            "agrees: +0.05, where the two samples leave 0.05 open",
        ),
        (
            Line("a", "a", 0.24, Found(0.3, (0.26, 0.4), "b", NO_TIME), "locking", (0.21, 0.27)),
            "differs by +0.06, where the two samples leave 0.05 open: locking",
        ),
    ],
)
def test_verdicts(line, verdict):
    assert line.verdict() == verdict


def test_a_damaged_file_is_named(tmp_path):
    keep(tmp_path, "slide", {Run("mean strength", "refined", until="end"): SLID})
    path = file_of(tmp_path, "slide")
    path.write_text(path.read_text().replace("deep", "deep,").replace("14", "1O"))
    with pytest.raises(ValueError, match=r"study_slide\.csv, line 3"):
        published.report(tmp_path)


def test_rough_shares_of_broken_off_runs_are_no_classes():
    broken = {Run("section, as here", "refined", 0): Outcome("INVERTED", 3.0, 1.0, 10, 1.0)}
    assert published_probability.classes(broken, "section, as here", "refined") == {}
    assert wilson_interval(0, 1)[1] < 1


def test_the_committed_files_parse_and_their_audits_are_those_that_the_estimator_draws():
    tables = read_study(DATA)
    rows = merged(tables.values())
    assert study_pieces.factor_of_safety(rows, "mean strength", "rough") == 1.29
    for piece, case, samples, plan in (
        ("audit", "published", study_runs.SAMPLES, study_pieces.AUDIT),
        ("audit_default", "default", study_runs.SWEEP_SAMPLES, study_pieces.SWEEP_AUDIT),
        ("audit_rollers", "rollers", study_runs.SWEEP_SAMPLES, study_pieces.SWEEP_AUDIT),
    ):
        found, _ = published_probability.estimated(rows, case, samples, plan)
        counted = 0 if found is None else found.refined_runs
        assert len(tables[piece]) - counted <= plan.wave(counted)


def test_hours_of_a_core_and_of_a_gpu_stand_apart(tmp_path):
    on_cpu = {Run(study_runs.ON_CPU, "rough", n): replace(STOOD, seconds=36.0) for n in range(4)}
    on_gpu = {Run("published", "rough", n): replace(STOOD, seconds=3.6, device="GPU of a kind") for n in range(6)}
    on_gpu[Run("published", "rough", 3)] = replace(FAILED, device="GPU of a kind", seconds=3.6)
    keep(tmp_path, "screening", on_gpu)
    keep(tmp_path, "on_cpu", on_cpu)
    values, told = reported(tmp_path)
    assert values["hours_total"] == pytest.approx(4 * 0.01)
    assert values["gpu_hours_total"] == pytest.approx(6 * 0.001)
    assert told["core hours of rough runs"]["ours"] == pytest.approx(10.0)
    assert told["GPU hours of rough runs"]["ours"] == pytest.approx(1.0)
    assert told["GPU hours of refined runs"]["ours"] == "none"
    assert told["share of runs in 3D that a CPU and a GPU class alike"]["ours"] == 0.75
