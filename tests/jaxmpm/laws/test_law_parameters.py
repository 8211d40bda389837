"""What a law declares of its numbers: names, what strength reduction divides, and what may not exceed what."""

import math
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.laws import declared

SOILS = {
    "linear": mpm.Soil(strength=20e3, softening_modulus=50e3, rate_coefficient=0.1, viscosity=2.0, tension_cutoff=0.0),
    "exponential": mpm.Soil(strength=20e3, strain_95=0.5, tension_cutoff=0.0),
    "frictional": mpm.FrictionalSoil(10e3, 30.0, 10.0, residual_cohesion=2e3, residual_friction=20.0,
                                     softening_strain=0.1),
}  # fmt: skip


@mpm.pytree
@dataclass(frozen=True)
class Undeclared(mpm.laws.Law):
    """Numbers of which nothing is declared, one of them of a part."""

    bulk: Any
    shear: Any
    yield_stress: Any
    softening: Any = None


@mpm.pytree
@dataclass(frozen=True)
class Joints(mpm.laws.Law):
    """A friction that is divided, and an opening angle that may not exceed it."""

    bulk: Any
    shear: Any
    slip: Any
    opening: Any

    PARAMETERS = {  # noqa: RUF012
        "slip": mpm.laws.Parameter(least=0.0, unit="rad", name="joint_friction", reduced=True),
        "opening": mpm.laws.Parameter(least=0.0, unit="rad", at_most="joint_friction"),
    }

    def update(self, strain_increment, stress, history, dt=None):
        return stress, history


def law_of(soil):
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), fbar=False, cell_average=False)
    return mpm.block((0.5, 0.5), soil, numerics, domain=(3, 3), corner=(1.0, 1.0))[0].material


@pytest.mark.parametrize(
    ("soil", "paths"),
    [
        ("linear", {"softening_modulus": "softening.modulus", "residual_ratio": "softening.residual_ratio",
                    "rate_coefficient": "rate.coefficient", "strength": "strength", "viscosity": "viscosity"}),
        ("exponential", {"strain_95": "softening.strain_95", "residual_ratio": "softening.residual_ratio"}),
        ("frictional", {"residual_cohesion": "softening.cohesion", "residual_friction": "softening.friction",
                        "softening_strain": "softening.strain", "dilation": "dilation"}),
    ],
)  # fmt: skip
def test_a_law_has_engineers_names_for_its_numbers_wherever_they_stand_in_it(soil, paths):
    known = declared(law_of(SOILS[soil]))
    assert {name: known[name].path for name in paths} == paths
    for name in {*paths} & vars(SOILS[soil]).keys():
        given = getattr(SOILS[soil], name)
        of_law = math.radians(given) if known[name].parameter.angle else given
        assert float(known[name].value) == pytest.approx(of_law)


def test_numbers_that_a_law_declares_nothing_of_go_by_their_path():
    law = Undeclared(1.0, 1.0, 2.0, mpm.laws.Softening(3.0, 0.5))
    assert declared(law)["yield_stress"].path == "yield_stress"
    assert not declared(law)["yield_stress"].parameter.reduced
    assert declared(law)["softening_modulus"].path == "softening.modulus"
    with pytest.raises(ValueError, match="Undeclared has no strength to divide: declare one in PARAMETERS"):
        mpm.laws.reduce_strength(law, 1.5)


def test_reduction_divides_the_tangent_of_an_angle_and_lowers_what_may_not_exceed_it():
    friction, opening = jnp.radians(jnp.asarray([30.0, 12.0])), jnp.radians(jnp.asarray([5.0, 12.0]))
    weaker = mpm.laws.reduce_strength(Joints(1.0, 1.0, friction, opening), 1.25)
    tangent = np.tan(np.radians([30.0, 12.0])) / 1.25
    np.testing.assert_allclose(np.tan(weaker.slip), tangent, rtol=1e-6)
    np.testing.assert_allclose(np.degrees(weaker.opening), [5.0, np.degrees(np.arctan(tangent[1]))], rtol=1e-6)
    assert weaker.bulk == 1.0


def test_a_number_above_that_which_it_may_not_exceed_is_refused_by_the_names_of_the_law():
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), fbar=False, cell_average=False)
    scene, _ = mpm.block((0.5, 0.5), mpm.Soil(), numerics, domain=(3, 3), corner=(1.0, 1.0))
    law = Joints(*(jnp.asarray(value, jnp.float32) for value in (1e6, 1e6, 0.2, 0.1)))
    mpm.scene(scene.particles, scene.grid, law, numerics)
    with pytest.raises(ValueError, match=r"opening is up to 5.73 degrees above the joint_friction: give at most"):
        mpm.scene(scene.particles, scene.grid, replace(law, opening=law.slip + 0.1), numerics)


@pytest.mark.parametrize("table", ["LIMITS", "STRENGTH"])
def test_a_law_with_a_table_of_before_is_refused(table):
    with pytest.raises(ValueError, match=f"Own has {table}: declare its numbers in PARAMETERS"):
        type("Own", (mpm.laws.Law,), {table: {}})
