"""What a scene can ask of a campaign beyond the usual: estimators, calibration, modes of old folders."""

import html
import json
from dataclasses import replace

import numpy as np
import pytest

import jaxmpm as mpm
import kl
from cooperative import run, runs
from cooperative.reporting import report
from cooperative.reporting._progress import progress_of
from cooperative.scene import parse, stored_measured, with_measured
from cooperative.store import Rows, open_store, read_rows, read_store
from cooperative.summary import Summary, summarise
from tests.cooperative.campaign.test_campaign import TINY, changed
from tests.databases import keep, stored

AS_PUBLISHED = TINY.replace("tension_cutoff = 0.0", 'tension_cutoff = 0.0\nsoftening_length = "cell"').replace(
    "spacing = [", "fbar = false\nspacing = ["
)
SUBSET = (
    changed('estimator = "published"', 'estimator = "subset"\nlevels = 1\nreplicates = 2\nrefined_runs = 12')
    .replace("samples = 6", "samples = 40")
    .replace("k_t = 2\n", "")
)


@pytest.mark.slow
def test_subset_simulation_runs_from_a_scene(tmp_path):
    folder = tmp_path / "out"
    summary = run(SUBSET, folder)
    store = read_store(folder)
    rough = read_rows(store, "rough")
    assert rough.numbers == list(range(76))
    assert 0 < summary.cost.refined_runs <= 12
    assert summary.cost.finished == "the refined runs allowed are spent"
    low, high = summary.probability.interval
    assert 0 <= low < summary.probability.value < high <= 1
    assert set(summary.probability.others) == set()
    assert progress_of(folder).grids[0].planned == 76
    # The chains of the upper level lie above the rough threshold of the lower one.
    displacement = rough.columns["displacement"]
    assert np.median(displacement[20:38]) > np.median(displacement[:20])


def test_answers_of_a_scene_do_not_follow_the_cell_unless_it_says_so(tmp_path):
    rough, refined = (parse(TINY).grids[grid] for grid in ("rough", "refined"))
    assert parse(TINY).soil.softening_length == 8.0 / 5
    assert (rough.cell_average, rough.fbar, rough.internal_length) == (True, False, None)
    assert (refined.cell_average, refined.fbar) == (True, False)
    assert refined.internal_length == pytest.approx(8.0 / 5 / np.sqrt(2 * np.pi))
    published = parse(AS_PUBLISHED)
    assert published.soil.softening_length == "cell"
    numerics = {(grid.cell_average, grid.fbar, grid.internal_length) for grid in published.grids.values()}
    assert numerics == {(None, False, None)}
    assert parse(changed("softening_modulus = 85e3\n", "")).soil.softening_length is None
    displacements = []
    for name, text in (("default", TINY), ("published", AS_PUBLISHED)):
        run(text.replace("samples = 6", "samples = 3"), tmp_path / name)
        displacements.append(read_rows(read_store(tmp_path / name), "rough").columns["displacement"])
    assert np.all(np.abs(displacements[0] / displacements[1] - 1) > 1e-3)


@pytest.mark.parametrize(("cell", "toe"), [(2.0, 16.0), (3.0, 17.0)])
def test_strength_is_the_fields_at_each_particle_or_at_the_centre_of_its_cell(cell, toe):
    text = changed("toe = 16.0", f"toe = {toe}").replace("cell = 2.0", f"cell = {cell}")
    length = "length = [20.0, 4.0]"
    per_particle, per_cell = (parse(text.replace(length, f"{length}\n{line}")) for line in ("", 'sampled_at = "cells"'))
    with pytest.raises(
        ValueError, match=r"sampled_at = 'cell': give one of 'particles', 'cells', 'cell averages' \(did you mean"
    ):
        parse(text.replace(length, f'{length}\nsampled_at = "cell"'))
    soil = runs.random_soil(per_particle)
    xi = np.random.default_rng(1).standard_normal(soil.modes)
    models = [runs.build(campaign, "rough", soil) for campaign in (per_particle, per_cell)]
    plain, even = (np.asarray(model.strength(xi)) for model in models)
    position = np.asarray(models[0].scene.particles.position)
    centre = np.minimum((np.floor(position / cell) + 0.5) * cell, np.array([[16.0 + toe], [10.0]]))
    marginal = per_particle.random["strength"].distribution
    assert even == pytest.approx(
        np.asarray(marginal.transform(kl.field_at(soil.expansions["strength"], xi, centre))), rel=1e-5
    )
    assert plain == pytest.approx(
        np.asarray(marginal.transform(kl.field_at(soil.expansions["strength"], xi, position))), rel=1e-5
    )
    cells = np.unique(centre, axis=1).shape[1]
    assert np.unique(even).size == cells < np.unique(plain).size


