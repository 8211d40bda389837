"""What a GPU would add in any order is added by the transfers' kernels, which order it: a run repeats bit for bit."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from tests.jaxmpm.step.test_combinations import CHOSEN, built, name

SHAPE = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
TRANSFERS = ("jaxmpm_scatter", "jaxmpm_cell_sums")


def equations(jaxpr):
    """All equations of a program and of the programs within."""
    for equation in jaxpr.eqns:
        yield equation
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda leaf: hasattr(leaf, "eqns")):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                yield from equations(inner)


def of_run(scene, state):
    """Equations of a run with the transfers as primitives."""
    scene = replace(scene, numerics=replace(scene.numerics, engine=None))
    return list(equations(jax.make_jaxpr(lambda state: mpm.advance(scene, state, jnp.asarray(40)))(state).jaxpr))


def unordered(found):
    """Sums of floats by scatter at more than one place."""
    for equation in found:
        if equation.primitive.name == "scatter-add":
            _, places, values = equation.invars
            if jnp.issubdtype(values.aval.dtype, jnp.floating) and int(np.prod(places.aval.shape[:-1])) > 1:
                yield equation


def with_record():
    scene, state = mpm.slope(SHAPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)), at_rest=False)
    return scene, mpm.with_columns(scene, state, moved=0.5)


def near_soil_with_record():
    raster = mpm.Raster(np.add.outer(np.linspace(6, 3, 9), np.linspace(1, 0, 5)), (0.0, 0.0), 1.0)
    scene, state = mpm.terrain(
        mpm.Terrain(raster, base=0.0), CLAY, mpm.Discretisation(1.0, (0.5,) * 3, air=8.0), at_rest=False
    )
    scene = mpm.follow_soil(scene)
    return scene, mpm.with_columns(scene, state, moved=0.5)


@pytest.mark.parametrize("made", [with_record, near_soil_with_record])
def test_a_record_of_columns_sums_in_order(made):
    found = of_run(*made())
    assert list(unordered(found)) == []
    assert {equation.primitive.name for equation in found} >= set(TRANSFERS)


@pytest.mark.parametrize("choice", [pytest.param(choice, id=name(choice)) for choice in CHOSEN])
def test_every_feature_sums_in_order(choice):
    with jax.enable_x64(choice["dtype"] == "float64"):
        assert list(unordered(of_run(*built(choice)))) == []


def test_a_scatter_of_floats_is_seen():
    traced = jax.make_jaxpr(lambda values: jax.jit(lambda v: jnp.zeros(3).at[jnp.arange(4) % 3].add(v))(values))
    assert len(list(unordered(equations(traced(jnp.ones(4)).jaxpr)))) == 1
