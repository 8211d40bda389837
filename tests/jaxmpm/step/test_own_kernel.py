"""Shape functions of one's own run as those of the package do, and those that the stencil cannot hold are refused."""

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from tests.jaxmpm.step.test_step import bar_error
from tests.jaxmpm.step.test_transfer import data, p2g


class Points:
    """What shape functions have that do not follow the particles' spacing."""

    @classmethod
    def of_spacing(cls, spacing):
        return cls()


@dataclass(frozen=True)
class Hat(Points):
    """The linear function of a node, once more."""

    def shape(self, axis, cell, r):
        inside = (r >= -1) & (r < 1)  # at a node the slope is that of the cell above
        return jnp.where(inside, 1 - jnp.abs(r), 0), jnp.where(inside, jnp.where(r < 0, 1.0, -1.0) / cell, 0)

    def deviation(self, cell):
        return cell / math.sqrt(3)


@dataclass(frozen=True)
class SoftGrain(Points):
    """A hat averaged over a particle of one cell that is densest in its middle (itself a hat): a cubic spline."""

    def shape(self, axis, cell, r):
        def outside(reach, power):
            return jnp.maximum(reach - jnp.abs(r), 0) ** power

        value = 2 / 3 * (outside(1.5, 3) - 2 * outside(1.0, 3) - outside(0.5, 3))
        slope = -2 * jnp.sign(r) * (outside(1.5, 2) - 2 * outside(1.0, 2) - outside(0.5, 2))
        return value, slope / cell

    def deviation(self, cell):
        return cell * math.sqrt(2 * (1 / 6 + 1 / 24))  # twice the variances of both hats


@dataclass(frozen=True)
class CubicBSpline(Points):
    """Reaches two cells, so that it needs four nodes along an axis."""

    def shape(self, axis, cell, r):
        a = jnp.abs(r)
        tail = jnp.maximum(2 - a, 0)
        value = jnp.where(a < 1, 2 / 3 - a**2 + a**3 / 2, tail**3 / 6)
        return value, jnp.where(a < 1, 1.5 * r * a - 2 * r, -jnp.sign(r) * tail**2 / 2) / cell

    def deviation(self, cell):
        return cell * math.sqrt(2 / 3)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kernel", [Hat(), SoftGrain()])
def test_own_functions_add_up_to_one_and_give_back_the_position(kernel):
    x = np.linspace(0.5, 1.5, 101)[:-1]  # in cells from the first of the three nodes that a particle touches
    r = x - np.arange(3.0)[:, None]
    value, slope = (np.asarray(each) for each in kernel.shape(0, 0.5, jnp.asarray(r)))
    np.testing.assert_allclose([value.sum(0), np.arange(3) @ value], [np.ones(100), x], atol=1e-14)
    np.testing.assert_allclose([slope.sum(0), np.arange(3) @ slope * 0.5], [np.zeros(100), np.ones(100)], atol=1e-13)
    h = 1e-6
    ahead, behind = (np.asarray(kernel.shape(0, 0.5, jnp.asarray(r + step))[0]) for step in (h, -h))
    smooth = (np.abs(x - 1) > h) | (kernel != Hat())  # a hat has a kink at its node
    np.testing.assert_allclose(slope[:, smooth], ((ahead - behind) / (2 * h * 0.5))[:, smooth], atol=1e-6)


def slid(kernel):
    """Two small slopes of weak clay after 0.5 s, on their way."""
    shape = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=4, foundation=2)
    soil = mpm.Soil(young=5e6, strength=6e3, softening_modulus=40e3, tension_cutoff=0.0)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5), kernel=kernel, fbar=True))
    scene, axes = mpm.run.lanes(scene, strength=jnp.array([6e3, 5e3]))
    return mpm.solve(scene, mpm.run.repeat(state, 2), t_end=0.5, axes=axes).raise_if_failed().state


@pytest.mark.usefixtures("x64")
def test_an_own_hat_is_the_linear_kernel_to_rounding():
    own, known = slid(Hat), slid(mpm.Linear)
    assert (jnp.abs(known.displacement).max((1, 2)) > 1e-2).all()
    assert (known.history.max(1) > 0).all()
    for mine, theirs in zip(jax.tree.leaves(own), jax.tree.leaves(known), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * float(jnp.abs(theirs).max()))


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_own_cubic_splines_follow_the_axial_bar_as_it_is_refined():
    errors = [bar_error(cells, kernel=SoftGrain)[0] for cells in (25, 50)]
    assert errors[1] < min(0.02, errors[0])


@pytest.mark.usefixtures("x64")
def test_derivatives_go_through_own_functions():
    grid, position, carried, stress = data(2, 5)
    along = jnp.asarray(np.random.default_rng(1).normal(size=position.shape))

    def total(step):
        return jnp.sum(p2g(grid, SoftGrain(), position + step * along, carried, stress) ** 2)

    step = 1e-5
    np.testing.assert_allclose(jax.grad(total)(0.0), (total(step) - total(-step)) / (2 * step), rtol=1e-6)


def test_functions_that_need_a_fourth_node_and_those_for_no_spacing_are_refused():
    numerics = mpm.Discretisation(1.0, (0.5,), kernel=CubicBSpline)
    with pytest.raises(ValueError, match=r"CubicBSpline\(\) weighs a particle by .* give functions that add up to 1"):
        mpm.bar(10.0, mpm.Soil(young=1e6), numerics, velocity=1.0)
    with pytest.raises(ValueError, match="give GIMP, Linear, QuadraticBSpline or a class with `of_spacing`"):
        mpm.bar(10.0, mpm.Soil(young=1e6), replace(numerics, kernel=Hat()), velocity=1.0)