def test_a_scene_can_choose_how_its_answers_follow_the_cell():
    choices = 'spacing = [0.5, 0.5]\nfbar = false\ninternal_length = "none"'
    campaign = parse(changed("spacing = [0.5, 0.5]", choices))
    assert not campaign.grids["refined"].cell_average
    assert campaign.grids["refined"].internal_length is None
    assert campaign.grids["rough"].cell_average
    assert campaign.soil.softening_length == 8.0 / 5
    short = parse(changed("spacing = [0.5, 0.5]", "spacing = [0.5, 0.5]\ninternal_length = 0.1"))
    with pytest.raises(ValueError, match=r"internal_length = 0\.1 m is less than cells"):
        runs.build(short, "refined", runs.random_soil(short))
    with pytest.raises(ValueError, match=r"softening_length = 'mesh' is text: give a number, or 'cell'"):
        parse(changed("tension_cutoff = 0.0", 'softening_length = "mesh"'))


def test_a_scene_knows_every_choice_of_clay_and_grid():
    text = changed(
        "softening_modulus = 85e3", "strain_95 = 0.5\nrate_coefficient = 0.1\nsoftening_length = 1.0"
    ).replace("cell = 2.0", 'cell = 2.0\nkernel = "quadratic b-spline"\napic = true\nflip = 0.0\ndamping = 0.1')
    campaign = parse(text)
    assert (campaign.soil.strain_95, campaign.soil.rate_coefficient, campaign.soil.softening_length) == (0.5, 0.1, 1.0)
    rough = campaign.grids["rough"]
    assert (rough.kernel, rough.apic, rough.flip, rough.damping) == (mpm.QuadraticBSpline, True, 0.0, 0.1)


@pytest.mark.parametrize("estimator", ["control variate", pytest.param("monte carlo", marks=pytest.mark.slow)])
def test_the_first_samples_run_refined(estimator, tmp_path):
    text = changed('estimator = "published"', f'estimator = "{estimator}"\nrefined_runs = 10')
    summary = run(text.replace("samples = 6", "samples = 12"), tmp_path / "out")
    assert read_rows(read_store(tmp_path / "out"), "refined").numbers == list(range(10))
    assert summary.cost.finished == "the refined runs allowed are spent"
    assert summary.probability.convergence.refined_runs == (10,)
    estimators = {summary.probability.estimator, *summary.probability.others}
    assert {"Monte Carlo", "multifidelity control variate"} == estimators - {"published n/N"}


def test_calibration_is_measured_once_and_lowers_the_rough_strength(tmp_path):
    # A median strength of 30 kPa.
    text = changed('estimator = "published"', 'estimator = "published"\ncalibrate = true')
    text = text.replace("mean = 30e3", f"mean = {30e3 * np.sqrt(1 + 0.4**2)}")
    summary = run(text, tmp_path / "out")
    calibration = summary.probability.calibration
    assert calibration.factor == pytest.approx(calibration.refined / calibration.rough)
    assert 0.5 < calibration.factor < 1
    before = (tmp_path / "out" / "campaign.db").read_bytes()
    assert run(text, tmp_path / "out") == summary
    assert (tmp_path / "out" / "campaign.db").read_bytes() == before
    # The same samples as without; they slide farther.
    campaign = with_measured(parse(text), tmp_path / "out")
    assert campaign.measured.calibration.factor == calibration.factor
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    plain, weaker = (runs.build(c, "rough", soil) for c in (parse(text), campaign))
    np.testing.assert_allclose(
        weaker.strength(coefficients[0]), calibration.factor * plain.strength(coefficients[0]), rtol=1e-5
    )
    assert runs.build(campaign, "refined", soil).strength_factor == 1.0
    displacement = read_rows(read_store(tmp_path / "out"), "rough").columns["displacement"]
    # The least one hardly yields: how far it swings back hides how far it slid.
    farthest = int(np.argmax(displacement))
    without = next(iter(runs.run_samples(plain, coefficients, [farthest])))
    assert displacement[farthest] > without.row["displacement"]


