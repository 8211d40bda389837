"""Back-analysis and design points on a small slope: what made a slide is recovered, as far as the data determine it."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from cooperative import runs
from cooperative.scene import parse
from cooperative.tools.research.back_analysis import LOG_DEVIATION, Observed, Parameters, Survey, predict, recover
from cooperative.tools.research.rare import FLOOR, Search, design_point, slide_limit_state
from tests.cooperative.campaign.test_campaign import TINY, changed
from tests.differences import check_derivatives
from tests.scenes import model_of

DRAWN = changed(
    "[slope]\ncrest = 8.0\nheight = 8.0\nrun_per_rise = 1.0\ntoe = 16.0\nfoundation = 2.0\n",
    "[ground]\nsurface = [[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]\ntoe = 16.0\n",
)
SURVEY = Survey(seconds=1.5, times=5, markers=np.array([40, 90, 140]), stations=np.arange(4.0, 30.0, 3.0))
NOISE = 0.01
OF_CLAY = ("strength", "softening_modulus")


@pytest.fixture(scope="module")
def model():
    campaign = parse(TINY)
    return runs.build(campaign, "rough", runs.random_soil(campaign))


def noisy(model, truth, seed=0):
    clean = jax.jit(partial(predict, model.scene, model.state, SURVEY, field=model.leading))(truth)
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda a: a + NOISE * rng.standard_normal(a.shape).astype(np.float32), clean)


def of_clay(strength, softening, coefficients):
    factors = {"strength": jnp.float32(strength), "softening_modulus": jnp.float32(softening)}
    return Parameters(factors, jnp.asarray(coefficients, jnp.float32))


def recovered(model, observed, *, modes, **choices):
    return recover(
        model.scene,
        model.state,
        SURVEY,
        observed,
        NOISE,
        names=OF_CLAY,
        field=model.leading,
        coefficients=modes,
        **choices,
    )


@pytest.mark.slow
def test_strength_and_field_behind_a_slide_are_recovered(model):
    truth = of_clay(-0.5, 0.1, [0.5, -0.4])
    observed = noisy(model, truth)
    result = recovered(model, observed, modes=2, iterations=25)
    assert result.losses[-1] < 1e-2 * result.losses[0]
    # Readings are explained to their noise, and parameters lie where the posterior says.
    readings = sum(leaf.size for leaf in jax.tree.leaves(observed))
    assert min(result.losses) < 0.5 * readings * 1.6
    for got, true, spread in zip(*map(jax.tree.leaves, (result.parameters, truth, result.deviation)), strict=True):
        assert np.all(np.abs(np.asarray(got - true)) < 4 * np.asarray(spread) + 0.02)
    # The data tell more than was known before, most of all of the mean strength.
    assert float(result.deviation.factors["strength"]) < 0.5 * result.prior.factors["strength"]


@pytest.mark.slow
def test_a_slope_that_stands_tells_little_of_its_softening(model):
    truth = of_clay(0.5, 0.0, [0.0])
    result = recovered(model, noisy(model, truth), modes=1, iterations=3)
    assert float(result.deviation.factors["softening_modulus"]) > 0.9 * result.prior.factors["softening_modulus"]


def test_column_height_is_the_surface_before_it_moves(model):
    survey = Survey(0.1, 1, np.array([0]), np.array([4.0, 26.0]), width=2.0)
    flat = predict(model.scene, model.state, survey, of_clay(0.5, 0.0, [0.0]), model.leading).surface
    np.testing.assert_allclose(flat, [10.0, 2.0], atol=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise": 0.0}, "noise = 0 m: give"),
        ({"names": (), "coefficients": 0}, "neither names nor coefficients"),
        ({"names": ("cohesion",)}, r"\['cohesion'\] is no number of the scene: give some of \['bulk'"),
        ({"field": None}, "1 coefficients without a field"),
        ({"survey": Survey(1.0, 2, np.array([10**6]), np.array([4.0]))}, "markers = \\[1000000\\]"),
    ],
)
def test_bad_surveys_are_refused(model, change, message):
    given = {"survey": SURVEY, "observed": Observed(jnp.zeros(1), jnp.zeros((2, 2, 1))), "noise": NOISE}
    given |= {"names": OF_CLAY, "field": model.leading, "coefficients": 1}
    with pytest.raises(ValueError, match=message):
        recover(model.scene, model.state, **given | change)


def test_water_that_differs_between_samples_has_no_derivative_and_says_so():
    water = "[water]\nlevel = { mean = 3.0, sd = 0.5 }\n"
    wet = model_of(DRAWN.replace("[rough]", water + "[rough]"))
    limit_state = slide_limit_state(wet.scene, wet.state, wet.varied, seconds=0.1, displacement=0.5)
    with pytest.raises(ValueError, match="water of samples is worked out on the host, without derivatives"):
        limit_state(np.zeros(wet.soil.modes))


MESH = mpm.Discretisation(1.5, (0.75, 0.75))
SOILS = {
    "softening clay": mpm.Soil(strength=4e3, softening_modulus=2e4, young=5e6),
    "clay that decays": mpm.Soil(strength=4e3, strain_95=0.5, young=5e6),
    "Mohr-Coulomb": mpm.FrictionalSoil(1e3, 25.0, young=5e6),
    "Drucker-Prager": mpm.FrictionalSoil(1e3, 25.0, young=5e6, law=mpm.laws.DruckerPrager),
    "Cam Clay": mpm.CamClaySoil(0.1, 0.02, 1.0, largest_pressure=100e3),
    "anisotropic": mpm.AnisotropicSoil(4e3, 3e3, 2e3, young=5e6),
    "mu(I)": mpm.GranularSoil(20.0, 30.0, 1e-2, young=1e6),
    "B-value": mpm.FrictionalSoil(1e3, 25.0, young=5e6, b_value=0.9),
}
STEPS = 25


def strengths(scene):
    """Names of what strength reduction divides, of walls too, and of the stiffness."""
    numbers = mpm.laws.declared(scene.material)
    of_walls = [name for name in ("wall_friction", "wall_cohesion") if getattr(scene.boundary, name[5:]) is not None]
    return ["bulk", "shear", *(name for name, number in numbers.items() if number.parameter.reduced), *of_walls]


def field_of(scene):
    """Two coefficients of each strength along x: per particle of soil, per node of walls."""
    numbers = mpm.laws.declared(scene.material)
    nodes = scene.grid.origin[0] + scene.grid.cell * np.arange(scene.grid.shape[0])
    at_nodes = np.repeat(nodes, scene.grid.shape[1])
    x = np.asarray(scene.particles.position[0])

    def values(coefficients):
        a, b = coefficients
        given = {}
        for name in strengths(scene)[2:]:
            if name.startswith("wall"):
                given[name] = getattr(scene.boundary, name[5:]) * jnp.exp(0.1 * (a + b * at_nodes))
            else:
                number = numbers[name]
                given[name] = number.value * jnp.exp(0.02 * (a + b * x))
        return given

    return values


def sliding(kind):
    """A slope of a soil, or on a contact, whose strength falls to a quarter of what it came to rest with."""
    contact = mpm.Interface(friction=20.0, cohesion=500.0) if kind == "contact" else None
    drawn = mpm.Section([(0, 4.5), (3, 4.5), (6, 1.5), (9, 1.5)], interface=contact)
    water = 3.0 if kind == "B-value" else None
    scene, state = mpm.section(drawn, SOILS.get(kind, mpm.Soil(strength=20e3, young=5e6)), MESH, water=water)
    return mpm.reduced(scene, 4.0), state


@pytest.mark.usefixtures("x64")
# Each compiles a run with its initial stress and its reverse for a quarter of a minute.
@pytest.mark.parametrize(
    "kind", ["anisotropic", "contact", *(pytest.param(k, marks=pytest.mark.slow) for k in SOILS if k != "anisotropic")]
)
def test_back_analysis_and_limit_states_take_every_law_and_contact(kind):
    scene, state = sliding(kind)
    field, dt = field_of(scene), float(scene.numerics.time_step)
    survey = Survey(STEPS * dt, 5, np.array([3, 7]), np.array([2.0, 5.0]), width=1.0)
    names = strengths(scene)

    def read(at):
        factors = {name: at[name] for name in names}
        parameters = Parameters(factors, jnp.stack([at["a"], at["b"]]))
        seen = predict(scene, state, survey, parameters, field)
        return 1e3 * (jnp.sum(seen.histories**2) + jnp.sum(seen.surface - 2.0))

    check_derivatives(read, dict.fromkeys([*names, "a", "b"], 0.3), 2e-4)
    limit_state = slide_limit_state(scene, state, field, seconds=STEPS * dt, displacement=0.5)
    _, gradient = limit_state(np.array([0.5, -0.5]))
    ahead, behind = (
        np.array([limit_state(np.array([0.5, -0.5]) + h)[0] for h in s * 1e-4 * np.eye(2)]) for s in (1, -1)
    )
    np.testing.assert_allclose(gradient, (ahead - behind) / 2e-4, rtol=1e-3, atol=1e-5 * abs(gradient).max())


OF_LAW = {
    "Cam Clay": "critical_state",
    "anisotropic": "simple_strength",
    "mu(I)": "static_friction",
    "B-value": "friction",
}
TRUTH = -0.15
"""Logarithm of the factor on a law's strength that runs are made with."""


