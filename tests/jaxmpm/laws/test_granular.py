"""mu(I): steady shear of an element, and Bagnold's profile of a layer that flows down an incline."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.laws import MuI, element_test

GRAINS = {"static_friction": np.arctan(0.38), "dynamic_friction": np.arctan(0.64), "inertial_number": 0.279}


def grains(dtype=float, **values):
    numbers = {"bulk": 1e7, "shear": 4e6, **GRAINS, "grain_size": 5.3e-4, "grain_density": 2450.0, **values}
    return MuI(**{name: jnp.asarray(value, dtype) for name, value in numbers.items()})


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("rate", [0.1, 10.0, 100.0, 1000.0])
def test_steady_shear_of_grains_has_the_published_friction(rate):
    # Glass beads of Jop et al. (2006).
    test = element_test(grains(), "simple shear drained", pressure=500.0, strain=0.5, rate=rate, steps=2000)
    number = rate * 5.3e-4 * np.sqrt(2450.0 / 500.0)
    wanted = 0.38 + (0.64 - 0.38) / (1 + 0.279 / number)
    np.testing.assert_allclose(test.shear_stress[-1] / test.pressure[-1], wanted, rtol=1e-6)


def test_grains_need_the_time_step_and_know_it():
    with pytest.raises(ValueError, match="needs the time step"):
        element_test(grains(jnp.float32), "simple shear drained", pressure=500.0, strain=0.1)


def test_a_layer_on_an_incline_keeps_the_published_profile():
    # Jop et al. (2006): on an incline mu(I) = tan(angle), so that the speed is Bagnold's with the I of that friction.
    depth, angle, cells = 0.02, np.radians(26.0), 8
    soil = mpm.GranularSoil(
        *np.degrees([GRAINS["static_friction"], GRAINS["dynamic_friction"]]), 5.3e-4, grain_density=2450.0,
        unit_weight=0.6 * 2450.0 * 9.81, young=2e5,
    )  # fmt: skip
    cell = depth / cells
    numerics = mpm.Discretisation(cell, (cell / 2, cell / 2), cell_average=False)
    gravity = 9.81 * np.cos(angle)
    scene, state = mpm.section(
        mpm.Section([(0, depth), (2 * cell, depth)]), soil, numerics, ends="tied", k_h=np.tan(angle), gravity=gravity,
        speed=2.0,
    )  # fmt: skip
    number = 0.279 * (np.tan(angle) - 0.38) / (0.64 - np.tan(angle))
    z = np.asarray(scene.particles.position[1])
    profile = 2 / 3 * number / 5.3e-4 * np.sqrt(0.6 * gravity) * (depth**1.5 - (depth - z) ** 1.5)
    along = jnp.sign(scene.loads.gravity[0])
    # A friction that is off by 0.01 changes the mean speed by 3 % within 0.3 s.
    flowing = replace(state, velocity=state.velocity.at[0].set(along * profile))
    after = mpm.solve(scene, flowing, t_end=0.3).raise_if_failed().state
    speed = np.asarray(along * after.velocity[0])
    np.testing.assert_allclose(np.sum(speed) / np.sum(profile), 1.0, atol=0.02)
    np.testing.assert_allclose(speed, profile, atol=0.03 * profile.max())
