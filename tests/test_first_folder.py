"""A campaign's folder written by the first version still opens, is read, and goes on."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from cooperative import run, runs
from cooperative.reporting import progress_of
from cooperative.scene import campaign_of
from cooperative.store import read_rows, read_sample, read_store

KEPT = Path(__file__).parent / "reference" / "first_campaign.tar.gz"


@pytest.fixture
def folder(tmp_path):
    """Four samples of the small slope on both grids, as the first version wrote them."""
    with tarfile.open(KEPT) as kept:
        kept.extractall(tmp_path / "first", filter="data")
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
        kept = read_sample(store, "refined", number).coefficients
        np.testing.assert_allclose(kept, drawn[number], rtol=1e-4, atol=1e-5)
    assert progress_of(folder).grids[1].done == 4


def test_it_goes_on_with_what_it_has(folder):
    before = json.loads((folder / "summary.json").read_text())
    text = (folder / "scene.toml").read_text()
    stamps = {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")}
    found = run(text, folder)
    assert {path: path.stat().st_mtime_ns for path in folder.glob("samples/*/*.h5")} == stamps
    for name in ("probability_of_failure", "interval", "estimator", "samples", "refined_runs", "failures_refined"):
        assert found[name] == before[name], name
    for name, spread in before["consequences_of_failures"].items():
        assert {key: found["consequences_of_failures"][name][key] for key in spread} == pytest.approx(spread), name
