"""Scenes whose soil varies in several parameters: fields, what correlates, what boreholes tell, what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kl
from benchmarks.robustness.invented import LAYERED, TINY
from cooperative import runs
from cooperative.scene import parse
from cooperative.tools.research.rare import slide_limit_state
from cooperative.tools.sweep import variants
from jaxmpm import FrictionalSoil, solve
from jaxmpm.laws import DruckerPrager, MohrCoulomb
from tests.scenes import model_of, tables

CLAY = TINY[TINY.index("softening_modulus") : TINY.index("[strength]")]
FIELDS = """
[soil.cohesion]
mean = 5e3
cov = 0.3
length = [20.0, 4.0]
[soil.friction]
mean = 22.0
cov = 0.2
marginal = "truncated normal"
lower = 5.0
upper = 50.0
length = [20.0, 4.0]
"""
SAND = TINY.replace(CLAY, "").replace(TINY[TINY.index("[strength]") : TINY.index("[rough]")], FIELDS)
CORRELATED = """
[cross_correlation]
parameters = ["cohesion", "friction"]
matrix = [[1.0, -0.5], [-0.5, 1.0]]
"""


def random(name, mean, cov, length="[10.0, 10.0]"):
    """The table of a parameter that varies."""
    return f"[soil.{name}]\nmean = {mean}\ncov = {cov}\nlength = {length}\n"


STIFF = random("young", "2e7", 0.5) + random("unit_weight", "20e3", 0.05)
LEFT = random("residual_cohesion", 400.0, 0.3) + random("residual_friction", 4.0, 0.05)
LEFT += random("softening_strain", 0.2, 0.3)
SOFT = SAND + LEFT
ALL = SAND.replace("unit_weight = 20e3\nyoung = 2e7\n", "") + STIFF + LEFT + CORRELATED
BRITTLE = random("softening_modulus", "85e3", 0.4, "[20.0, 4.0]") + random("residual_ratio", 0.5, 0.1, "[20.0, 4.0]")
BRITTLE += """[cross_correlation]
parameters = ["strength", "residual_ratio"]
matrix = [[1.0, 0.6], [0.6, 1.0]]
"""
CRACKED = TINY.replace("softening_modulus = 85e3\nresidual_ratio = 0.5\n", "") + BRITTLE


def changed(text, *changes):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def drawn(model, samples):
    return np.random.default_rng(1).standard_normal((samples, model.soil.modes)).astype(np.float32)


@jax.jit
def lognormal_at(expansion, marginal, coefficients, position):
    return marginal.transform(kl.field_at(expansion, coefficients, position))


def test_a_scene_of_clay_has_the_samples_that_it_always_had():
    campaign = parse(TINY)
    model = model_of(TINY)
    box = {"origin": (0.0, 0.0), "extent": (32.0, 10.0)}
    expansion = kl.expand((kl.SquaredExponential(20.0), kl.SquaredExponential(4.0)), **box, energy=0.999)
    coefficients = np.asarray(kl.latin_hypercube(jax.random.key(3), 6, expansion.modes))
    assert np.array_equal(runs.coefficients_of(campaign, model.soil), coefficients)
    xi, marginal = jnp.asarray(coefficients[2]), kl.Lognormal(30e3, 0.4)
    alone = lognormal_at(expansion, marginal, xi, model.scene.particles.position)
    assert model.names == ("strength",)
    assert np.array_equal(model.varied(xi)["strength"], alone)
    assert np.array_equal(model_of(changed(TINY, ("[strength]", "[soil.strength]"))).strength(xi), alone)


def test_soil_with_friction_has_the_law_and_the_cure_of_such_soil():
    model = model_of(SAND)
    assert model.campaign.soil == FrictionalSoil(5e3, 22.0, young=2e7, softening_length=None)
    assert isinstance(model.scene.material, MohrCoulomb)
    assert model.scene.numerics.cell_average
    assert not model.scene.numerics.fbar
    cone = changed(
        SAND, ("cell = 2.0", "cell = 2.0\ncell_average = false"), ("poisson", "law = 'drucker-prager'\npoisson")
    )
    assert isinstance(model_of(cone).scene.material, DruckerPrager)
    assert not model_of(cone).scene.numerics.cell_average
    xi = drawn(model, 1)[0]
    friction = np.asarray(model.parameters(xi)["friction"])
    assert 5 < friction.min() < friction.max() < 50
    np.testing.assert_allclose(model.varied(xi)["friction"], np.radians(friction), rtol=1e-6)
    with pytest.raises(ValueError, match="random are cohesion, friction, not the strength"):
        model.strength(xi)


def test_fields_that_no_table_correlates_have_coefficients_of_their_own():
    model = model_of(SAND)
    first, second = model.soil.groups
    assert sorted([*first.indices, *second.indices]) == list(range(model.soil.modes))
    shares = np.empty(model.soil.modes)
    for group in (first, second):
        shares[group.indices] = group.expansion.fractions
    assert (np.diff(shares) <= 0).all()
    xi = drawn(model, 1)[0]
    other = xi.copy()
    other[second.indices] += 1
    one, two = (model.parameters(each) for each in (xi, other))
    assert np.array_equal(one["cohesion"], two["cohesion"])
    assert not np.allclose(one["friction"], two["friction"])


@pytest.mark.parametrize("nataf", [False, True])
def test_fields_correlate_as_asked(nataf):
    tables = CORRELATED + f"nataf = {str(nataf).lower()}\n"
    strong = changed(tables, ("matrix = [[1.0, -0.5], [-0.5, 1.0]]", "matrix = [[1.0, -0.6], [-0.6, 1.0]]"))
    model = model_of(changed(SAND, ("cov = 0.3", "cov = 0.8")) + strong)
    (group,) = model.soil.groups
    modes = np.asarray(kl.field.mode_matrix(group.expansion, np.array([[7.0], [3.0]])))[0]
    sets = jax.vmap(model.soil.coefficients)(drawn(model, 20_000))
    score = {name: jnp.asarray(each @ modes / np.linalg.norm(modes)) for name, each in sets.items()}
    values = [model.campaign.random[name].distribution.transform(each) for name, each in score.items()]
    gaussian, own = np.corrcoef(*score.values())[0, 1], np.corrcoef(*values)[0, 1]
    assert (own if nataf else gaussian) == pytest.approx(-0.6, abs=0.015)
    assert abs(own - gaussian) > 0.03


def test_a_layer_of_another_distribution_has_not_the_correlation_of_nataf():
    """Its own root would be another one: -0.5 of the parameters was -0.38 where cov is 1.5."""
    drawn = "[ground]\nsurface = [[0, 10], [8, 10], [16, 2], [32, 2]]\n" + SAND[SAND.index("[soil]") :] + CORRELATED
    layer = '[[layer]]\nname = "loose"\ndepth = 2.0\ncohesion = { cov = 0.6 }\n[[layer]]\nname = "dense"\n'
    assert parse(drawn + layer).site.layers[0].random["cohesion"].cov == 0.6
    with pytest.raises(ValueError, match=r"layer 'loose'.cohesion\] has .* nataf in \[cross_correlation\]"):
        parse(drawn + "nataf = true\n" + layer)


def test_fields_that_correlate_are_conditioned_together():
    held = changed(FIELDS, ("length = [20.0, 4.0]\n", "length = [20.0, 4.0]\nboreholes = [[7.0, 3.0, 9e3]]\n"))
    model = model_of(changed(SAND, (FIELDS, held)) + CORRELATED)
    cohesion, friction = (model.campaign.random[name] for name in ("cohesion", "friction"))
    score = float(cohesion.distribution.standardise(jnp.asarray(9e3)))
    (group,) = model.soil.groups
    modes = np.asarray(kl.field.mode_matrix(group.expansion, np.array([[7.0], [3.0]])))[0]
    sets = jax.vmap(model.soil.coefficients)(drawn(model, 20_000))
    at = {name: np.asarray(each @ modes) for name, each in sets.items()}
    np.testing.assert_allclose(at["cohesion"], score, atol=2e-3)
    # Of two normal numbers of correlation r, the second has the mean r times the first, and a variance of 1 - r^2.
    variance = float(modes @ modes)
    assert at["friction"].mean() == pytest.approx(-0.5 * score, abs=0.02)
    assert at["friction"].var() == pytest.approx((1 - 0.25) * variance, rel=0.03)
    assert friction.boreholes is None


def test_a_trend_scales_the_field_with_depth_and_boreholes_know_it():
    trend = changed(TINY, ("cov = 0.4", "cov = 0.4\ntrend = 2e3"))
    plain, grown = model_of(TINY), model_of(trend)
    xi, position = drawn(plain, 1)[0], np.asarray(plain.scene.particles.position)
    depth = np.clip(10.0 - np.maximum(position[0] - 8.0, 0.0), 2.0, None) - position[1]
    assert depth.min() > 0
    assert depth.max() > 9
    expected = np.asarray(plain.strength(xi)) * (1 + depth * 2e3 / 30e3)
    np.testing.assert_allclose(grown.strength(xi), expected, rtol=1e-5)
    deepest = position[:, np.argmax(depth)]
    held = model_of(changed(trend, ("cov = 0.4", f"cov = 0.4\nboreholes = [[{deepest[0]}, {deepest[1]}, 70e3]]")))
    assert float(held.strength(xi)[np.argmax(depth)]) == pytest.approx(70e3, rel=2e-3)


def test_strata_dip_and_infinite_lengths_are_constant():
    text = changed(TINY, ("length = [20.0, 4.0]", "length = [inf, 2.0]\nbedding = { dip = 45.0 }"))
    model = model_of(text)
    xi, angle = drawn(model, 1)[0], np.radians(45.0)
    x, z = np.asarray(model.scene.particles.position, float)
    height = np.sin(angle) * x + np.cos(angle) * z  # normal to strata that fall towards +x
    order = np.argsort(height)
    log = np.log(np.asarray(model.strength(xi), float))[order]
    close = np.diff(height[order]) < 1e-3
    assert close.sum() > 20
    assert np.abs(np.diff(log))[close].max() < 2e-3
    assert np.ptp(log) > 0.5
    everywhere = model_of(changed(TINY, ("length = [20.0, 4.0]", "length = [inf, inf]")))
    assert everywhere.soil.modes == 1
    strength = np.asarray(everywhere.strength(np.array([-1.2], np.float32)))
    np.testing.assert_allclose(strength, float(kl.Lognormal(30e3, 0.4).transform(jnp.asarray(-1.2))), rtol=1e-5)


FALLING = """
[ground]
surface = [[0.0, 10.0], [16.0, 10.0], [24.0, 4.0], [40.0, 4.0]]
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
[strength]
mean = 30e3
cov = 0.4
length = [20.0, 2.0]
bedding = { dip = 20.0 }
""" + tables()


def test_strata_dip_towards_the_toe_on_either_side():
    rising = changed(FALLING, ("[0.0, 10.0], [16.0, 10.0], [24.0, 4.0], [40.0, 4.0]",
                               "[0.0, 4.0], [16.0, 4.0], [24.0, 10.0], [40.0, 10.0]"))  # fmt: skip
    right, left = model_of(FALLING), model_of(rising)
    xi = drawn(right, 1)[0]
    fields = []
    for model, mirror in ((right, 1), (left, -1)):
        x, z = np.asarray(model.scene.particles.position, float)
        x = x if mirror == 1 else 40.0 - x
        fields.append(np.asarray(model.strength(xi), float)[np.lexsort((x, z))])
    np.testing.assert_allclose(*fields, rtol=1e-4)
    # A strike that is given holds on either side.
    given = [model_of(changed(each, ("dip = 20.0", "dip = 20.0, strike = 90.0"))) for each in (FALLING, rising)]
    assert np.array_equal(given[0].strength(xi), right.strength(xi))
    assert not np.allclose(given[1].strength(xi), left.strength(xi), rtol=0.05)


@pytest.mark.filterwarnings("ignore:Corrected is not quite positive definite")
def test_correlation_of_the_property_itself_is_had_on_request():
    model = model_of(changed(TINY, ("cov = 0.4", "cov = 1.2\nnataf = true")))
    expansion = model.soil.expansions["strength"]
    points = np.array([[4.0, 20.0], [3.0, 3.0]])
    modes = np.asarray(kl.field.mode_matrix(expansion, points), float)
    gaussian = modes @ modes.T
    # Of lognormal numbers: (exp(s^2 r) - 1) / (exp(s^2) - 1).
    s2 = np.log1p(1.2**2)
    assert np.expm1(s2 * gaussian[0, 1]) / np.expm1(s2) == pytest.approx(np.exp(-((16.0 / 20.0) ** 2)), abs=0.02)
    assert gaussian[0, 1] > np.exp(-((16.0 / 20.0) ** 2)) + 0.05


def test_a_sample_of_stiffness_and_weight_has_its_own_start_and_step():
    model = model_of(ALL)
    assert model.names[:4] == ("cohesion", "friction", "young", "unit_weight")
    assert model.names[4:] == ("residual_cohesion", "residual_friction", "softening_strain")
    xi = drawn(model, 1)[0]
    parameters = {name: np.asarray(each, float) for name, each in model.parameters(xi).items()}
    scene, _ = model.of_sample(xi)
    poisson, density = 0.3, parameters["unit_weight"] / 9.81
    modulus = parameters["young"] * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    fastest, mean = np.sqrt((modulus / density).max()), np.sqrt(2e7 * 0.7 / (1.3 * 0.4) / (20e3 / 9.81))
    assert float(scene.numerics.time_step) == pytest.approx(
        float(model.scene.numerics.time_step) * mean / fastest, rel=1e-4
    )
    assert model.time_step(xi) == float(scene.numerics.time_step)
    assert model_of(SAND).time_step(np.zeros(1)) == float(model_of(SAND).scene.numerics.time_step)
    np.testing.assert_allclose(scene.particles.mass, density * scene.particles.volume, rtol=1e-5)


def test_softening_varies_in_the_measure_and_the_bands_of_the_law():
    layered = changed(LAYERED, ("softening_modulus = 85e3\nresidual_ratio = 0.5\n", "")) + BRITTLE
    layered = changed(layered, ("depth = 1.0", "depth = 1.0\nsoftening_length = 3.2"))
    for text in (CRACKED, changed(CRACKED, ("young", "plastic_strain = 'equivalent'\nyoung")), layered):
        model = model_of(text)
        assert [group.names for group in model.soil.groups] == [("strength", "residual_ratio"), ("softening_modulus",)]
        xi, law = drawn(model, 1)[0], model.scene.material.softening
        parameters, varied = model.parameters(xi), model.varied(xi)
        assert set(varied) == {"strength", "softening_modulus", "residual_ratio"}
        assert np.std(varied["softening_modulus"]) > 0.1 * np.mean(varied["softening_modulus"])
        np.testing.assert_allclose(
            varied["softening_modulus"] / law.modulus, parameters["softening_modulus"] / 85e3, rtol=1e-5
        )
        assert np.array_equal(varied["residual_ratio"], parameters["residual_ratio"])
        scene, _ = model.of_sample(xi)
        assert np.array_equal(scene.material.softening.modulus, varied["softening_modulus"])
    fill = np.asarray(model.layer) == 0
    assert np.ptp(law.modulus) > 0
    assert np.all(np.asarray(law.modulus)[fill] == np.asarray(law.modulus).min())


def test_exponential_softening_and_the_effect_of_rate_vary_too():
    exponential = changed(CRACKED, ("[soil.softening_modulus]\nmean = 85e3", "[soil.strain_95]\nmean = 5.0"))
    rate = "[soil.rate_coefficient]\nmean = 0.1\ncov = 0.2\nlength = [20.0, 4.0]\n"
    model = model_of(changed(exponential, ("[cross_correlation]", rate + "[cross_correlation]")))
    assert model.names == ("strength", "residual_ratio", "strain_95", "rate_coefficient")
    scene, _ = model.of_sample(drawn(model, 1)[0])
    for parameter in (scene.material.softening.strain_95, scene.material.rate.coefficient):
        assert np.unique(parameter).size > 50


def test_a_loss_over_time_varies_too_and_each_sample_slides_as_the_solver_has_it():
    loss = "[soil.loss_time]\nmean = 3.0\ncov = 0.5\nlength = [inf, inf]"
    lost = changed(CRACKED, ("[soil.softening_modulus]\nmean = 85e3\ncov = 0.4\nlength = [20.0, 4.0]", loss))
    model = model_of(changed(lost, ("t_end = 4.0", "t_end = 1.0")))
    coefficients = drawn(model, 2)
    for sample in runs.run_samples(model, coefficients, [0, 1], width=2):
        scene, state = model.of_sample(coefficients[sample.number])
        assert np.ptp(scene.material.loss.duration) == 0
        alone = solve(scene, state, t_end=1.0).state
        np.testing.assert_allclose(sample.fields["displacement"], alone.displacement, atol=1e-5)


def test_softening_that_leaves_its_limits_ends_its_sample_alone():
    model = model_of(changed(CRACKED, ("t_end = 4.0", "t_end = 0.1")))
    coefficients = drawn(model, 2)
    for group in model.soil.groups:
        if "residual_ratio" in group.names:  # some 6 deviations: more than the whole strength is left
            sets = group.coefficients(coefficients[0])
            assert set(sets) == {"strength", "residual_ratio"}
            coefficients[0, group.indices] = 0
            coefficients[0, group.indices[-group.expansion.modes :][0]] = 40.0
    assert float(model.parameters(coefficients[0])["residual_ratio"].max()) > 1
    rows = {sample.number: sample for sample in runs.run_samples(model, coefficients, [0, 1], width=2)}
    assert (rows[0].status, rows[0].steps) == ("BAD_PARAMETER", 0)
    assert rows[1].steps > 0


def test_softening_that_would_snap_back_within_its_values_is_refused_before_it_runs():
    steep = changed(CRACKED, ("mean = 85e3", "mean = 3e6"))
    with pytest.raises(ValueError, match=r"4 deviations from the middle of what varies.*: softening of .* snaps"):
        runs.grid_size(parse(steep), "rough")
    assert runs.grid_size(parse(CRACKED), "rough").steps > 0


def test_weaker_grids_divide_cohesion_and_the_tangent_of_friction():
    text = changed(SAND, ("poisson = 0.3", "poisson = 0.3\ndilation = 4.5"))
    model = model_of(text)
    xi, weaker = drawn(model, 1)[0], model.with_strength_factor(0.8)
    before, after = model.parameters(xi), weaker.parameters(xi)
    np.testing.assert_allclose(after["cohesion"], 0.8 * before["cohesion"], rtol=1e-6)
    tangent = np.tan(np.radians(after["friction"]))
    np.testing.assert_allclose(tangent, 0.8 * np.tan(np.radians(before["friction"])), rtol=1e-5)
    np.testing.assert_allclose(after["dilation"], np.minimum(4.5, after["friction"]), rtol=1e-6)
    assert weaker.names == ("cohesion", "friction", "dilation")
    assert float(weaker.scene.material.cohesion) == pytest.approx(4e3)
    soft = model_of(SOFT)
    xi, weaker = drawn(soft, 1)[0], soft.with_strength_factor(0.8)
    before, after = soft.varied(xi), weaker.varied(xi)
    np.testing.assert_allclose(after["residual_cohesion"], 0.8 * before["residual_cohesion"], rtol=1e-6)
    tangents = (np.tan(each["residual_friction"]) for each in (after, before))
    np.testing.assert_allclose(next(tangents), 0.8 * next(tangents), rtol=1e-5)
    np.testing.assert_allclose(after["softening_strain"], before["softening_strain"], rtol=1e-6)


def test_what_knows_undrained_strength_alone_says_so():
    with pytest.raises(ValueError, match=r"\[sweep\] varies the field of undrained strength"):
        variants(SAND + "[sweep]\ncov = [0.2, 0.4]\n")


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_limit_state_is_differentiated_with_the_stress_at_rest_of_random_stiffness_and_weight():
    model = model_of(ALL, at_rest=True)
    limit_state = slide_limit_state(model.scene, model.state, model.varied, seconds=0.3, displacement=0.5)
    at, along = np.random.default_rng(5).standard_normal((2, model.soil.modes))
    # Runs of a campaign are in float32, whose rounding is 3e-3 of the difference of a step of 1e-4.
    ahead, behind = (limit_state(at + step * along)[0] for step in (1e-2, -1e-2))
    assert limit_state(at)[1] @ along == pytest.approx((ahead - behind) / 2e-2, rel=1e-3)
