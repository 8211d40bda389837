"""Retention and conductivity against their printed formulae; suction stress and weight."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.accuracy.seepage_exact import Curves
from jaxmpm import seepage
from jaxmpm.seepage._soil import CARSEL_PARRISH

pytestmark = pytest.mark.usefixtures("x64")


def gardner(**values):
    return seepage.gardner(**{"conductivity": 1e-5, "alpha": 2.0, "porosity": 0.4, **values})


@pytest.mark.parametrize("name", CARSEL_PARRISH)
def test_classes_follow_the_printed_curves(name):
    soil = seepage.soil_class(name, air_entry=0.0)
    values = {field: float(getattr(soil, field)) for field in ("conductivity", "alpha", "n", "porosity", "residual")}
    printed, heads = Curves(**values), -np.logspace(-2, 1.5, 40)
    np.testing.assert_allclose(soil.water_content(heads), printed.water(heads), rtol=1e-12)
    np.testing.assert_allclose(soil.relative_conductivity(heads), printed.k(heads) / printed.conductivity, rtol=1e-6)
    assert np.all(np.asarray(soil.saturation(np.array([0.0, 5.0]))) == 1)


def test_loam_has_its_published_numbers():
    loam = seepage.soil_class("loam")
    assert float(loam.conductivity) == pytest.approx(24.96 / 100 / 86400)
    assert (float(loam.alpha), float(loam.n), float(loam.air_entry)) == (3.6, 1.56, 0.02)
    assert float(seepage.soil_class("sand", conductivity=1e-3).conductivity) == 1e-3


@jax.jit
def newton_step(soil, head, change):
    """The soil's shape, its saturation, where a change of Newton's variable ends, and the saturation there."""
    shape, saturation = soil.shape(), soil.saturation(head)
    moved = soil.moved(head, saturation, change / shape.steepest, shape)
    return shape, saturation, moved, soil.saturation(moved)


@given(st.sampled_from([*CARSEL_PARRISH, "gardner"]), st.floats(-3, 2.9), st.floats(-1.5, 1.5))
def test_newtons_variable_is_saturation_where_dry_and_head_where_wet(name, power, change):
    with jax.enable_x64(True):
        soil = gardner() if name == "gardner" else seepage.soil_class(name)
        head = -(10.0**power)
        shape, saturation, moved, after = jax.tree.map(float, newton_step(soil, head, change))
        wet = head >= shape.switch
        wanted = change + (shape.saturation + shape.steepest * (head - shape.switch) if wet else saturation)
        if wanted <= shape.saturation:
            least = 0.2 * min(saturation, shape.saturation)
            assert after == pytest.approx(max(wanted, least), rel=1e-6)
        else:
            assert moved - shape.switch == pytest.approx(
                (wanted - shape.saturation) / shape.steepest, abs=1e-9 + 1e-9 / float(soil.alpha)
            )


@jax.jit
def curves(soil, heads):
    return soil.curves(heads, soil.shape())


@jax.jit
def slopes_of(soil, heads):
    return jax.vmap(jax.grad(soil.saturation))(heads)


@given(st.sampled_from([*CARSEL_PARRISH, "gardner"]), st.floats(-2, 3))
def test_saturation_and_conductivity_fall_with_suction_and_keep_a_slope(name, power):
    with jax.enable_x64(True):
        soil = gardner() if name == "gardner" else seepage.soil_class(name)
        heads = np.array([-(10.0**power) * 1.01 - 0.03, -(10.0**power) - 0.03])
        (saturation, relative), slopes = map(np.asarray, curves(soil, heads)), slopes_of(soil, heads)
        assert 0 < saturation[0] < saturation[1] <= 1
        assert 0 < relative[0] < relative[1] <= 1
        assert np.all(np.asarray(slopes) > 0)


def test_suction_holds_grains_together_and_pressure_parts_them():
    """Lu, Godt and Wu (2010), eq. 7: suction over (1 + (alpha s)^n)^((n - 1) / n)."""
    loam = seepage.soil_class("loam", air_entry=0.0)
    suction = np.array([0.1, 1.0, 10.0])
    closed = 9810 * suction / (1 + (3.6 * suction) ** 1.56) ** (0.56 / 1.56)
    np.testing.assert_allclose(seepage.suction_stress(loam, -suction), -closed, rtol=1e-12)
    np.testing.assert_allclose(seepage.suction_stress(loam, np.array([2.0])), [19620.0])


def test_weight_is_that_of_grains_and_water():
    loam = seepage.soil_class("loam")
    assert float(seepage.moist_weight(loam, 3.0, 15e3)) == pytest.approx(15e3 + 0.43 * 9810)
    assert 15e3 + 0.078 * 9810 < float(seepage.moist_weight(loam, -100.0, 15e3)) < 15e3 + 0.15 * 9810


def test_layers_have_their_soils_numbers():
    soil = seepage.zoned([gardner(), gardner(conductivity=1e-9)], np.array([0, 1, 1]))
    np.testing.assert_array_equal(soil.conductivity, [1e-5, 1e-9, 1e-9])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: seepage.soil_class("mud"), "soil class 'mud': give one of sand"),
        (lambda: seepage.soil_class("loam", n=0.9), "n = 0.9: give a finite value above 1"),
        (lambda: gardner(conductivity=0.0), "conductivity = 0 m/s"),
        (lambda: gardner(residual=0.5), "residual = 0.5 is no less than porosity"),
        (lambda: gardner(beta=0.5), "beta: Gardner has conductivity, alpha"),
        (lambda: seepage.gardner(alpha=1.0, porosity=0.3), "Gardner lacks conductivity"),
        (lambda: seepage.zoned([gardner(), seepage.soil_class("loam")], np.zeros(2, int)), "give soils of one class"),
        (lambda: seepage.zoned([gardner()], np.array([1])), "give 0 to 0"),
    ],
)
def test_bad_soil_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
