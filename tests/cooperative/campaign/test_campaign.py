"""Campaigns end to end on a small slope: the answer, going on after any interruption, and what is refused."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import kl
from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.reporting import report
from cooperative.scene import parse
from cooperative.store import open_store, read_rows, read_sample, read_store, write_sample
from cooperative.summary import summarise
from jaxmpm import Status
from tests import ROOT
from tests.databases import finished
from tests.scenes import model_of

SCENES = ROOT / "benchmarks" / "scenes"


def changed(old, new):
    assert old in TINY
    return TINY.replace(old, new)


def test_refined_runs_are_the_worst_ranked_and_end_with_k_t_that_stand(tiny_campaign):
    store, summary = read_store(tiny_campaign[0]), tiny_campaign[1]
    rough, refined = read_rows(store, "rough"), read_rows(store, "refined")
    order = np.argsort(-rough.columns["displacement"], kind="stable")
    ran = refined.numbers
    assert sorted(order[: len(ran)].tolist()) == ran
    if len(ran) < 6:
        by_rank = [refined.columns["displacement"][ran.index(n)] > 1.0 for n in order[: len(ran)].tolist()]
        assert by_rank[-2:] == [False, False]
    failures = int(np.sum(refined.columns["displacement"] > 1.0))
    assert 0 < failures < 6
    assert summary.probability.value == failures / 6
    assert summary.probability.interval[0] < summary.probability.value < summary.probability.interval[1]


def test_two_phase_campaign_spends_its_budget(tmp_path):
    text = changed('estimator = "published"', "refined_runs = 10").replace("samples = 6", "samples = 14")
    summary = run(text, tmp_path / "two-phase")
    assert summary.probability.estimator == "two-phase"
    assert summary.cost.refined_runs == 10
    low, high = summary.probability.interval
    assert 0 <= low < summary.probability.value < high <= 1
    assert summary.probability.others.keys() <= {"published n/N"}
    assert run(text, tmp_path / "two-phase") == summary


def test_a_sample_can_be_made_again_from_its_number(tiny_campaign):
    model = model_of(TINY, at_rest=True)
    coefficients = runs.coefficients_of(model.campaign, model.soil)
    stored = read_sample(read_store(tiny_campaign[0]), "rough", 4)
    again = next(iter(runs.run_samples(model, coefficients, [4], width=1)))
    assert np.array_equal(stored.coefficients, coefficients[4])
    assert np.array_equal(stored.fields["displacement"], again.fields["displacement"])
    assert dict(stored.row) == dict(again.row)


def test_refined_failures_get_a_mode_and_its_onset(tiny_campaign):
    store = read_store(tiny_campaign[0])
    refined = read_rows(store, "refined").columns
    failed = refined["displacement"] > 1.0
    assert set(refined["mode"][~failed]) <= {"none"}
    assert set(refined["mode"][failed]) <= {"shallow", "deep", "progressive"}
    assert (refined["onset"][failed] > 0).all()
    assert (refined["onset"][failed] < 4.0).all()
    assert np.isnan(refined["onset"][~failed]).all()
    np.testing.assert_allclose(refined["depth_deepest"][failed], refined["depth"][failed], rtol=1e-6)
    assert "mode" not in read_rows(store, "rough").columns


def rough_rows(text, samples, widths):
    """Rows of the first rough samples by their number, run with each of these numbers of lanes."""
    model = model_of(text, at_rest=True)
    coefficients = runs.coefficients_of(model.campaign, model.soil)
    return [
        {s.number: dict(s.row) for s in runs.run_samples(model, coefficients, range(samples), width=width)}
        for width in widths
    ]


def test_the_past_of_a_sample_does_not_depend_on_its_neighbours():
    rows = rough_rows(changed('fields = "both"', 'modes = "both"'), samples=5, widths=(1, 2))
    assert rows[0] == rows[1]
    assert any(row["mode"] != "none" for row in rows[0].values())


def test_both_grids_see_the_same_field(tiny_campaign):
    campaign = parse(TINY)
    soil = runs.random_soil(campaign)
    rough, refined = (runs.build(campaign, grid, soil) for grid in ("rough", "refined"))
    coefficients = jnp.asarray(runs.coefficients_of(campaign, soil)[0])
    # The mean over the four refined particles of a rough one differs from it by the field's curvature only.
    fine = {
        tuple(p): s
        for p, s in zip(
            np.asarray(refined.scene.particles.position).T.round(3),
            np.asarray(refined.strength(coefficients)),
            strict=True,
        )
    }
    coarse = np.asarray(rough.strength(coefficients))
    means, at = [], []
    for i, (x, z) in enumerate(np.asarray(rough.scene.particles.position).T.round(3)):
        around = [
            fine.get((np.float32(x + dx).round(3), np.float32(z + dz).round(3)))
            for dx in (-0.25, 0.25)
            for dz in (-0.25, 0.25)
        ]
        if None not in around:
            means.append(np.mean(around))
            at.append(i)
    assert len(at) > 0.9 * coarse.size
    assert np.allclose(means, coarse[at], rtol=0.02)
    common = jnp.asarray([[3.0, 7.0], [2.0, 9.0]])
    values = [kl.field_at(model.soil.expansions["strength"], coefficients, common) for model in (rough, refined)]
    assert np.array_equal(*values)


def test_killed_campaign_goes_on_and_ends_the_same(tiny_campaign, tmp_path):
    _, summary = tiny_campaign
    scene = tmp_path / "tiny.toml"
    scene.write_text(TINY)
    again = tmp_path / "again"
    command = [sys.executable, "-m", "cooperative", "run", str(scene), "--out", str(again)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ)
    deadline = time.monotonic() + 120
    while len(finished(again, "rough")) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = finished(again, "rough")
    assert len(before) >= 2
    resumed = run(TINY, again)
    assert before.items() <= finished(again, "rough").items()
    assert replace(resumed, cost=replace(resumed.cost, seconds=summary.cost.seconds)) == summary


def test_broken_off_runs_are_stored_counted_and_reported(tmp_path):
    model = model_of(TINY, at_rest=True)
    state = replace(model.state, velocity=model.state.velocity.at[0, 5].set(jnp.nan))
    coefficients = runs.coefficients_of(model.campaign, model.soil)
    with open_store(tmp_path / "broken", TINY) as store:
        for sample in runs.run_samples(replace(model, state=state), coefficients, [0, 1], width=2):
            write_sample(store, "rough", sample)
        summary = summarise(model.campaign, read_rows(store, "rough"), read_rows(store, "refined"))
    assert summary.cost.broke_off["rough"] == {0: "NOT_FINITE at step 1", 1: "NOT_FINITE at step 1"}
    assert summary.cost.status["rough"] == {Status.NOT_FINITE.name: 2}


@pytest.mark.usefixtures("unrendered")
def test_samples_with_a_strength_that_none_may_have_break_off_and_are_reported(tmp_path, tiny_campaign, monkeypatch):
    whole = read_store(tiny_campaign[0])
    worst = int(np.argmax(read_rows(whole, "rough").columns["displacement"]))
    spoilt = {"rough": (worst + 1) % 6, "refined": worst}
    xi = {grid: read_sample(whole, "rough", number).coefficients for grid, number in spoilt.items()}
    varied = runs.GridModel.varied

    def spoiling(model, coefficients):
        parameters = varied(model, coefficients)
        bad = jnp.nan if model.grid == "rough" else 0.0
        other = {"strength": parameters["strength"].at[3].set(bad)}
        return other if np.array_equal(coefficients, xi[model.grid]) else parameters

    monkeypatch.setattr(runs.GridModel, "varied", spoiling)
    folder = tmp_path / "bad"
    summary = run(TINY, folder)
    assert summary.cost.broke_off == {grid: {n: "BAD_PARAMETER at step 0"} for grid, n in spoilt.items()}
    assert [summary.cost.status[grid]["BAD_PARAMETER"] for grid in spoilt] == [1, 1]
    store = read_store(folder)
    for grid, number in spoilt.items():
        rows = read_rows(store, grid)
        assert rows.columns["broke_off"].tolist() == [n == number for n in rows.numbers]
    # Neighbours are what they are without it; the sample that broke off on the rough grid runs on the refined one.
    others = [n for n in range(6) if n != spoilt["rough"]]
    assert [dict(read_sample(store, "rough", n).row) for n in others] == [
        dict(read_sample(whole, "rough", n).row) for n in others
    ]
    assert spoilt["rough"] in read_rows(store, "refined").numbers
    words = report(folder, slides=0)
    page = (folder / "report.html").read_text()
    for grid, number in spoilt.items():
        line = f"sample {number} on the {grid} grid: BAD_PARAMETER at step 0"
        assert f"BROKE OFF      {line}" in words
        assert f"broke off: {line}" in page


def test_folder_of_another_scene_is_refused(tiny_campaign):
    with pytest.raises(ValueError, match=r"belongs to another scene .*campaign.seed"):
        run(changed("seed = 3", "seed = 4"), tiny_campaign[0])


@pytest.mark.parametrize("name", ["paper", "paper_section", "slope", "section", "demo"])
def test_scenes_that_come_along_are_sound(name):
    campaign = parse((SCENES / f"{name}.toml").read_text())
    soil = runs.random_soil(campaign)
    assert soil.expansions["strength"].variance_mean > 0.998
    first = runs.coefficients_of(campaign, soil)
    assert first.shape == (campaign.plan.samples, soil.modes)
    assert np.array_equal(first, runs.coefficients_of(campaign, soil))


def test_paper_scene_holds_the_published_numbers():
    campaign = parse((SCENES / "paper.toml").read_text())
    published = json.loads((ROOT / "tests" / "reference" / "paper.json").read_text())
    slope, soil = published["slope"], published["soil"]
    shape, strength = campaign.site.shape, campaign.random["strength"]
    assert (shape.crest, shape.height, shape.run_per_rise) == (30.0, 12.0, 2.0)
    sizes = {"toe_m": shape.toe, "foundation_m": shape.foundation, "length_y_m": shape.width}
    stiffness = {
        "E_Pa": campaign.soil.young,
        "nu": campaign.soil.poisson,
        "unit_weight_N_m3": campaign.soil.unit_weight,
    }
    softening = {"softening_modulus_Pa": campaign.soil.softening_modulus}
    field = {"Su_mean_Pa": strength.mean, "Su_cov": strength.cov}
    field |= dict(zip(("lx_m", "ly_m", "lz_m"), strength.length, strict=True))
    assert slope | sizes == slope
    assert soil | stiffness | softening | field == soil
    assert campaign.run.t_end == published["run"]["t_end_s"]
    for name, grid in campaign.grids.items():
        assert (grid.cell, list(grid.spacing)) == (slope[name]["cell_m"], slope[name]["spacing_xyz_m"])