def test_known_factors_of_safety_are_taken_from_the_scene(tmp_path):
    text = changed('fields = "both"', "calibrate = true\n[calibration]\nrough = 1.2\nrefined = 1.1")
    text = text.replace("t_end = 4.0", "t_end = 0.3")
    factors = run(text, tmp_path / "out").as_json()["probability"]["calibration"]
    assert factors == {"rough": 1.2, "refined": 1.1, "factor": pytest.approx(1.1 / 1.2)}
    assert stored(tmp_path / "out", "measured")["calibration"] == {"rough": 1.2, "refined": 1.1}


def test_summary_tells_modes_fits_severity_and_what_more_runs_would_buy(tiny_campaign):
    folder, summary = tiny_campaign
    modes = summary.modes.shares
    assert sum(part.count for part in modes.values()) == summary.probability.failures_refined
    assert sum(part.ratio for part in modes.values()) == pytest.approx(1.0)
    assert sum(part.probability for part in modes.values()) == pytest.approx(summary.probability.value)
    for part in modes.values():
        assert part.interval[0] <= part.ratio <= part.interval[1]
    occurring = {mode for mode, part in modes.items() if part.count}
    assert summary.consequences.fits.keys() == {"all", *occurring}
    assert "too few" in summary.consequences.fits["all"]["displacement"].notes[0]
    assert {rank.group for rank in summary.modes.severity["volume"]} == occurring
    left = 6 - summary.cost.refined_runs
    assert summary.cost.after_more_runs.runs == summary.cost.after_more_runs.samples_left == left
    assert -1 <= summary.probability.grids.spearman <= 1
    assert summary.probability.convergence.probability[-1] == summary.probability.value
    assert "NaN" not in (folder / "summary.json").read_text()
    assert Summary.from_json((folder / "summary.json").read_text()) == summary


def test_rows_written_before_modes_were_stored_still_read(tiny_campaign):
    campaign, store = parse(TINY), read_store(tiny_campaign[0])
    rough, refined = read_rows(store, "rough"), read_rows(store, "refined")
    new = ("mode", "masses", "depth_shallowest", "depth_deepest", "onset", "onset_second")
    old = Rows({name: column for name, column in refined.columns.items() if name not in new}, ())
    summary = summarise(campaign, rough, old)
    assert summary.modes.shares is None
    assert summary.consequences.fits.keys() == {"all"}
    assert summary.probability.value == summarise(campaign, rough, refined).probability.value
    nothing = Rows({name: column[:0] for name, column in refined.columns.items()}, ())
    assert summarise(replace(campaign), rough, nothing).probability.grids is None


@pytest.mark.parametrize(
    "content",
    [
        "[1.2, 1.1]",
        '{"rough": 1.2}',
        '{"rough": true, "refined": 1.1}',
        '{"rough": NaN, "refined": 1.1}',
        "[" * 100_000,
    ],
)
def test_stored_factors_of_safety_are_checked_like_a_scenes(tmp_path, content):
    open_store(tmp_path, TINY).close()
    keep(tmp_path, "measured", f'{{"calibration": {content}}}')
    with pytest.raises(ValueError, match=r"campaign\.db holds no measured that .*delete from campaign"):
        stored_measured(tmp_path)


@pytest.mark.usefixtures("unrendered")
def test_warnings_of_a_check_stand_in_the_summary_and_on_the_page(tmp_path, capsys):
    text = TINY.replace("length = [20.0, 4.0]", "length = [20.0, 1.0]").replace("t_end = 4.0", "t_end = 0.2")
    text = text.replace("samples = 6", "samples = 2").replace("k_t = 2", "k_t = 1")
    said = list(runs.warnings_of(parse(text)))
    assert said != list(runs.warnings_of(parse(TINY)))
    assert any("results change with the cell" in warning for warning in said)
    summary = run(text, tmp_path)
    assert list(summary.warnings) == said
    printed, page = report(tmp_path), (tmp_path / "report.html").read_text()
    for warning in said:
        assert f"  WARNING        {warning}" in printed
        assert f'<p class="note">{html.escape(warning)}</p>' in page
    assert json.loads((tmp_path / "summary.json").read_text())["warnings"] == said
