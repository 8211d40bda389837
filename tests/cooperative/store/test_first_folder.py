"""Campaign folders that earlier versions wrote still open, are read and reported, and go on."""

import json
import shutil
import tarfile
import warnings

import numpy as np
import pytest

from cooperative import Campaign, run, runs
from cooperative.reporting import export, progress_of, report
from cooperative.scene import campaign_of
from cooperative.store import read_rows, read_sample, read_store
from tests import ROOT

HERE = ROOT / "tests"
FIRST = HERE / "reference" / "first_campaign.tar.gz"
STORED = {name: HERE / "data" / f"{name}.tar.xz" for name in ("screening", "audit", "finished")}
"""One campaign of version 0.1.0 with one file per sample, killed while it screened, killed in its audit with a restart
point of each kind, and finished, with three slides."""


@pytest.fixture
def folder(tmp_path):
    """Four samples of the small slope on both grids, as the first version wrote them."""
    with tarfile.open(FIRST) as archive:
        archive.extractall(tmp_path / "first", filter="data")
    return tmp_path / "first"


def test_its_rows_coefficients_and_scene_are_read(folder):
    store = read_store(folder)
    campaign = campaign_of(store)
    rough, refined = read_rows(store, "rough"), read_rows(store, "refined")
    assert rough.numbers == refined.numbers == [0, 1, 2, 3]
    assert not rough.damaged + refined.damaged
    assert (campaign.plan.samples, campaign.estimator.name) == (4, "published")
    assert np.sum(refined.columns["displacement"] > campaign.run.failure_displacement) == 3
    # The same number still means the same field.
    drawn = runs.coefficients_of(campaign, runs.random_soil(campaign))
    for number in refined.numbers:
        coefficients = read_sample(store, "refined", number).coefficients
        np.testing.assert_allclose(coefficients, drawn[number], rtol=1e-4, atol=1e-5)
    assert progress_of(folder).grids[1].done == 4


def test_it_goes_on_with_what_it_has(folder):
    before = json.loads((folder / "summary.json").read_text())
    text = (folder / "scene.toml").read_text()
    stamps = {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")}
    summary = run(text, folder).as_json()
    assert {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")} == stamps
    for name in ("probability_of_failure", "interval", "estimator", "samples", "refined_runs", "failures_refined"):
        assert summary[name] == before[name], name
    for name, spread in before["consequences_of_failures"].items():
        assert {key: summary["consequences_of_failures"][name][key] for key in spread} == pytest.approx(spread), name


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The three folders, unpacked."""
    folder = tmp_path_factory.mktemp("stored")
    for path in STORED.values():
        with tarfile.open(path) as packed:
            packed.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize(
    ("name", "done", "answer"),
    [
        ("screening", [5, 0, 0], "0.200"),
        ("audit", [14, 4, 0], "0.369"),
        pytest.param("finished", [14, 10, 3], "0.327", marks=pytest.mark.slow),
    ],
)
def test_a_stored_folder_opens_tells_how_far_it_is_and_is_reported(stored, tmp_path, name, done, answer):
    folder = tmp_path / name
    shutil.copytree(stored / name, folder)
    assert [grid.done for grid in progress_of(folder).grids] == done
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        words = report(folder)
    assert answer in words
    assert (folder / "report.html").stat().st_size > 10_000
    written = {path.name for path in export(folder, ["table", "hdf5"])}
    assert written == {"table.csv", "campaign.h5"}
    assert (folder / "table.csv").read_text().count("\n") == 1 + done[0] + done[1]


def test_a_finished_folder_keeps_the_slides_of_its_earlier_draw(stored, tmp_path):
    folder = tmp_path / "finished"
    shutil.copytree(stored / "finished", folder)
    files = {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")}
    summary = run((folder / "scene.toml").read_text(), folder)
    assert (summary.slides, summary.slides_drawn) == (3, 3)
    assert {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")} == files


@pytest.mark.parametrize("name", [pytest.param("screening", marks=pytest.mark.slow), "audit"])
def test_a_folder_killed_half_way_gives_the_answer_that_it_would_have_had(stored, tmp_path, name, monkeypatch):
    folder = tmp_path / name
    monkeypatch.setattr(Campaign, "failing_volume", None)  # these campaigns count any particle
    shutil.copytree(stored / name, folder)
    before = {grid: read_rows(read_store(folder), grid) for grid in ("rough", "refined")}
    whole = {grid: read_rows(read_store(stored / "finished"), grid).columns for grid in ("rough", "refined")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        summary = run((folder / "scene.toml").read_text(), folder)
    expected = json.loads((stored / "finished" / "summary.json").read_text())
    for key in ("refined_runs", "failures_rough", "failures_refined", "slides"):
        assert getattr(summary, key) == expected[key], key
    # Runs of another machine differ by rounding.
    assert summary.probability_of_failure == pytest.approx(expected["probability_of_failure"], rel=1e-3)
    for grid, columns in whole.items():
        rows = read_rows(read_store(folder), grid)
        assert rows.numbers == columns["sample"].tolist()
        # Slides were drawn in another way then; runs that went equally far are alike.
        alike = rows.columns["status"] == columns["status"]
        displacement = rows.columns["displacement"][alike]
        assert displacement == pytest.approx(columns["displacement"][alike], rel=0.02, abs=1e-3)
        assert alike.sum() >= len(alike) - 2 * expected["slides"]
        limit = campaign_of(read_store(folder)).run.failure_displacement
        assert np.array_equal(rows.columns["displacement"] > limit, columns["displacement"] > limit)
        earlier = np.isin(rows.numbers, before[grid].numbers)
        if grid == "rough":
            assert rows.columns["seconds"][earlier].tolist() == before[grid].columns["seconds"].tolist()
    assert not [path for path in folder.glob("restart/*") if not path.name.startswith("moving-")]
