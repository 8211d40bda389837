"""Benchmarks: their report is one JSON object, and RESULTS.md says what it holds."""

import itertools
import json
import math
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest
from matplotlib import image

from benchmarks import measure, results, summary
from benchmarks.accuracy import work_precision
from benchmarks.sites import random_slopes, slopes, stability_of_slopes
from benchmarks.speed.throughput_case import Case
from benchmarks.speed.throughput_case import measure as measure_case
from cooperative.runs import check_size, random_soil
from cooperative.scene import parse

QUICK = [
    *("stability", "work_precision", "slope", "leave_out", "screening"),
    *("fields", "gradients", "rare_events", "estimators", "levers", "rest"),
]


def test_report_is_one_json_object_with_machine_and_versions():
    answer = json.loads(measure.as_json("slope", measure.Report({"a": 1.5}, [{"x": 1}])))
    assert answer["benchmark"] == "slope"
    assert answer["values"] == {"a": 1.5}
    assert answer["machine"]["cores"] >= 1
    assert answer["machine"]["versions"]["jax"]


def test_timing_has_median_and_spread():
    timing = measure.timed(lambda: sum(range(1000)), repeats=5)
    assert 0 < timing.smallest <= timing.median <= timing.largest
    assert timing.scaled(2.0)["median"] == 2 * timing.median


def test_results_hold_every_value_and_row():
    answer = json.loads(
        measure.as_json("slope", measure.Report({"fos": 1.234567}, [{"x": 1, "y": [1.0, 2.0]}, {"z": "a"}]))
    )
    assert "| [slope](pages/slope.md) |" in results.document([answer])
    page = results.section(answer)
    assert "| fos | 1.235 |" in page
    assert "| 1 | 1, 2 |" in page
    assert "| z |" in page


def test_the_page_is_of_the_stored_answers(tmp_path, monkeypatch):
    answers = results.stored()
    assert results.PAGE.read_text() == results.document(answers)
    pages = {path.stem: path.read_text() for path in results.PAGES.glob("*.md")}
    assert pages == {answer["benchmark"]: results.section(answer) for answer in answers}
    rows = [{"x": 1.5, "of": "a b"}, {"x": None, "of": "c"}, {"z": 2.0}]
    monkeypatch.setattr(results, "FOLDER", tmp_path / "results")
    monkeypatch.setattr(results, "PAGE", tmp_path / "RESULTS.md")
    monkeypatch.setattr(results, "PAGES", tmp_path / "pages")
    monkeypatch.setattr(results, "FIGURES", tmp_path / "figures")
    for name in ("slope", "screening"):
        report = measure.Report({}, rows, lambda folder: (folder / f"{name}_all.png").write_bytes(b""))  # noqa: B023
        results.keep(measure.as_json(name, report), report.draw)
    assert results.stored_rows("slope") == results.stored_rows("screening") == rows
    page = (tmp_path / "RESULTS.md").read_text()
    assert page == results.document(results.stored())
    assert page.index("[slope]") < page.index("[screening]")
    for name in ("slope", "screening"):
        assert f"![{name}_all](../figures/{name}_all.png)" in (tmp_path / "pages" / f"{name}.md").read_text()


@pytest.mark.parametrize("name", ["early", "levers", "mode_readings", "opened_soil", "published", "rest"])
def test_the_kept_answer_of_stored_rows_is_what_they_give(name):
    report = results.module(name).run(quick=False)
    kept = json.loads((results.FOLDER / f"{name}.json").read_text())
    assert json.loads(json.dumps([report.values, report.rows])) == [kept["values"], kept["rows"]]


def test_figures_of_error_and_time_are_drawn_from_the_stored_answer(tmp_path):
    work_precision.draw(results.stored_rows("work_precision"), tmp_path)
    for name in ("work_precision", "work_precision_theory"):
        width = image.imread(tmp_path / f"{name}.png").shape[1]
        assert 700 < width < 900  # a page's width, so that its letters are as large as drawn


