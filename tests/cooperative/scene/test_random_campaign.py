"""A campaign in whose soil all varies that may: it runs, goes on, is exported, and its samples are made again."""

from pathlib import Path

import h5py
import jax.numpy as jnp
import numpy as np
import pytest

from cooperative import run, runs
from cooperative.exports._export import export, run_again
from cooperative.reporting import report
from cooperative.runs._executors import run_sample
from cooperative.scene import parse
from cooperative.store import read_rows, read_sample, read_store, restart_path
from tests.cooperative.scene.test_random_soil import ALL, changed
from tests.scenes import model_of


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A campaign of all that may vary, which has run."""
    text = changed(ALL, ("t_end = 4.0", "t_end = 1.5"), ("samples = 6", "samples = 3"), ("k_t = 2", "k_t = 1"))
    text = changed(text, ("cell = 1.0\nspacing = [0.5, 0.5]", "cell = 2.0\nspacing = [1.0, 1.0]"))
    folder = tmp_path_factory.mktemp("soil") / "out"
    return text, folder, run(text, folder)


@pytest.mark.usefixtures("unrendered")
def test_a_campaign_of_many_random_parameters_runs_and_is_reported(done):
    text, folder, summary = done
    assert summary.cost.broke_off == {"rough": {}, "refined": {}}
    assert run(text, folder) == summary
    displacement = read_rows(read_store(folder), "rough").columns["displacement"]
    assert np.unique(displacement).size == 3
    assert (displacement > 0).all()
    page = report(folder)
    for name in ("field", "field-friction", "field-young", "field-unit_weight", "field-softening_strain"):
        assert (Path(folder) / "figures" / f"{name}.png").is_file()
    assert page


def test_a_sample_of_such_a_campaign_is_made_again_from_its_coefficients(done):
    text, folder, _ = done
    model = model_of(text, at_rest=True, folder=folder)
    stored = read_sample(read_store(folder), "rough", 1)
    again = run_again(model, stored, np.array([0.0, stored.steps * model.time_step(stored.coefficients)]))
    np.testing.assert_allclose(again.state.displacement, stored.fields["displacement"], atol=2e-4)


def test_a_worker_makes_the_same_sample(done):
    text, folder, _ = done
    stored = read_sample(read_store(folder), "rough", 2)
    again = run_sample(runs.packed(parse(text)), "rough", 2, stored.coefficients, None, folder=folder)
    assert dict(again.row) == dict(stored.row)


def test_a_run_that_was_stopped_goes_on_bit_for_bit(done):
    text, folder, _ = done
    model = model_of(text, "refined", at_rest=True, folder=folder)
    number = read_rows(read_store(folder), "refined").numbers[0]
    stored = read_sample(read_store(folder), "refined", number)
    looks = iter([False, False, True])
    with pytest.raises(runs.Stopped):
        list(run_samples(model, stored, folder, lambda: next(looks, True)))
    assert restart_path(folder, "refined", number).is_file()
    (again,) = run_samples(model, stored, folder, lambda: False)
    assert np.array_equal(again.fields["displacement"], stored.fields["displacement"])
    assert dict(again.row) == dict(stored.row)


def run_samples(model, sample, folder, stop):
    return runs.run_samples(
        model, {sample.number: sample.coefficients}, [sample.number], width=1, restart_in=folder, stop=stop
    )


def test_such_a_campaign_is_exported_with_its_parameters(done):
    folder = done[1]
    files = [str(path) for path in export(folder)]
    series = next(file for file in files if file.endswith("rough-000001.vtkhdf"))
    with h5py.File(series) as file:
        points = file["VTKHDF/PointData"]
        model = model_of(done[0])
        expected = model.parameters(read_sample(read_store(folder), "rough", 1).coefficients)
        for name, values in expected.items():
            count = values.shape[0]
            np.testing.assert_allclose(points[name][:count], values, rtol=1e-5)


def test_a_friction_that_is_no_number_ends_its_sample_alone(done, monkeypatch):
    text, folder, _ = done
    campaign, varied = parse(text), runs.GridModel.varied
    model = runs.build(campaign, "rough", runs.random_soil(campaign), folder=folder)
    coefficients = runs.coefficients_of(campaign, model.soil)

    def spoiling(model, xi):
        parameters = varied(model, xi)
        bad = {**parameters, "friction": parameters["friction"].at[3].set(jnp.nan)}
        return bad if np.array_equal(xi, coefficients[0]) else parameters

    monkeypatch.setattr(runs.GridModel, "varied", spoiling)
    rows = {sample.number: sample for sample in runs.run_samples(model, coefficients, [0, 1], width=1)}
    assert (rows[0].status, rows[0].steps, rows[0].row["broke_off"]) == ("BAD_PARAMETER", 0, True)
    assert dict(rows[1].row) == dict(read_sample(read_store(folder), "rough", 1).row)
