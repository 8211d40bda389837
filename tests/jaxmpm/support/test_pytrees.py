"""Laws, covariances and marginals of as many parameters are different structures, or jit would confuse them."""

import dataclasses
import itertools

import jax
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
