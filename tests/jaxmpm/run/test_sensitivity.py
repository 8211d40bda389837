"""Derivatives by every number of any law; programs that are compiled once."""

import logging
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.laws import declared, with_parameters
from tests.differences import by_shares

LEVEL = mpm.Section([(0, 3), (3, 3)])
SOILS = {
    "clays": [mpm.Soil(strength=4e3, softening_modulus=2e4), mpm.AnisotropicSoil(4e3, 3e3, 2e3, young=5e6)],
    "drained": [
        mpm.CamClaySoil(0.1, 0.02, 1.0, largest_pressure=100e3),
        mpm.FrictionalSoil(1e3, 25.0, dilation=5.0, young=5e6, softening_strain=0.1, residual_friction=20.0),
    ],
    "grains": [mpm.GranularSoil(20.0, 30.0, 1e-2, young=1e6)],
}


def moving(objective):
    return jnp.mean(objective.displacement**2) * 1e6


@pytest.mark.usefixtures("x64")
# Each compiles a run and its reverse of two laws for half a minute.
@pytest.mark.parametrize("kind", ["grains", *(pytest.param(k, marks=pytest.mark.slow) for k in ("clays", "drained"))])
def test_derivatives_by_every_number_of_every_law_are_those_of_differences(kind):
    soils = SOILS[kind]
    bottoms = [[(0, 1.5), (3, 1.5)], None][-len(soils) :]
    layers = [mpm.Layer(replace(s, unusual=True) if hasattr(s, "unusual") else s, b)
              for s, b in zip(soils, bottoms, strict=True)]  # fmt: skip
    scene, state = mpm.section(LEVEL, layers, mpm.Discretisation(1.5, (0.75, 0.75)))
    # Sheared by the height, so that all of it yields.
    state = replace(state, velocity=state.velocity.at[0].set(0.6 * scene.particles.position[1]))
    value, by = mpm.sensitivity(scene, state, moving, steps=25)
    known = declared(scene.material)
    assert by.keys() == known.keys()

    numbers = {name: jnp.nan_to_num(each.value) for name, each in known.items()}

    def reached(values):
        varied = with_parameters(scene.material, values)
        return moving(mpm.replay(replace(scene, material=varied), state, 25)[0])

    slopes = [float(jnp.sum(numbers[name] * by[name])) for name in numbers]
    differences = by_shares(reached, numbers)
    assert float(value) == pytest.approx(float(moving(mpm.replay(scene, state, 25)[0])), rel=1e-9)
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-5 * abs(differences).max())


def compiled(caplog, function):
    """Programs that a call compiles."""
    caplog.clear()
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        function()
    return [record.getMessage() for record in caplog.records if "Compiling" in record.getMessage()]


def test_a_second_replay_and_a_second_sensitivity_compile_nothing(caplog):
    scene, state = mpm.section(LEVEL, mpm.Soil(strength=4e3), mpm.Discretisation(1.5, (0.75, 0.75)))
    weaker = replace(scene, material=replace(scene.material, strength=0.5 * scene.material.strength))
    calls = {
        "replay": lambda scene: mpm.replay(scene, state, 7),
        "seen": lambda scene: mpm.replay(scene, state, 6, observe=moving, every=3),
        "sensitivity": lambda scene: mpm.sensitivity(scene, state, moving, ["strength"], steps=3),
    }
    for name, call in calls.items():
        assert compiled(caplog, lambda call=call: call(scene)), name
        assert not compiled(caplog, lambda call=call: call(weaker)), name


def test_a_number_that_the_law_does_not_have_is_refused():
    scene, state = mpm.section(LEVEL, mpm.Soil(strength=4e3), mpm.Discretisation(1.5, (0.75, 0.75)))
    with pytest.raises(ValueError, match=r"\['cohesion'\] is no parameter of J2: give some of \['bulk', 'sh"):
        mpm.sensitivity(scene, state, moving, ["cohesion", "strength"], steps=2)
    _, by = mpm.sensitivity(scene, state, moving, ["strength"], steps=2)
    assert np.shape(by["strength"]) == scene.particles.mass.shape


@pytest.mark.usefixtures("x64")
def test_derivatives_by_the_strength_of_a_contact_are_those_of_differences_at_its_nodes():
    drawn = mpm.Section([(0, 4), (3, 4), (5, 1), (8, 1)], interface=mpm.Interface(friction=20.0, cohesion=500.0))
    scene, state = mpm.section(drawn, mpm.Soil(strength=20e3, young=5e6), mpm.Discretisation(1.0, (0.5, 0.5)))
    scene = mpm.reduced(scene, 4.0)
    names = ["wall_friction", "wall_cohesion"]
    _, by = mpm.sensitivity(scene, state, moving, names, steps=25)
    assert mpm.sensitivity(scene, state, moving, steps=25)[1].keys() > set(names)
    uneven = jnp.asarray(np.random.default_rng(2).uniform(0.5, 1.5, scene.grid.nodes))

    def reached(factors):
        values = {name: getattr(scene.boundary, name[5:]) * (1 + (factors[name] - 1) * uneven) for name in names}
        return moving(mpm.replay(mpm.with_soil(scene, state, **values)[0], state, 25)[0])

    slopes = [float(jnp.sum(by[name] * getattr(scene.boundary, name[5:]) * uneven)) for name in names]
    differences = by_shares(reached, dict.fromkeys(names, 1.0))
    assert np.all(differences != 0)
    np.testing.assert_allclose(slopes, differences, rtol=1e-4)
