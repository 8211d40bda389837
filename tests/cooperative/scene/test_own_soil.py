"""A soil and a law of the user's own in a campaign: what varies in it reaches its particles as in any other."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
import kl
from benchmarks.robustness.invented import TINY
from cooperative import runs
from cooperative.scene import RandomField, parse
from jaxmpm.laws import add, elastic_increment
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant
from jaxmpm.transfer import band_thickness


@mpm.pytree
@dataclass(frozen=True)
class Tresca(mpm.laws.Law):
    """In plane strain: strength S (r + (1 - r) exp(-3 g / g95)), with g the plastic shear strain."""

    bulk: Any
    shear: Any
    strength: Any
    remoulded: Any
    g95: Any

    PARAMETERS = {  # noqa: RUF012
        "strength": mpm.laws.Parameter(above=0, unit="Pa", reduced=True),
        "remoulded": mpm.laws.Parameter(least=0, most=1, name="residual_ratio"),
        "g95": mpm.laws.Parameter(above=0, name="strain_95", per_band=True),
    }

    def initial_history(self, particles):
        return jnp.zeros_like(particles.mass)

    def update(self, strain_increment, stress, history, dt=None):
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        t = safe_sqrt(second_invariant(deviator(trial)))
        left = self.remoulded + (1 - self.remoulded) * jnp.exp(-3 * history / self.g95)
        beyond = jnp.maximum(t - self.strength * left, 0)
        pressure, scale = mean(trial), 1 - beyond / jnp.where(t > 0, t, 1)
        xx, yy, zz, xy, yz, xz = (scale * s for s in deviator(trial))
        return (xx + pressure, yy + pressure, zz + pressure, xy, yz, xz), history + beyond / self.shear


@dataclass(frozen=True)
class SensitiveClay:
    """strain_95: of a shear band half a metre thick."""

    strength: float = 30e3
    residual_ratio: float = 0.2
    strain_95: float = 0.4
    unit_weight: float = 20e3

    def material(self, dtype, band):
        number = partial(jnp.asarray, dtype=dtype)
        return Tresca(number(2e7), number(1e7), number(self.strength), number(self.residual_ratio),
                      number(self.strain_95 * 0.5 / band))  # fmt: skip


VARIES = {
    "strength": RandomField(30e3, 0.3, (10.0, 3.0), kl.Lognormal, kl.Exponential, 0.95, trend=1.5e3),
    "strain_95": RandomField(0.4, 0.1, (10.0, 3.0), kl.Lognormal, kl.Exponential, 0.95),
}


def model_of(grid="rough", random=VARIES, soil=None):
    campaign = replace(parse(TINY), soil=soil or SensitiveClay(), random=random)
    return runs.build(campaign, grid, runs.random_soil(campaign), at_rest=False)


@pytest.mark.parametrize("grid", ["rough", "refined"])
def test_what_varies_in_a_soil_of_the_users_own_reaches_its_law(grid):
    model = model_of(grid)
    xi = np.random.default_rng(2).standard_normal(model.soil.modes).astype(np.float32)
    drawn, (scene, _) = model.parameters(xi), model.of_sample(xi)
    law, numerics = scene.material, model.campaign.grids[grid]
    band = numerics.cell if numerics.internal_length is None else band_thickness(numerics.internal_length)
    assert {*drawn} == {"strength", "strain_95"}
    assert isinstance(law, Tresca)
    np.testing.assert_allclose(law.strength, drawn["strength"], rtol=1e-6)
    np.testing.assert_allclose(law.g95, drawn["strain_95"] * 0.5 / band, rtol=1e-5)
    assert np.std(np.asarray(law.g95)) > 0.01 * np.mean(np.asarray(law.g95))
    assert float(law.remoulded) == pytest.approx(0.2)
    depth = model.campaign.site.depth(np.asarray(scene.particles.position), VARIES["strength"], 0)
    plain = model_of(grid, VARIES | {"strength": replace(VARIES["strength"], trend=None)}).parameters(xi)
    np.testing.assert_allclose(drawn["strength"], plain["strength"] * (1 + depth * 1.5e3 / 30e3), rtol=1e-5)


def test_calibration_reduces_what_the_law_declares_as_strength_and_nothing_else():
    model = model_of()
    xi = np.random.default_rng(2).standard_normal(model.soil.modes).astype(np.float32)
    before, after = model.parameters(xi), model.with_strength_factor(0.8).parameters(xi)
    np.testing.assert_allclose(after["strength"], 0.8 * before["strength"], rtol=1e-6)
    np.testing.assert_array_equal(after["strain_95"], before["strain_95"])


def test_a_campaign_of_a_soil_of_the_users_own_has_a_size_and_runs():
    model = model_of()
    assert runs.grid_size(model.campaign, "rough").steps > 100
    scene, state = model.of_sample()
    fallen = mpm.solve(mpm.reduced(scene, 20.0), state, t_end=0.5).raise_if_failed()
    assert float(np.max(np.linalg.norm(np.asarray(fallen.state.displacement), axis=0))) > 0.05


def test_what_is_no_parameter_of_the_soil_cannot_vary():
    refused = "random holds viscosity, which is no parameter of Tresca: give some of .*, residual_ratio, strain_95"
    with pytest.raises(ValueError, match=refused):
        model_of(random={"viscosity": VARIES["strength"]})


OF_THE_PACKAGE = {
    "ocr": (mpm.CamClaySoil(0.1, 0.02, 1.0, ocr=4.0), 4.0, False),
    "active_strength": (mpm.AnisotropicSoil(40e3, 32e3, 24e3), 40e3, True),
    "static_friction": (mpm.GranularSoil(40.0, 50.0, 1e-2), 40.0, False),
}


@pytest.mark.parametrize("name", OF_THE_PACKAGE)
def test_numbers_of_each_law_of_the_package_vary_in_a_campaign(name):
    soil, mean, strained = OF_THE_PACKAGE[name]
    campaign = replace(
        parse(TINY.replace("t_end = 4.0", "t_end = 0.2")), soil=soil,
        random={name: RandomField(mean, 0.05, (10.0, 3.0), kl.Lognormal, kl.Exponential, 0.95)},
    )  # fmt: skip
    model = runs.build(campaign, "rough", runs.random_soil(campaign))
    xi = np.random.default_rng(2).standard_normal((1, model.soil.modes)).astype(np.float32)
    own = model.parameters(xi[0])[name]
    assert np.std(np.asarray(own)) > 0.01 * mean
    (sample,) = runs.run_samples(model, xi, [0])
    assert not sample.row["broke_off"]
    assert 0 <= sample.row["displacement"] < 1.0
    assert ("plastic_strain" in sample.fields) == strained