@pytest.mark.usefixtures("x64")
# Each compiles the reverse of a run twice, for half a minute.
@pytest.mark.parametrize("kind", ["mu(I)", *(pytest.param(k, marks=pytest.mark.slow) for k in OF_LAW if k != "mu(I)")])
def test_the_design_point_and_the_recovery_of_a_law_are_those_of_forward_runs(kind):
    """The limit is the slide of a run with a factor, which both have to find. Two coefficients make the factor."""
    scene, state = sliding(kind)
    number, dt = mpm.laws.declared(scene.material)[OF_LAW[kind]], float(scene.numerics.time_step)
    survey = Survey(STEPS * dt, 5, np.array([3, 7]), np.array([2.0, 5.0]), width=1.0)
    share = np.array([0.6, 0.8])

    def ran(log_factor):
        varied, at = mpm.with_soil(scene, state, **{OF_LAW[kind]: number.value * np.exp(log_factor)})
        varied, histories = replace(varied, numerics=scene.numerics), []
        for _ in range(survey.times):
            at = mpm.advance(varied, at, STEPS // survey.times)
            histories.append(at.displacement[:, survey.markers])
        return at, Observed(
            mpm.objectives.column_height(scene, at, survey.stations, survey.width), jnp.stack(histories)
        )

    final, observed = ran(TRUTH)
    displacement = FLOOR * float(jnp.exp(mpm.objectives.log_displacement(final, FLOOR)))
    limit_state = slide_limit_state(
        scene,
        state,
        lambda z: {OF_LAW[kind]: number.value * jnp.exp(0.1 * (share @ z))},
        seconds=STEPS * dt,
        displacement=displacement,
    )
    point = design_point(limit_state, 2, Search(tolerance=1e-4))
    assert point.converged
    np.testing.assert_allclose(point.coefficients, 10 * TRUTH * share, rtol=1e-3)

    noise = 0.02 * float(jnp.max(abs(observed.histories)))
    found = recover(scene, state, survey, observed, noise, names=[OF_LAW[kind]], iterations=8)
    near = [np.concatenate([np.ravel(leaf) for leaf in ran(TRUTH + h)[1].__dict__.values()]) for h in (-1e-4, 1e-4)]
    precision = np.sum(((near[1] - near[0]) / 2e-4 / noise) ** 2) + 1 / LOG_DEVIATION**2
    # The prior draws the answer towards 0 by its share of what is known.
    expected = TRUTH * (1 - 1 / LOG_DEVIATION**2 / precision)
    assert float(found.parameters.factors[OF_LAW[kind]]) == pytest.approx(expected, rel=0.02)
    assert float(found.deviation.factors[OF_LAW[kind]]) == pytest.approx(precision**-0.5, rel=0.02)


@pytest.mark.slow
def test_the_design_point_of_a_slope_fails_by_the_campaigns_own_count(model):
    # With half as much strength again the median field stands, and a failing one is some deviations away.
    stronger = runs.GridModel(**{**vars(model), "strength_factor": 1.5})
    result = design_point(
        slide_limit_state(stronger.scene, stronger.state, stronger.varied, seconds=1.5, displacement=0.3),
        model.soil.modes,
    )
    assert result.converged
    assert 0.5 < result.beta < 6
    point = np.asarray(result.coefficients, np.float32)[None]
    (sample,) = runs.run_samples(stronger, 1.1 * point, [0])
    (median,) = runs.run_samples(stronger, 0 * point, [0])
    assert sample.row["displacement"] > 0.3 > 5 * median.row["displacement"]
