"""Campaigns whose failure is the limit load: the displacement that it gives, kept, told and used everywhere."""

import json

import pytest

import jaxmpm as mpm
from benchmarks.invented import TINY
from cooperative import run, runs
from cooperative.scene import campaign_of, parse
from cooperative.store import read_rows, read_store

PLASTIC = (
    TINY.replace("softening_modulus = 85e3\nresidual_ratio = 0.5\n", "")
    .replace("cell = 1.0\nspacing = [0.5, 0.5]", "cell = 2.0\nspacing = [1.0, 1.0]")
    .replace("[run]\n", '[run]\nfailure = "limit load"\n')
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limit") / "out"
    return folder, run(PLASTIC, folder)


def test_samples_fail_from_the_displacement_at_the_limit_load(done):
    folder, summary = done
    found = summary["limit_load"]
    assert 0.5 < found["factor"] < 3.0
    assert 0.01 < found["displacement"] < 1.0
    moved = read_rows(read_store(folder), "refined").columns["displacement"]
    assert summary["failures_refined"] == (moved > found["displacement"]).sum()
    said = f"failure counts from {found['displacement']:g} m, where the slope of median soil passes its limit load"
    assert any(said in note for note in summary["notes"])


def test_the_two_factors_of_the_slope_of_median_soil_agree(done):
    campaign, found = parse(PLASTIC), done[1]["limit_load"]
    scene, state = runs.build(campaign, "refined", runs.random_soil(campaign)).median
    for share, fails in ((0.98, False), (1.02, True)):
        result = mpm.solve(mpm.reduced(scene, share * found["factor"]), state, t_end=4.0, settle=mpm.Settle())
        assert (float(mpm.diagnostics.largest_displacement(result.state)) > found["displacement"]) == fails


def test_it_is_measured_once_and_kept(done):
    folder, summary = done
    stamp = (folder / "limit_load.json").stat().st_mtime_ns
    assert run(PLASTIC, folder) == summary
    assert (folder / "limit_load.json").stat().st_mtime_ns == stamp
    campaign = campaign_of(read_store(folder))
    assert campaign.run.failure_displacement == summary["limit_load"]["displacement"]
    assert campaign.run.settle.slides == campaign.run.failure_displacement
    assert parse(campaign.text).run == campaign.run
    (folder / "limit_load.json").write_text(json.dumps({**summary["limit_load"], "displacement": -1.0}))
    with pytest.raises(ValueError, match=r"limit_load\.json holds no limit load .*delete it to measure it again"):
        campaign_of(read_store(folder))


def test_what_does_not_go_with_it_is_refused():
    both = PLASTIC.replace("t_end = 4.0", "t_end = 4.0\nfailure_displacement = 0.5")
    with pytest.raises(ValueError, match="failure_displacement has no say beside failure = 'limit load'"):
        parse(both)
    table = "\n[limit_load]\nfactor = 1.1\ndisplacement = 0.3\n"
    with pytest.raises(ValueError, match=r"table \[limit_load\] without"):
        parse(TINY + table)
    early = PLASTIC.replace("k_t = 2", "k_t = 2\nscreening_stop = 0.2")
    assert parse(early).plan.screening_stop == 0.2
    with pytest.raises(ValueError, match=r"screening_stop = 0\.2 m is below the failure displacement of 0\.3 m"):
        parse(early + table)
