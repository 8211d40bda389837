"""Random fields that stop at a layer: independent of the others, on the layer's own box, the same on both grids."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kl
from benchmarks.robustness.invented import LAYERED, TERRAIN
from cooperative.scene import parse
from tests.cooperative.scene.test_random_soil import CORRELATED, SAND, changed
from tests.scenes import model_of

FILL = "strength = { mean = 40e3, cov = 0.1 }"
ROCK = 'name = "rock"\nrock = true'
OWN = changed(LAYERED, (FILL, FILL.replace(" }", ", length = [16.0, 3.6], correlation = 'matern 5/2' }")))
BOTH = changed(OWN, (ROCK, 'name = "till"\nstrength = { length = [16.0, 1.0] }'))


def draws(model, count, seed=1):
    return np.random.default_rng(seed).standard_normal((count, model.soil.modes)).astype(np.float32)


def test_coefficients_of_one_layer_move_nothing_in_another():
    model = model_of(BOTH)
    xi = draws(model, 1)[0]
    before = np.asarray(model.strength(xi))
    assert [group.layer for group in model.soil.groups] == [None, 0, 2]
    assert sorted(np.concatenate([group.indices for group in model.soil.groups])) == list(range(model.soil.modes))
    for group, layer in zip(model.soil.groups, (1, 0, 2), strict=True):
        other = xi.copy()
        other[group.indices] += 1
        changes = np.asarray(model.strength(other)) != before
        assert np.array_equal(np.unique(model.layer[changes]), [layer])
        assert changes[model.layer == layer].mean() > 0.9


def test_a_layers_field_is_that_of_its_own_statistics_on_its_own_box():
    model = model_of(BOTH)
    group = model.soil.groups[1]
    # The fill: 1 m below a surface that falls from 10 to 2 m.
    assert np.allclose(group.box, ((0, 1), (32, 9)))
    expansion = kl.expand((kl.Matern52(16.0), kl.Matern52(3.6)), *group.box, energy=0.999)
    assert group.expansion.modes == expansion.modes
    xi = draws(model, 1)[0]
    mine = model.layer == 0
    alone = kl.field_at(expansion, xi[group.indices], model.scene.particles.position[:, mine])
    expected = kl.Lognormal(40e3, 0.1).transform(alone)
    assert np.allclose(np.asarray(model.strength(xi))[mine], expected, rtol=1e-4)
    assert np.allclose(model.soil.groups[2].box, ((0, 0), (32, 1)))
    # The clay tapers off below the toe; its box goes no farther.
    assert np.allclose(model.campaign.site.box_of(1), ((0, 1), (16, 8)))


def test_statistics_at_points_are_those_of_each_layer_and_layers_are_independent():
    model = model_of(BOTH)
    sets = np.asarray(
        jax.lax.map(lambda xi: model.parameters(xi)["strength"], jnp.asarray(draws(model, 3000)), batch_size=500)
    )
    for layer, mean, cov in ((0, 40e3, 0.1), (1, 30e3, 0.4), (2, 30e3, 0.4)):
        of_layer = sets[:, model.layer == layer]
        assert of_layer.mean() == pytest.approx(mean, rel=0.02)
        assert np.median(of_layer.std(axis=0)) / mean == pytest.approx(cov, rel=0.06)
    x = np.asarray(model.scene.particles.position[0])
    fill, clay, till = (np.flatnonzero((model.layer == layer) & (x < 8))[0] for layer in range(3))
    correlation = np.corrcoef(np.log(sets[:, [fill, clay, till]]).T)
    assert np.abs(correlation[np.triu_indices(3, 1)]).max() < 0.06
    # Within a layer neighbours are alike.
    beside = np.flatnonzero((model.layer == 0) & (x < 8))[1]
    assert np.corrcoef(np.log(sets[:, [fill, beside]]).T)[0, 1] > 0.5


@pytest.mark.parametrize("sampled_at", ["particles", "cells"])
def test_both_grids_see_the_same_field(sampled_at):
    text = changed(BOTH, ("cov = 0.4", f"cov = 0.4\nsampled_at = '{sampled_at}'"))
    rough, refined = (model_of(text, grid) for grid in ("rough", "refined"))
    xi = draws(rough, 1)[0]
    for number, layer in enumerate((None, 0, 2)):
        groups = [model.soil.groups[number] for model in (rough, refined)]
        assert [group.layer for group in groups] == [layer] * 2
        assert all(
            np.array_equal(a, b) for a, b in zip(*(jax.tree.leaves(group.expansion) for group in groups), strict=True)
        )
    strengths = [{}, {}]
    for values, model in zip(strengths, (rough, refined), strict=True):
        # Of the squares of a metre, each a particle of the rough grid and four of the refined one.
        square = np.floor(np.asarray(model.scene.particles.position)).astype(int)
        for key, value in zip(zip(*square, model.layer, strict=True), np.asarray(model.strength(xi)), strict=True):
            values.setdefault(tuple(map(int, key)), []).append(float(value))
    coarse, fine = strengths
    # A cell of the rough grid is larger than a layer is thick.
    assert sampled_at == "particles" or all(np.ptp(values) == 0 for values in fine.values())
    for layer in range(3 if sampled_at == "particles" else 0):
        both = [key for key in coarse if key[2] == layer and len(fine.get(key, [])) == 4]
        assert len(both) > 10
        pairs = np.log([(coarse[key][0], np.mean(fine[key])) for key in both])
        assert np.corrcoef(pairs.T)[0, 1] > 0.99


def test_a_field_that_no_layer_shares_takes_no_coefficients():
    alone = changed(OWN, ('name = "clay"', 'name = "clay"\nstrength = { length = [16.0, 3.6] }'))
    model = model_of(alone)
    assert [group.layer for group in model.soil.groups] == [0, 1]
    assert set(model.soil.expansions) == set()
    assert np.isfinite(np.asarray(model.strength(draws(model, 1)[0]))).all()


@pytest.mark.slow
def test_parameters_of_a_layer_correlate_there():
    stops = "cohesion = { length = [16.0, 3.6] }\nfriction = { length = [16.0, 3.6] }"
    ground = LAYERED[LAYERED.index("[ground]") : LAYERED.index("[soil]")].replace(FILL, stops).replace(ROCK, "")
    text = changed(SAND, (SAND[SAND.index("[slope]") : SAND.index("[soil]")], ground)) + CORRELATED
    model = model_of(text)
    assert [(group.layer, group.names) for group in model.soil.groups] == [
        (None, ("cohesion", "friction")),
        (0, ("cohesion", "friction")),
    ]
    sets = jax.lax.map(model.parameters, jnp.asarray(draws(model, 2000)), batch_size=500)
    at = int(np.flatnonzero(model.layer == 0)[0])
    gaussian = [np.asarray(model.campaign.random[n].distribution.standardise(v[:, at])) for n, v in sets.items()]
    assert np.corrcoef(gaussian)[0, 1] == pytest.approx(-0.5, abs=0.05)
    with pytest.raises(ValueError, match=r"layer 'fill' has a field of cohesion alone, and not of friction"):
        parse(changed(text, ("friction = { length = [16.0, 3.6] }", "")))


def test_measured_values_condition_the_field_of_their_layer():
    held = changed(OWN, ("length = [16.0, 3.6]", "length = [16.0, 3.6], boreholes = [[5.5, 9.5, 47e3]]"))
    model = model_of(held)
    x, z = np.asarray(model.scene.particles.position)
    at = int(np.argmin(np.hypot(x - 5.5, z - 9.5)))
    assert (x[at], z[at]) == (5.5, 9.5)
    assert np.allclose([model.strength(xi)[at] for xi in draws(model, 5)], 47e3, rtol=5e-3)
    with pytest.raises(ValueError, match=r"^\[strength\] has 1 borehole value in .*, at \[5.5, 5.0\] m in clay"):
        parse(changed(held, ("[5.5, 9.5, 47e3]", "[5.5, 5.0, 47e3]")))
    with pytest.raises(
        ValueError, match=r"^\[strength\] has 1 borehole value .*, at \[5.5, 9.5\] m in fill: leave out"
    ):
        parse(changed(OWN, ("cov = 0.4", "cov = 0.4\nboreholes = [[5.5, 9.5, 30e3]]")))


def test_all_measured_values_outside_their_ground_are_named_at_once_with_where_they_are():
    through = [[5.5, 5.0], [5.5, 9.5], [5.5, 10.6], [-3.0, 9.5], [12.0, 4.0]]
    rows = ", ".join(f"[{x}, {z}, 30e3]" for x, z in through)
    with pytest.raises(ValueError, match=r"^\[strength\] has 3 borehole values in ground to whose") as refused:
        parse(changed(OWN, ("cov = 0.4", f"cov = 0.4\nboreholes = [{rows}]")))
    above = "at [5.5, 10.6] m above the ground, whose surface is at 10 m there"
    beyond = "at [-3.0, 9.5] m beyond the walls of the ground, x from 0 to 32 m"
    assert f", at [5.5, 9.5] m in fill; {above}; {beyond}: leave out" in str(refused.value)
    of_fill = [[5.5, 9.5], [12.0, -0.5], *([5.5, 8.0 - 0.1 * k] for k in range(8))]
    rows = ", ".join(f"[{x}, {z:.1f}, 47e3]" for x, z in of_fill)
    with pytest.raises(ValueError, match=r"^\[strength\] has 9 borehole values") as refused:
        parse(changed(OWN, ("length = [16.0, 3.6]", f"length = [16.0, 3.6], boreholes = [{rows}]")))
    said = str(refused.value)
    assert "at [12.0, -0.5] m below the base of the ground at 0 m; at [5.5, 8.0] m in clay" in said
    assert said.count(" m in clay") == 4
    assert "; and 4 more: leave out what is outside the ground" in said


def test_terrain_has_such_layers():
    layers = "[[layer]]\ndepth = 1.0\nstrength = { length = [20.0, 20.0, 4.0] }\n[[layer]]\n"
    model = model_of(changed(TERRAIN, ("[soil]", layers + "[soil]")))
    own = model.soil.groups_of("strength")[0]
    # 1 m below a surface that falls from 10 to 6 m.
    assert np.allclose(own.box, ((0, 0, 5), (16, 8, 5)))
    xi = draws(model, 1)[0]
    other = xi.copy()
    other[own.indices] += 1
    changes = np.asarray(model.strength(other)) != np.asarray(model.strength(xi))
    assert np.array_equal(np.unique(model.layer[changes]), [0])
