"""The probability of failure against time: which runs it asks for, what it keeps, and what it writes."""

import csv
import json
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import cooperative.tools.in_time as in_time_tool
import cooperative.tools.seepage as seepage_tool
from cooperative import _commands, run, runs
from cooperative.__main__ import main
from cooperative._arguments import parser
from cooperative.scene import Hazard, Rain, parse, rested
from cooperative.store import FinishedRun, read_rows
from cooperative.store._database import mend
from cooperative.tools.in_time import (
    Annual,
    _answer,
    annual_in_time,
    kept_in,
    lines,
    lines_of_year,
    probability_in_time,
    progress_in_time,
    read_in_time,
    slides_in_time,
    write_in_time,
)
from cooperative.tools.safety import critical_surface, slices_at_rest
from tests import ROOT
from tests.cooperative.scene.test_moving_water import LEVEL, scene

HOURS = (0.0, 3600.0, 7200.0, 10800.0)


def rising(samples=30):
    """A scene whose heads rise for two hours and fall again, of samples whose cohesion varies much."""
    heads = {0.0: 0.0, 3600.0: 1.5, 7200.0: 3.0, 10800.0: 1.0}
    rows = [[x, z, t, 1.0 + heads[t] * (1 - x / 22)] for t in HOURS for x in (0.0, 22.0) for z in (0.0, 8.0)]
    campaign = replace(parse(scene("", LEVEL).replace("cov = 0.3", "cov = 0.5")), rain=Rain(HOURS, pressure=rows))
    return replace(campaign, plan=replace(campaign.plan, samples=samples))


@pytest.fixture
def asked(monkeypatch):
    """Runs that fail where slices have a factor below 1.16 on the rough grid and 1.13 on the refined."""
    record = []

    def ask(runner, grid, at, numbers):
        factors = np.minimum.accumulate(runner.kept.factors, axis=1)
        for number in numbers:
            record.append((grid, at, number))
            yield number, bool(factors[number, at] < {"rough": 1.16, "refined": 1.13}[grid])

    monkeypatch.setattr(_answer.StateRunner, "ask", ask)
    return record


@pytest.fixture
def screened(monkeypatch):
    """Factors of slices, which take seconds."""

    def factors(runner, progress):
        if runner.kept.factors is not None:
            return runner.kept.factors
        strength = np.random.default_rng(1).normal(1.2, 0.1, (runner.campaign.plan.samples, 1))
        return runner.kept.screen(strength - np.array([0.0, 0.05, 0.1, 0.08]))

    monkeypatch.setattr(_answer, "screened", factors)


