"""Campaigns whose failure is the limit load: the displacement that it gives, stored, reported and used everywhere."""

from types import SimpleNamespace

import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.scene import Calibration, LimitLoad, Measured, campaign_of, measure_limit_load, parse
from cooperative.scene import keep as keep_measured
from cooperative.store import open_store, read_rows, read_store
from tests.databases import keep, stored

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
    limit_load = summary.probability.limit_load
    assert 0.5 < limit_load.factor < 3.0
    assert 0.01 < limit_load.displacement < 1.0
    displacement = read_rows(read_store(folder), "refined").columns["displacement"]
    assert summary.probability.failures_refined == (displacement > limit_load.displacement).sum()
    assert limit_load.volume == 0.05 * 8.0**2
    rule = (
        f"a slope fails when 3.2 m2 moves {limit_load.displacement:g} m, "
        "the displacement of median soil at its limit load"
    )
    assert any(rule in note for note in summary.notes)
    known = f"factor of safety {limit_load.factor:.3f}, displacement grows {limit_load.sharpness:.3g} times"
    assert any(known in note for note in summary.notes)
    assert limit_load.sharpness > 5


def test_the_two_factors_of_the_slope_of_median_soil_agree(done):
    campaign, limit_load = parse(PLASTIC), done[1].probability.limit_load
    scene, state = runs.build(campaign, "refined", runs.random_soil(campaign)).median
    for share, fails in ((0.98, False), (1.02, True)):
        result = mpm.solve(mpm.reduced(scene, share * limit_load.factor), state, t_end=4.0, rules=[mpm.Settle()])
        displacement = mpm.diagnostics.exceeded_displacement(scene, result.state, limit_load.volume)
        assert (float(displacement) > limit_load.displacement) == fails


def test_it_is_measured_once_and_stored(done):
    folder, summary = done
    before = (folder / "campaign.db").read_bytes()
    assert run(PLASTIC, folder) == summary
    assert (folder / "campaign.db").read_bytes() == before
    campaign = campaign_of(read_store(folder))
    assert campaign.run.failure_displacement == summary.probability.limit_load.displacement
    assert campaign.run.settling().slides == campaign.run.failure_displacement
    measured = stored(folder, "measured")
    keep(folder, "measured", measured | {"limit_load": measured["limit_load"] | {"displacement": -1.0}})
    with pytest.raises(ValueError, match=r"campaign\.db holds no measured .* = -1 m: .*delete from campaign"):
        campaign_of(read_store(folder))
    keep(folder, "measured", measured)


def test_a_campaign_killed_before_its_first_sample_measures_nothing_again(tmp_path, monkeypatch):
    class Killed(Exception):
        pass

    def kill(phase, *_):
        raise Killed(phase)

    def known_value(value):
        return lambda *_: value

    text = PLASTIC.replace("[campaign]\n", "[campaign]\ncalibrate = true\n").replace("t_end = 4.0", "t_end = 0.2")
    known = {"measure_limit_load": LimitLoad(1.2, 0.3, 7.5), "factors_of_safety": Calibration(1.2, 1.1)}
    for name, value in known.items():
        monkeypatch.setattr(f"cooperative.scene._measured.{name}", known_value(value))
    with pytest.raises(Killed, match="screening"):
        run(text, tmp_path, on_phase=kill)
    monkeypatch.undo()
    for name in known:
        monkeypatch.setattr(f"cooperative.scene._measured.{name}", kill)
    measured = stored(tmp_path, "measured")
    assert (measured["limit_load"]["displacement"], measured["calibration"]["rough"]) == (0.3, 1.2)
    summary = run(text, tmp_path)
    assert stored(tmp_path, "measured") == measured
    pf = summary.probability
    assert (pf.limit_load, pf.calibration.refined) == (LimitLoad(**measured["limit_load"]), 1.1)
    # A kill between two measurements costs the second alone.
    keep(tmp_path, "measured", {name: measured[name] for name in ("terms", "limit_load")})
    with pytest.raises(Killed):
        run(text, tmp_path)


def test_a_scene_says_how_much_soil_is_a_failure(monkeypatch):
    campaign = parse(PLASTIC.replace("t_end = 4.0", "t_end = 4.0\nleast_volume = 7.5"))
    asked = []

    def safe(scene, state, *, least_volume, **_):
        asked.append(least_volume)
        return SimpleNamespace(kink=1.2, sharpness=40.0, local=(1.1, 2.0))

    monkeypatch.setattr("cooperative.scene._measured.factor_of_safety", safe)
    monkeypatch.setattr("cooperative.scene._measured._displacement", lambda *_: 0.3)
    monkeypatch.setattr("cooperative.scene._measured.reduced", lambda scene, _: scene)
    model = SimpleNamespace(median=(SimpleNamespace(loads=mpm.Loads()), None))
    assert measure_limit_load(campaign, model) == LimitLoad(1.2, 0.3, 7.5, 40.0, (1.1, 2.0))
    assert measure_limit_load(parse(PLASTIC), model).volume == 3.2
    assert asked == [7.5, 3.2]


def test_a_stored_limit_load_is_checked_like_a_scenes(tmp_path):
    with open_store(tmp_path, PLASTIC) as store:
        load = {"factor": 1.1, "displacement": 0.3, "volume": 3.0}
        keep_measured(store, Measured(limit_load=LimitLoad(**load)))
        campaign = campaign_of(store)
    assert (campaign.run.failure_displacement, campaign.failing_volume) == (0.3, 3.0)
    keep(tmp_path, "measured", {"limit_load": load | {"displacement": -1}})
    with pytest.raises(ValueError, match=r"campaign\.db holds no measured .*displacement = -1.*delete from campaign"):
        campaign_of(read_store(tmp_path))


def test_what_does_not_go_with_it_is_refused():
    both = PLASTIC.replace("t_end = 4.0", "t_end = 4.0\nfailure_displacement = 0.5")
    with pytest.raises(ValueError, match="failure_displacement has no effect beside failure = 'limit load'"):
        parse(both)
    table = "\n[limit_load]\nfactor = 1.1\ndisplacement = 0.3\nvolume = 3.0\n"
    with pytest.raises(ValueError, match=r"\[limit_load\] is there without"):
        parse(TINY + table)
    other = PLASTIC.replace("t_end = 4.0", "t_end = 4.0\nleast_volume = 7.5") + table
    with pytest.raises(ValueError, match=r"least_volume = 7\.5 and \[limit_load\] volume = 3\.0 differ"):
        parse(other)
    for volume, message in (
        (-1.0, r"\[run\] least_volume = -1: give a finite value of 0 or more"),
        (1e4, "least_volume = 10000 m2: give more than 0 and less than .* 160"),
    ):
        with pytest.raises(ValueError, match=message):
            parse(TINY.replace("t_end = 4.0", f"t_end = 4.0\nleast_volume = {volume}"))
    with pytest.raises(ValueError, match="least_volume = 0 beside failure = 'limit load'"):
        parse(PLASTIC.replace("t_end = 4.0", "t_end = 4.0\nleast_volume = 0"))
    early = PLASTIC.replace("k_t = 2", "k_t = 2\nscreening_stop = 0.2")
    assert parse(early).plan.screening_stop == 0.2
    with pytest.raises(ValueError, match=r"screening_stop = 0\.2 m is below the failure displacement of 0\.3 m"):
        parse(early + table)