def test_results_lead_with_broken_bounds_their_reasons_and_the_best_buy():
    case = {"case": "a", "figure": 0.5, "sense": "<=", "bound": 0.1, "unit": "1", "passed": False, "why": "hats"}
    close = case | {"case": "b", "figure": 0.09, "passed": True}
    row = {"setting": "plain", "cell_m": 1.0, "fails_at_R": 1.13, "runout_m": 14.3, "runout_at_R_1.4_m": 35.0}
    row |= {"seconds": 9.0, "published": "none"}
    reports = {
        "slope": measure.Report({"fos_rough": 1.23, "fos_refined": 1.3}, []),
        "stability": measure.Report({"cases_failed": 1}, [case, close]),
        "work_precision": measure.Report({"best_buy": "plain"}, [row]),
    }
    page = "\n".join(summary.lead([json.loads(measure.as_json(name, report)) for name, report in reports.items()]))
    lines = page.splitlines()
    assert "| 1.3 | regression: 1.1 to 1.18 | no | 1.15, off by +13.0% |" in page
    assert lines.index(next(x for x in lines if "| no |" in x)) < lines.index(next(x for x in lines if "| yes |" in x))
    assert "| a | 0.5 1 | <= 0.1 | hats |" in page
    assert "| b | 0.09 1 | <= 0.1 |" in page
    assert "| plain | 1.0 | 1.13 | 14.3 | 35.0 | 9.0 |  |" in page


def test_throughput_case_measures_a_lane_that_runs():
    result = measure_case(Case(scene="paper_section", seconds=0.05, repeats=2))
    assert result["running"]
    assert result["particles"] == 888
    assert len(result["us"]) == 2
    assert all(us > 0 for us in result["us"])


@pytest.mark.parametrize(
    "family",
    [pytest.param(each, marks=() if each is slopes.FAMILIES[0] else pytest.mark.slow) for each in slopes.FAMILIES],
)
def test_slopes_with_known_answers_fit_their_cells_and_layers(family):
    for case in family():
        scenes = [case.built(cell, at_rest=False)[0] for cell in case.cells]
        areas = [float(scene.particles.volume.sum()) for scene in scenes]
        surface = case.shape.surface
        drawn = sum((b[0] - a[0]) * ((a[1] + b[1]) / 2 - case.shape.base) for a, b in itertools.pairwise(surface))
        assert abs(areas[0] / drawn - 1) < 0.02
        assert abs(areas[-1] / drawn - 1) < 0.01


def test_there_are_twenty_six_of_them():
    assert len({case.name for case in slopes.cases()}) == 26
    assert len({case.figure for case in slopes.special_cases()}) == len(slopes.special_cases())


@pytest.mark.parametrize("case", slopes.special_cases(), ids=lambda case: case.name)
def test_special_slopes_fit_their_coarse_cells_and_have_figures_of_their_own(case):
    scene, _ = case.built(case.cells[0], at_rest=False)
    assert abs(float(scene.particles.volume.sum()) / case.shape.volume - 1) < 0.02
    assert case.figure.startswith("fos_error_")
    rows = [{"case": case.name, "error": error} for error in (0.3, 0.01)]
    assert stability_of_slopes.special(rows, {case.name: case.figure}) == {case.figure: 0.01}


def test_figures_of_slopes_are_those_of_their_finest_cells():
    rows = [{"case": "a", "error": e, "seconds": 2.0} for e in (0.09, 0.03)] + [
        {"case": "b", "error": e, "seconds": 1.0} for e in (0.02, -0.05)
    ]
    assert stability_of_slopes.summarised(rows) == {
        "fos_error_max": 0.05,
        "fos_error_max_coarse": 0.09,
        "fos_cases": 2,
        "fos_cases_within_4_percent": 1,
        "fos_seconds": 6.0,
    }


def test_core_counts_beyond_the_machine_are_refused():
    with pytest.raises(ValueError, match="4096 cores asked for"):
        measure.on_cores(4096, "benchmarks.speed.throughput_case", "{}")