@pytest.mark.usefixtures("screened")
def test_first_failures_are_those_of_all_runs_at_all_times(asked, tmp_path):
    campaign = rising()
    said = []
    result = probability_in_time(campaign, tmp_path, refined_runs=20, progress=said.append)
    lows = np.minimum.accumulate(result.factors, axis=1)
    for grid, critical, found in (
        ("rough", 1.16, result.rough),
        ("refined", 1.13, np.array([result.refined[n] for n in range(20)])),
    ):
        fails = lows[: len(found)] < critical
        wanted = np.where(fails.any(axis=1), fails.argmax(axis=1), len(HOURS))
        np.testing.assert_array_equal(found, wanted)
        assert 0 < (found < len(HOURS)).mean() < 1, grid
    # After the peak no factor is lower than before, so that no run is asked for there.
    assert 3 not in {at for _, at, _ in asked}
    assert result.runs == {
        "rough": len([each for each in asked if each[0] == "rough"]),
        "refined": len(asked) - result.runs["rough"],
    }
    assert result.runs["rough"] < 2.2 * 30
    chances = [each.probability for each in result.estimates]
    assert chances[0] < chances[2] == chances[3]
    for each in result.estimates:
        assert each.interval[0] <= each.probability <= each.interval[1]
    assert "of 30 under way" in "\n".join(said)

    # The same call runs nothing again, and gives the same.
    before = len(asked)
    again = probability_in_time(campaign, tmp_path, refined_runs=20)
    assert len(asked) == before
    np.testing.assert_array_equal(again.rough, result.rough)

    write_in_time(result, tmp_path)
    with (tmp_path / "probability.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["P_f"]) for row in rows] == pytest.approx(chances)
    assert json.loads((tmp_path / "probability.json").read_text())["runs"] == result.runs
    with (tmp_path / "first_failures.csv").open() as file:
        first = [row["first failure, rough [s]"] for row in csv.DictReader(file)]
    assert first == ["none" if at == len(HOURS) else str(HOURS[at]) for at in result.rough]
    assert f"{chances[2]:6.3f}" in "\n".join(lines(result))


def slide(number: int, coefficients) -> FinishedRun:
    """What a slide of a sample is said to do; of every fifth one it broke off."""
    row = {"displacement": 2.0 + number, "broke_off": number % 5 == 0}
    mode = ("deep", "shallow")[number % 2]
    row |= {} if row["broke_off"] else {"runout": 3.0 + number, "volume": 10.0, "mode": mode, "walls": "x = 40 m"}
    return FinishedRun(number, "SETTLED", 9, 0.1, coefficients, row)


@pytest.mark.usefixtures("screened", "asked")
def test_samples_that_fail_slide_to_their_end_and_are_kept(tmp_path, monkeypatch):
    """Each once, from its own time, also after a kill; what tables, page and terminal say of them adds up."""
    began, killed = [], [4]

    def run(runner, grid, at, numbers, stop_at):
        assert stop_at is None
        for number in numbers:
            if len(began) == killed[0]:
                raise KeyboardInterrupt
            began.append((grid, at, number))
            yield slide(number, runner.coefficients[number])

    monkeypatch.setattr(_answer.StateRunner, "run", run)
    campaign = rising()
    result = probability_in_time(campaign, tmp_path, refined_runs=20)
    with pytest.raises(KeyboardInterrupt):
        slides_in_time(result, tmp_path)
    assert len(read_rows(tmp_path / "slides", "refined").numbers) == 4
    killed[0] = None
    slides = slides_in_time(result, tmp_path)
    assert sorted((number, at) for _, at, number in began) == sorted(result.first.items())
    assert {grid for grid, _, _ in began} == {"refined"}
    np.testing.assert_array_equal(slides.columns["sample"], sorted(result.first))
    np.testing.assert_array_equal(np.array(HOURS)[slides.at], slides.columns["failed_at"])
    before = len(began)
    again = slides_in_time(result, tmp_path)
    assert len(began) == before
    np.testing.assert_array_equal(again.column("runout"), slides.column("runout"))
    with pytest.raises(ValueError, match="to another scene"):
        slides_in_time(replace(result, campaign=rising(31)), tmp_path)
    few = replace(campaign, plan=replace(campaign.plan, slides=3))
    assert slides_in_time(replace(result, campaign=few), tmp_path / "few").at.size == 3

    paths = {path.name for path in write_in_time(result, tmp_path, slides)}
    assert {"failures.png", "failures.csv", "slides.csv", "report.html"} <= paths
    with (tmp_path / "failures.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["fail first, rough"]) for row in rows] == result.counts("rough").tolist()
    assert [int(row["slides"]) for row in rows] == result.counts("refined").tolist()
    whole = [number for number in result.first if number % 5]
    assert sum(int(row["deep"]) for row in rows) == sum(number % 2 == 0 for number in whole)
    with (tmp_path / "slides.csv").open() as file:
        each = list(csv.DictReader(file))
    assert [float(row["t [s]"]) for row in each] == [HOURS[result.first[int(row["sample"])]] for row in each]
    runout = f"runout [m from its rear to its front, where {campaign.runout_thickness:.3g} m is left]"
    assert sum(row[runout] == "" for row in each) == len(each) - len(whole)
    page = (tmp_path / "report.html").read_text()
    assert f"{len(each) - len(whole)} of them broke off" in page
    assert f"{result.estimates[-1].probability:.3g}" in page
    words = "\n".join(lines(result, slides))
    assert f"{result.counts('refined')[1]} slid, run-out" in words
    wall = f"the slide reached the wall at x = 40 m, which held it, in {len(whole)} refined runs"
    assert wall in page
    assert wall in words


@pytest.mark.usefixtures("screened", "asked")
def test_classes_of_storms_add_up_to_a_year(tmp_path):
    """1 - exp(-sum of frequency x P_f), and so the ends of the interval; the page has that of one class."""
    campaign = rising()

    def of(name, frequency):
        storm = replace(campaign, name=name, plan=replace(campaign.plan, annual_frequency=frequency))
        return probability_in_time(storm, tmp_path / name, refined_runs=0)

    storms = {"often": of("often", 0.5), "rare": of("rare", 0.02)}
    last = [storm.estimates[-1] for storm in storms.values()]
    year = annual_in_time(storms)
    assert year.probability == pytest.approx(1 - np.exp(-0.5 * last[0].probability - 0.02 * last[1].probability))
    ends = [1 - np.exp(-0.5 * last[0].interval[end] - 0.02 * last[1].interval[end]) for end in (0, 1)]
    assert year.interval == pytest.approx(ends)
    assert f"{year.probability:.3g}" in "\n".join(lines_of_year(year))
    with pytest.raises(ValueError, match=r"annual_frequency is not known of rare: give how often"):
        annual_in_time(storms | {"rare": of("without", None)})
    write_in_time(storms["rare"], tmp_path)
    alone = json.loads((tmp_path / "probability.json").read_text())["annual"]
    assert alone["probability"] == pytest.approx(1 - np.exp(-0.02 * last[1].probability))
    assert "come 0.02 times a year" in (tmp_path / "report.html").read_text()


def test_scenarios_with_frequencies_are_classes(tmp_path, monkeypatch):
    """The command runs each in a folder of its own and adds up; a class without a frequency is refused first."""
    base = scene().replace("samples =", "annual_frequency = 0.1\nsamples =")
    light = '\n[[scenario]]\nname = "light"\n"rain.rate" = "2 mm/h"\n'
    path, ran = tmp_path / "storm.toml", []
    monkeypatch.setattr(seepage_tool, "wetted", lambda *_, **__: None)
    monkeypatch.setattr(seepage_tool, "lines", lambda _: ["flow"])
    monkeypatch.setattr(seepage_tool, "write_wetted", lambda *_: [])
    monkeypatch.setattr(
        in_time_tool, "annual_in_time", lambda answers: Annual(0.1, (0.0, 0.2), ((next(iter(answers)), 1.0, 0.1),))
    )

    def run(campaign, folder, refined_runs, budget):
        ran.append((campaign.rain.rate[0][1], campaign.plan.annual_frequency, folder.relative_to(tmp_path)))

    monkeypatch.setattr(_commands, "_in_time", run)
    path.write_text(base + light + '"campaign.annual_frequency" = 2.0\n')
    _commands.seepage(parser().parse_args(["seepage", str(path), "--probability"]))
    assert [(round(rate * 3.6e6), often) for rate, often, _ in ran] == [(14, 0.1), (2, 2.0)]
    assert len({folder for *_, folder in ran}) == 2
    path.write_text(scene() + light + '"campaign.annual_frequency" = 2.0\n')
    with pytest.raises(ValueError, match="annual_frequency is not known of base"):
        _commands.seepage(parser().parse_args(["seepage", str(path), "--probability"]))


@pytest.mark.usefixtures("screened")
def test_the_rough_grid_alone_is_plain_monte_carlo(asked, tmp_path):
    result = probability_in_time(rising(), tmp_path, refined_runs=0)
    assert {grid for grid, _, _ in asked} == {"rough"}
    shares = [(result.rough <= at).mean() for at in range(len(HOURS))]
    assert [each.probability for each in result.estimates] == pytest.approx(shares)


@pytest.mark.usefixtures("asked", "screened")
def test_a_folder_of_something_else_and_damage_are_refused(tmp_path):
    campaign = rising(12)
    probability_in_time(campaign, tmp_path, refined_runs=0)
    with pytest.raises(ValueError, match="to another scene"):
        probability_in_time(rising(13), tmp_path, refined_runs=0)
    with pytest.raises(ValueError, match="asked in time: `jaxmpm resume"):
        run(campaign, tmp_path / "slides")
    with closing(sqlite3.connect(tmp_path / "slides" / "campaign.db", isolation_level=None)) as database:
        database.execute("UPDATE campaign SET value = 'perhaps' WHERE name LIKE 'answer rough 3 %'")
    with pytest.raises(ValueError, match=r"answer rough 3 . than was written"):
        probability_in_time(campaign, tmp_path, refined_runs=0)


@pytest.mark.usefixtures("asked", "screened")
def test_a_damaged_database_keeps_the_answers_that_are_whole(tmp_path):
    probability_in_time(rising(12), tmp_path, refined_runs=0)
    path = tmp_path / "slides" / "campaign.db"
    before = kept_in(tmp_path)
    with pytest.warns(UserWarning, match=r"in_time, factors, \d+ answers and 0 runs are whole"):
        mend(path, before.store.digest, "made up")
    after = kept_in(tmp_path)
    assert after.answers == before.answers
    np.testing.assert_array_equal(after.factors, before.factors)


KILLED = """
import os, signal, sys
from pathlib import Path
from cooperative.tools.in_time import _answer, probability_in_time
from tests.cooperative.tools.test_in_time import rising

def screened(runner, progress):
    return runner.kept.screen(_answer.np.linspace(1.1, 1.3, 12)[:, None] - _answer.np.array([0.0, 0.05, 0.1, 0.08]))

def ask(runner, grid, at, numbers):
    for number in numbers:
        if len(runner.kept.answers) == 7:
            os.kill(os.getpid(), signal.SIGKILL)
        yield number, bool(runner.kept.factors[number, at] < 1.16)

_answer.screened, _answer.StateRunner.ask = screened, ask
probability_in_time(rising(12), Path(sys.argv[1]), refined_runs=0)
"""


def test_a_kill_loses_no_answer(asked, screened, tmp_path):
    """Each is stored as it comes: a process killed within a round leaves all that had been computed, and goes on."""
    killed = subprocess.run([sys.executable, "-c", KILLED, tmp_path], cwd=ROOT, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    kept = kept_in(tmp_path)
    assert len(kept.answers) == 7
    now = progress_in_time(tmp_path)
    assert (now.grids[0].planned, now.running, now.estimate) == (12, False, None)
    assert now.grids[0].done <= 7
    with pytest.raises(ValueError, match="have run to their end yet: `jaxmpm resume"):
        read_in_time(tmp_path)
    probability_in_time(rising(12), tmp_path, refined_runs=0)
    assert not {("rough", at, number) for _, number, at in kept.answers} & set(asked)
    assert progress_in_time(tmp_path).grids[0].done == 12


@pytest.mark.usefixtures("asked", "screened", "unrendered")
def test_a_folder_is_read_again_without_a_run(tmp_path, monkeypatch, capsys):
    """status, report, export and resume of the folder and of its `slides` give what the first call gave."""
    campaign = replace(rising(), hazard=Hazard())
    xarray = pytest.importorskip("xarray")
    columns = runs.build(campaign, "refined", runs.random_soil(campaign), at_rest=False).columns
    reached = np.zeros(columns.shape)
    reached[columns.shape[0] // 2 :] = 1.0

    def run(runner, grid, at, numbers, stop_at):
        """Soil of every third slide lies on the second half of the ground."""
        for number in numbers:
            fields = dict.fromkeys((*runs.COLUMNS, runs.GROUND_MOVED), reached * (number % 3 == 0))
            row = {"displacement": 2.0, "broke_off": False, "area_columns": 0.0, "runout": 1.0 + number, "depth": 2.0}
            yield FinishedRun(number, "SETTLED", 9, 0.1, runner.coefficients[number], row, fields)

    monkeypatch.setattr(_answer.StateRunner, "run", run)
    result = probability_in_time(campaign, tmp_path, refined_runs=20)
    share = np.mean([number % 3 == 0 for number in result.first])
    with pytest.raises(ValueError, match="have run to their end yet"):
        read_in_time(tmp_path)
    slides = slides_in_time(result, tmp_path)
    write_in_time(result, tmp_path, slides)
    first = (tmp_path / "report.html").read_text()

    for name in ("ask", "run"):
        monkeypatch.delattr(_answer.StateRunner, name)
    folders = (str(tmp_path), str(tmp_path / "slides"))
    for folder in folders:
        again, slid = read_in_time(folder)
        np.testing.assert_array_equal(again.rough, result.rough)
        assert again.refined == result.refined
        assert again.estimates == result.estimates
        assert slid.notes == slides.notes
        assert again.runs == result.runs
        np.testing.assert_array_equal(slid.columns["sample"], slides.columns["sample"])
        assert main(["status", folder]) == 0
        assert f"{slides.at.size} of {slides.at.size} samples" in capsys.readouterr().out
        assert main(["export", folder, "--as", "table", "maps", "netcdf"]) == 0
        with xarray.open_dataset(tmp_path / "slides" / "campaign.nc", engine="h5netcdf") as data:
            assert data.attrs["probability_of_failure"] == result.estimates[-1].probability
            there = reached[columns.ground] > 0
            np.testing.assert_allclose(data["map_reached"], there * share * result.estimates[-1].probability)
        with (tmp_path / "slides" / "table.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert [int(row["sample"]) for row in rows] == sorted(result.first)
        # Each slide stands for as many failures.
        assert sum(float(row["weight"]) for row in rows) == pytest.approx(result.estimates[-1].probability)
        for option in (["--verify"], ["--slides-t-end", "9"], ["--dask", "x"]):
            assert main(["resume", folder, *option]) == 2
            assert f"{option[0]} is of a campaign" in capsys.readouterr().err
    for command in (["report", folders[0]], ["resume", folders[1], "--workers", "1"]):
        (tmp_path / "report.html").unlink()
        assert main(command) == 0
        assert (tmp_path / "report.html").read_text() == first
        assert f"{result.estimates[-1].probability:6.3f}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda campaign: replace(campaign, rain=None), "no water moves"),
        (lambda campaign: replace(campaign, plan=replace(campaign.plan, calibrate=True)), "calibrate"),
    ],
)
def test_what_has_no_answer_in_time_is_refused(change, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        probability_in_time(change(rising()), tmp_path)
    assert not list(tmp_path.iterdir())


def test_fewer_refined_samples_than_an_estimate_takes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="give 10 or more"):
        probability_in_time(rising(), tmp_path, refined_runs=5)


@dataclass(frozen=True)
class MadeUp:
    """Slices at rest at a time, which Spencer's method cannot solve late for weak samples."""

    time: float
    strength: float = 1.0

    def slip(self, points, method):
        if method == "spencer" and self.time > 0 and self.strength < 1:
            return None
        return SimpleNamespace(factor=self.strength - self.time / 36000 + 0.1 * (method == "janbu"))


def test_one_method_orders_the_states_of_a_sample(asked, monkeypatch, tmp_path):
    """Where a rigorous method has no answer in a state, Janbu's gives the factors of all states."""
    surface = SimpleNamespace(slip=SimpleNamespace(points=None, method="spencer"), circle=None)
    for name, value in {
        "critical_surface": lambda section: surface,
        "rested": lambda campaign, time: SimpleNamespace(time=time),
        "slices_at_rest": lambda resting: MadeUp(resting.time),
        "sample_strength": lambda model, coefficients: float(coefficients[0] > 0) + 0.5,
    }.items():
        monkeypatch.setattr(_answer, name, value)
    monkeypatch.setattr(runs, "build", lambda *_, **__: None)
    campaign = rising(12)
    factors = probability_in_time(campaign, tmp_path, refined_runs=0).factors
    weak = runs.coefficients_of(campaign, runs.random_soil(campaign))[:, 0] <= 0
    assert 0 < weak.sum() < 12
    expected = np.where(weak, 0.6, 1.5)[:, None] - np.array(HOURS) / 36000
    np.testing.assert_allclose(factors, expected)


@pytest.mark.slow  # two searches for a critical surface
def test_slices_screen_each_sample_with_its_own_strength(asked, tmp_path):
    """A factor rises with the cohesion of its sample along the slip, and falls with the pressure of its time."""
    campaign = rising(12)
    result = probability_in_time(campaign, tmp_path, refined_runs=0)
    assert np.isfinite(result.factors).all()
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil, at_rest=False)
    slip = critical_surface(slices_at_rest(rested(campaign, HOURS[0]))).slip.points
    x = np.linspace(slip[0, 0], slip[-1, 0], 60)
    points = np.stack([x, np.interp(x, *slip.T)])
    nearest = cKDTree(np.asarray(model.scene.particles.position).T).query(points.T)[1]
    samples = runs.coefficients_of(campaign, soil)
    along = [float(np.mean(np.asarray(model.parameters(sample)["cohesion"])[nearest])) for sample in samples]
    assert np.corrcoef(along, result.factors[:, 0])[0, 1] > 0.99
    assert np.all(result.factors[:, 2] < result.factors[:, 0])
