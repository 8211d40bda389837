"""Names and keywords of before work for one version, with a warning that names what replaces them."""

import numpy as np
import pytest

import jaxmpm as mpm
import kl

RENAMED = [(p, name) for p in (mpm, kl) for names in p._RENAMED.values() for name in names.split()]


@pytest.mark.parametrize(("package", "name"), [*RENAMED, (mpm, "Believed")])
def test_a_renamed_name_is_the_same_object(package, name):
    with pytest.warns(DeprecationWarning, match=f"{package.__name__}.{name} will leave the next version, use "):
        assert getattr(package, name) is not None
    assert name not in package.__all__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'kl' has no attribute 'nothing'"):
        _ = kl.nothing


def test_keywords_of_a_scene_are_the_options_that_replace_them():
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.4)
    built, _ = mpm.block((1, 1), mpm.Soil(), numerics, domain=(4, 4), corner=(1, 1), walls="friction", friction=0.3)
    parts = built.particles, built.grid, built.material
    boundary, loads = mpm.Boundary(built.walls, 0.3), mpm.Loads(9.81)
    scene = mpm.scene(*parts, numerics, boundary=boundary, loads=loads)
    with pytest.warns(DeprecationWarning, match="cfl, gravity, kernel, wall_friction, walls of scene"):
        before = mpm.scene(*parts, kernel=built.kernel, walls=built.walls, wall_friction=0.3, gravity=9.81, cfl=0.4)
    assert before.kernel == scene.kernel
    assert before.walls == scene.walls
    assert before.wall_friction == scene.wall_friction
    assert before.time_step == scene.time_step
    np.testing.assert_array_equal(before.gravity, scene.gravity)


def test_a_scene_without_numerical_choices_or_with_unknown_keywords_is_refused():
    built, _ = mpm.column(2.0, mpm.Soil(), mpm.Discretisation(1.0, (0.5,)))
    parts = built.particles, built.grid, built.material
    with pytest.raises(TypeError, match="no numerical choices: give discretisation"):
        mpm.scene(*parts)
    with pytest.raises(TypeError, match="takes no gravitation"):
        mpm.scene(*parts, kernel=built.kernel, gravitation=1.0)
    with pytest.raises(ValueError, match="cell = 2 m on a grid of cells of 1 m: give the same"):
        mpm.scene(*parts, mpm.Discretisation(2.0, (0.5,)))
