"""Laws, covariances and marginals of as many parameters are different structures, or jit would confuse them."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import pytest

import jaxmpm
import kl


def structures(modules):
    """Structure of each pytree of modules, its fields all numbers."""
    by_class = {}
    for cls in {each for module in modules for each in vars(module).values() if isinstance(each, type)}:
        if dataclasses.is_dataclass(cls):
            value = object.__new__(cls)
            for field in dataclasses.fields(cls):
                object.__setattr__(value, field.name, 1.0)
            if not jax.tree_util.treedef_is_leaf(jax.tree.structure(value)):
                by_class[cls.__name__] = jax.tree.structure(value)
    return by_class


@pytest.mark.parametrize(
    "modules", [(jaxmpm, jaxmpm.laws, jaxmpm.run, jaxmpm.types), (kl, kl.axis, kl.marginal)], ids=["jaxmpm", "kl"]
)
def test_no_two_classes_have_one_structure(modules):
    trees = structures(modules)
    assert len(trees) > 5
    alike = [(a, b) for (a, x), (b, y) in itertools.combinations(trees.items(), 2) if x == y]
    assert alike == []


def test_a_static_field_is_part_of_the_structure():
    value = jaxmpm.laws.DruckerPrager(1.0, 1.0, 1.0, 0.5, 0.0)
    other = dataclasses.replace(value, matching=jaxmpm.laws.Matching.COMPRESSION)
    assert jax.tree.structure(value) != jax.tree.structure(other)
    assert jax.tree.map(lambda leaf: leaf, other) == other


def test_static_fields_survive_a_map():
    forgets, remembers = (jaxmpm.laws.J2(1.0, 1.0, 1.0, gap_memory=memory) for memory in (False, True))
    assert jax.tree.structure(forgets) != jax.tree.structure(remembers)
    for value in (forgets, remembers):
        assert jax.tree.map(lambda leaf: leaf, value) == value


SOILS = jaxmpm.Soil(strength=9e3, softening_modulus=40e3, tension_cutoff=0.0), jaxmpm.FrictionalSoil(1e3, 30.0)


@pytest.fixture(scope="module")
def built():
    drawn = jaxmpm.Section([(0, 4), (6, 4)], interface=jaxmpm.Interface(20.0))
    layers = [jaxmpm.Layer(SOILS[0], [(0, 2), (6, 2)]), jaxmpm.Layer(SOILS[1])]
    return jaxmpm.section(drawn, layers, jaxmpm.Discretisation(1.0, (0.5, 0.5)), water=3.0, at_rest=False)


def test_any_scene_and_state_are_shown_in_ten_lines(built):
    scene, state = built
    clay = scene.material.laws[0]
    for value in (scene, state, scene.material, clay, scene.particles, scene.grid):
        lines = repr(value).splitlines()
        assert len(lines) <= 10
        assert max(map(len, lines)) <= 100
    assert "displacement=f32[2,96]" in repr(state)
    assert "J2(" in repr(scene)
    assert "cell=1.0" in repr(scene)
    assert "strength=9000" in repr(clay)
    assert "tension_cutoff=0" in repr(clay)
    assert "tension_cutoff" not in repr(dataclasses.replace(clay, tension_cutoff=None))


def test_a_traced_value_is_shown_by_its_type(built):
    seen = []
    jax.eval_shape(lambda law: seen.append(repr(law)), built[0].material.laws[0])
    assert "strength=f32[]" in seen[0]


def test_many_parts_are_shown_as_far_as_they_fit(built):
    law = built[0].material.laws[0]
    assert len(repr(jaxmpm.laws.Zoned((law,) * 60, (1,) * 60)).splitlines()) <= 10


def test_equality_is_a_bool_and_of_every_value(built):
    scene, state = built
    again = jax.tree.map(jnp.copy, state)
    assert (state == again) is True
    assert scene == jax.tree.map(jnp.copy, scene)
    assert state != dataclasses.replace(again, velocity=again.velocity.at[0, 3].set(1e-3))
    assert state != dataclasses.replace(again, step=state.step.astype(jnp.float32))
    assert state != dataclasses.replace(again, gap=None)
    assert scene != dataclasses.replace(scene, numerics=dataclasses.replace(scene.numerics, xpic=2))
    assert state != scene
    assert (state == 3) is False
    with pytest.raises(TypeError, match="traced"):
        jax.eval_shape(lambda other: state == other, again)


def test_what_a_class_says_of_itself_stays():
    @jaxmpm.pytree
    @dataclasses.dataclass(frozen=True)
    class Own:
        value: float

        def __repr__(self):
            return "mine"

        def __eq__(self, other):
            return True

    assert repr(Own(1.0)) == "mine"
    assert Own(1.0) == Own(2.0)