def test_warnings_of_a_process_on_its_cores_are_shown(tmp_path, monkeypatch):
    (tmp_path / "child.py").write_text("import warnings\nwarnings.warn('mind the step')\nprint('{}')\n")
    monkeypatch.setattr(measure, "ROOT", tmp_path)
    with pytest.warns(UserWarning, match="child: mind the step"):
        assert measure.on_cores(1, "child") == {}


def test_peak_memory_is_that_of_the_device_where_it_tells(monkeypatch):
    monkeypatch.setattr(measure.jax, "devices", lambda: [SimpleNamespace(memory_stats=lambda: None)])
    assert 10 < measure.peak_memory_mb() < 1e6
    held = {"peak_bytes_in_use": 3 * 2**20}
    monkeypatch.setattr(measure.jax, "devices", lambda: [SimpleNamespace(memory_stats=lambda: held)])
    assert measure.peak_memory_mb() == 3


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A clone of the repository with the files as they stand here, committed."""
    folder = tmp_path_factory.mktemp("copy") / "repository"
    listed = git(measure.ROOT, "ls-files", "-z").split("\0")[:-1]
    for name in filter(None, listed):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(measure.ROOT / name, folder / name)
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "-c", "user.name=a", "-c", "user.email=a@b.c", "commit", "-qm", "as it is")
    return folder


def git(folder, *arguments):
    return subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("name", ["published", *(pytest.param(each, marks=pytest.mark.slow) for each in QUICK)])
def test_quick_benchmarks_print_json_and_change_no_file(name, copy):
    command = [sys.executable, "-m", "benchmarks", name, "--json", "--quick"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=copy)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["values"]
    assert git(copy, "status", "--porcelain") == ""


@pytest.mark.parametrize("quick", [False, True])
def test_random_slopes_are_campaigns_that_fail_by_the_limit_load(quick):
    for name, case in random_slopes.CASES.items():
        campaign = parse(random_slopes.scene_text(case, quick))
        check_size(campaign)
        assert campaign.run.failure == "limit load"
        assert campaign.plan.slides == 0
        assert not campaign.soil.softens
        if case.printed is None:
            assert random_soil(campaign).modes == 1, name


def test_slopes_at_a_printed_factor_have_the_strength_that_gives_it():
    own = {row["case"]: row for row in results.stored_rows("random_slopes")}
    changed = {name: case for name, case in random_slopes.CASES.items() if case.limit is not None}
    assert len(changed) == 3
    for name, case in changed.items():
        row, strength = own[name.partition("_at_")[0]], parse(random_slopes.scene_text(case, False)).run.strength_factor
        assert row["fos"] * strength == pytest.approx(case.limit.factor, rel=1e-3)
        measured = row["failure_displacement_m"], row["least_volume"]
        assert (case.limit.displacement, case.limit.volume) == pytest.approx(measured, rel=2e-3)


def test_cases_are_chosen_by_the_beginnings_of_their_names():
    assert list(measure.beginning_so({"ab": 1, "ac": 2, "b": 3}, ["ac", "b"])) == ["ac", "b"]
    with pytest.raises(ValueError, match="--only nothing: no case begins so, give beginnings of cho, "):
        random_slopes.run(quick=True, only=["nothing"])


def test_random_slopes_know_the_closed_form_and_tell_what_has_not_ended():
    text = random_slopes.scene_text(random_slopes.CASES["griffiths_fenton"], False)
    # The printed factor of 1.47 is that of the mean strength.
    factor = 1.47 / math.sqrt(1 + parse(text).random["strength"].cov ** 2)
    assert random_slopes.closed_form(text, factor) == pytest.approx(0.281, abs=1e-3)
    row = dict.fromkeys(("fos", "pf", "low", "high", "hours"), 0.5)
    values = random_slopes.summarised([{"case": "example_2", **row}])
    assert values["example_2_pf"] == 0.5
    assert values["pf_3d_limit_load"] is None
