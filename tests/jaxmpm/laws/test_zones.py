"""Layers of different kinds in one ground: each particle follows the law of its own layer."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.laws import declared, update_with_gap, with_parameters

DRAWN = mpm.Section([(0, 6), (6, 6), (10, 2), (16, 2)])
BELOW = [(0, 3), (8, 3), (9, 3)]
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
CLAY = mpm.Soil(young=5e6, strength=12e3, softening_modulus=20e3, rate_coefficient=0.05, tension_cutoff=0.0)
FILL = mpm.FrictionalSoil(4e3, 30.0, 5.0, young=8e6, tension_cutoff=0.0)
CONE = replace(FILL, law=mpm.laws.DruckerPrager)
LOST = replace(CONE, residual_friction=20.0, softening_strain=0.1, tension_cutoff=None)
ROCK = mpm.Soil(young=5e7, strength=None)


def layered(*soils, numerics=NUMERICS, drawn=DRAWN, **given):
    bottoms = [BELOW, [(0, 1), (16, 1)]][: len(soils) - 1]
    layers = [mpm.Layer(soil, bottom) for soil, bottom in zip(soils, [*bottoms, None], strict=True)]
    return mpm.section(drawn, layers, numerics, **given)


def particle(scene, position):
    """Number of the particle nearest to a position (m)."""
    at = np.asarray(scene.particles.position)
    return int(np.argmin(((at - np.array(position)[:, None]) ** 2).sum(axis=0)))


def placed(scene, values):
    """Values (..., N) in the order of the positions."""
    return np.asarray(values)[..., np.lexsort(np.asarray(scene.particles.position))]


def test_layers_of_a_kind_are_one_law_and_others_follow_one_another():
    scene, _ = layered(FILL, CLAY, ROCK, at_rest=False)
    assert [type(law).__name__ for law in scene.material.laws] == ["MohrCoulomb", "J2", "Elastic"]
    assert sum(scene.material.counts) == scene.particles.mass.size
    for law, own in scene.material.zones:
        at = particle(scene, {"MohrCoulomb": (1, 5), "J2": (8, 1.2), "Elastic": (8, 0.3)}[type(law).__name__])
        assert own.start <= at < own.stop
    alike, _ = layered(CLAY, replace(CLAY, strength=20e3), at_rest=False)
    assert isinstance(alike.material, mpm.laws.J2)
    # The third layer is of the first one's kind: their particles follow one law.
    two, _ = layered(FILL, CLAY, replace(FILL, friction=35.0), at_rest=False)
    assert [type(law).__name__ for law in two.material.laws] == ["MohrCoulomb", "J2"]
    assert np.unique(two.material.laws[0].friction).size == 2


@pytest.mark.parametrize(("soil", "finite"), [(CLAY, True), (CONE, False), (LOST, False)])
def test_one_soil_written_as_two_kinds_moves_as_one(soil, finite):
    numerics = replace(NUMERICS, finite_strain=finite)
    scene, state = mpm.section(DRAWN, soil, numerics)
    half = int(scene.particles.mass.size * 0.4)
    two = replace(
        scene, material=mpm.laws.Zoned((scene.material, scene.material), (half, scene.particles.mass.size - half))
    )
    one, other = (mpm.advance(s, state, 60) for s in (scene, two))
    assert float(jnp.max(abs(one.displacement))) > 1e-4
    for name in ("displacement", "stress", "history", "gap"):
        values = getattr(one, name)
        if values is not None:
            scale = 1e-4 * float(jnp.max(abs(values))) + 1e-12
            np.testing.assert_allclose(getattr(other, name), values, atol=scale)


def test_each_zone_has_its_own_history_gap_and_return():
    scene, state = layered(LOST, CLAY, ROCK, at_rest=False)
    law = scene.material
    count = scene.particles.mass.size
    assert state.history.shape == state.gap.shape == (count,)
    rng = np.random.default_rng(1)

    def tensor(scale):
        rows = jnp.asarray(scale * rng.normal(size=(4, count)), jnp.float32)
        return (rows[0], rows[1], rows[2], 0.0, 0.0, rows[3])

    strain, stress = tensor(3e-3), tensor(2e4)
    history = jnp.asarray(rng.uniform(0, 0.05, count), jnp.float32)
    gap = jnp.asarray(rng.uniform(0, 1e-3, count), jnp.float32)
    dt = jnp.asarray(1e-3, jnp.float32)
    result = update_with_gap(law, strain, stress, history, dt, gap=gap)
    for part, own in law.zones:
        mine = [tuple(c if isinstance(c, float) else c[own] for c in each) for each in (strain, stress)]
        kind = type(part).__name__
        remembers = {"J2": True, "DruckerPrager": False, "Elastic": False}[kind]
        softens = kind != "Elastic"
        alone = update_with_gap(
            part, *mine, history[own] if softens else None, dt, gap=gap[own] if remembers else None
        )  # fmt: skip
        for k in (0, 1, 2, 5):
            np.testing.assert_allclose(result[0][k][own], alone[0][k], rtol=1e-5, atol=1)
        np.testing.assert_array_equal(result[1][own], alone[1] if softens else history[own])
        np.testing.assert_array_equal(result[2][own], alone[2] if remembers else 0 * gap[own])


def test_lanes_of_unlike_strength_move_as_each_alone():
    scene, state = layered(CONE, CLAY)
    count = scene.particles.mass.size
    strengths = jnp.asarray([[8e3], [12e3]]) * jnp.ones(count)
    cohesions = jnp.asarray([2e3, 5e3])
    varied, axes = mpm.run.lanes(scene, strength=strengths, cohesion=cohesions)
    together = mpm.run.advance_lanes(varied, mpm.run.repeat(state, 2), jnp.asarray([40, 40]), axes)
    for lane in range(2):
        alone, start = mpm.with_soil(scene, state, strength=strengths[lane], cohesion=cohesions[lane])
        after = mpm.advance(alone, start, 40)
        scale = float(jnp.max(abs(after.displacement)))
        np.testing.assert_allclose(together.displacement[lane], after.displacement, atol=1e-4 * scale)
    batch = {"strength": list(strengths), "cohesion": list(cohesions)}
    ends = dict(mpm.solve_each(scene, state, batch, width=2, t_end=0.1))
    assert ends[0].state.displacement.max() != ends[1].state.displacement.max()


def test_float32_and_both_engines_agree_with_float64():
    with jax.enable_x64(True):
        exact, start = layered(LOST, CLAY, ROCK, numerics=replace(NUMERICS, dtype="float64"))
        exact_end = mpm.advance(
            replace(exact, numerics=replace(exact.numerics, engine=mpm.Engine.XLA)), start, 60
        ).displacement
        exact_end = np.asarray(exact_end)
    scale = abs(exact_end).max()
    scene, state = layered(LOST, CLAY, ROCK)
    for engine in (mpm.Engine.XLA, *([mpm.Engine.NATIVE] if mpm.transfer.native_available() else [])):
        end = mpm.advance(replace(scene, numerics=replace(scene.numerics, engine=engine)), state, 60)
        np.testing.assert_allclose(end.displacement, exact_end, atol=2e-3 * scale)


def test_names_reach_every_zone_that_has_them():
    scene, state = layered(FILL, CLAY, at_rest=False)
    sand, clay = scene.material.laws
    x = scene.particles.position[0]
    varied, _ = mpm.with_soil(scene, state, strength=10e3 + x, softening_modulus=15e3, tension_cutoff=500.0)
    count = scene.material.counts[0]
    np.testing.assert_allclose(varied.material.laws[1].strength, 10e3 + x[count:], rtol=1e-6)
    assert varied.material.laws[0].cohesion is sand.cohesion
    assert varied.material.laws[1].softening.modulus == 15e3
    assert [float(law.tension_cutoff) for law in varied.material.laws] == [500.0, 500.0]
    # What a zone does not have is nan there, whatever is given for it.
    at = declared(scene.material)["strength"].value
    assert np.isnan(at[:count]).all()
    np.testing.assert_array_equal(at[count:], np.full(len(x) - count, clay.strength))
    mpm.with_soil(scene, state, strength=jnp.where(jnp.arange(len(x)) < count, jnp.nan, 9e3))
    stiffer = mpm.with_soil(scene, state, young=1e7)[0]
    np.testing.assert_allclose(stiffer.material.p_wave_modulus, 1e7 * 0.7 / (1.3 * 0.4), rtol=1e-5)
    assert float(stiffer.numerics.time_step) < float(scene.numerics.time_step)
    with pytest.raises(ValueError, match=r"\['suction'\] is no parameter of Zoned: use some of \['bulk', "):
        mpm.with_soil(scene, state, suction=1.0)
    with pytest.raises(ValueError, match="strength = -1 Pa"):
        mpm.with_soil(scene, state, strength=-1.0)
    with pytest.raises(ValueError, match="snaps back"):
        mpm.run.lanes(scene, softening_modulus=jnp.asarray([10e3, 1e9]))
    with pytest.raises(ValueError, match="dilation is up to 10 degrees above the friction"):
        mpm.run.lanes(
            scene, friction=jnp.radians(jnp.asarray([30.0, 20.0])), dilation=jnp.radians(jnp.asarray([5.0, 30]))
        )


def test_reduction_divides_the_strength_of_every_zone_that_has_some():
    scene, _ = layered(FILL, CLAY, ROCK, at_rest=False)
    weaker = mpm.reduced(scene, 1.25)
    (sand, clay, rock), (sand_less, clay_less, rock_less) = scene.material.laws, weaker.material.laws
    np.testing.assert_allclose(clay_less.strength, clay.strength / 1.25, rtol=1e-6)
    np.testing.assert_allclose(jnp.tan(sand_less.friction), jnp.tan(sand.friction) / 1.25, rtol=1e-6)
    assert rock_less is rock
    rocks = mpm.laws.Zoned((rock, rock), (10, scene.particles.mass.size - 10))
    both = mpm.scene(scene.particles, scene.grid, rocks, NUMERICS)
    with pytest.raises(ValueError, match="no zone of Elastic and Elastic has strength to divide"):
        mpm.reduced(both, 1.25)


def test_gradients_by_the_strength_of_both_kinds_are_those_of_differences():
    with jax.enable_x64(True):
        scene, state = layered(CONE, CLAY, numerics=replace(NUMERICS, dtype="float64"))

        def objective(state):
            return jnp.mean(state.displacement**2) * 1e6

        @jax.jit
        def reached(values):
            varied = replace(scene, material=with_parameters(scene.material, values))
            return objective(mpm.replay(varied, state, 40)[0])

        values = {"strength": jnp.asarray(9e3), "cohesion": jnp.asarray(1e3), "friction": jnp.asarray(0.4)}
        slope = jax.jit(jax.grad(reached))(values)
        for name, value in values.items():
            step = 1e-5 * value
            up, down = (reached({**values, name: value + sign * step}) for sign in (1, -1))
            assert float(slope[name]) == pytest.approx(float((up - down) / (2 * step)), rel=1e-3)
            assert float(slope[name]) != 0
        total, by = mpm.sensitivity(scene, state, objective, ["strength"], steps=40)
        each = by["strength"]
        assert float(total) > 0
        assert not np.any(each[: scene.material.counts[0]])
        assert np.any(each[scene.material.counts[0] :])


def test_clay_beside_fill_is_as_soil_with_friction_zero():
    # Averaged over cells, soil that is declared frictional would keep its own mean stress.
    numerics = replace(NUMERICS, cell_average=False)
    clay = mpm.Soil(young=5e6, strength=8e3, tension_cutoff=None)
    same = replace(CONE, young=5e6, cohesion=8e3, friction=0.0, dilation=0.0, tension_cutoff=None)
    one, other = (
        mpm.advance(mpm.reduced(scene, 1.2), state, 120)
        for scene, state in (layered(CONE, soil, numerics=numerics) for soil in (clay, same))
    )
    displacement = placed(*(layered(CONE, clay)[0], one.displacement))
    largest = abs(displacement).max()
    assert largest > 0.02
    np.testing.assert_allclose(placed(layered(CONE, same)[0], other.displacement), displacement, atol=1e-3 * largest)


def test_water_does_not_enter_the_strength_of_undrained_layers():
    sand = mpm.FrictionalSoil(2e3, 32.0, young=8e6)
    clay = mpm.Soil(young=5e6, strength=15e3, tension_cutoff=0.0)
    drawn = mpm.Section([(0, 6), (8, 6)])
    bottom = [(0, 3), (8, 3)]
    for loads, pressure in (({"water": 5.0}, lambda z: 9810 * np.maximum(5 - z, 0)), ({"r_u": 0.3}, None)):
        scene, state = mpm.section(drawn, [mpm.Layer(sand, bottom), mpm.Layer(clay)], NUMERICS, **loads)
        z = np.asarray(scene.particles.position[1])
        undrained = np.repeat([False, True], scene.material.counts)
        if pressure is None:
            assert not np.any(np.asarray(scene.loads.pore_pressure)[undrained])
            np.testing.assert_allclose(
                scene.loads.pore_pressure[~undrained], 0.3 * 20e3 * (6 - z[~undrained]), rtol=1e-5
            )
            u = np.asarray(scene.loads.pore_pressure)
        else:
            u = pressure(z)
        # The total stress bears the weight through both kinds.
        total = np.asarray(state.stress[2]) - u
        np.testing.assert_allclose(total, -20e3 * (6 - z), rtol=0.03, atol=1500)
    with pytest.raises(ValueError, match="pore_pressure above 0 in a zone whose strength is undrained: give 0 Pa"):
        mpm.scene(
            scene.particles,
            scene.grid,
            scene.material,
            NUMERICS,
            loads=mpm.Loads(pore_pressure=np.ones(undrained.size)),
        )
    with pytest.raises(ValueError, match="pore pressure by r_u in Zoned, whose strength is undrained"):
        mpm.section(
            drawn, [mpm.Layer(clay, bottom), mpm.Layer(replace(clay, softening_modulus=9e3))], NUMERICS, r_u=0.1
        )


def test_a_free_field_and_a_restart_know_every_zone(tmp_path):
    drawn, motion = mpm.Section([(0, 6), (8, 6)]), mpm.BaseMotion(jnp.ones((2, 50)), jnp.asarray(0.01))
    layers = [mpm.Layer(CONE, [(0, 3), (8, 3)]), mpm.Layer(CLAY)]
    scene, state = mpm.section(drawn, layers, NUMERICS, ends="free field", motion=motion, at_rest=False)
    assert [column.material.counts for column in (scene.free_field.low, scene.free_field.high)] == [(12, 12)] * 2
    after = mpm.advance(scene, state, 20)
    assert float(jnp.max(abs(after.displacement))) > 0
    alone, start = layered(LOST, CLAY, at_rest=False)
    first = mpm.advance(alone, start, 10)
    mpm.save_state(tmp_path / "state.h5", first)
    again, _ = mpm.load_state(tmp_path / "state.h5", start)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    end, other = (mpm.advance(alone, begin, 10) for begin in (first, again))
    np.testing.assert_array_equal(end.displacement, other.displacement)


def test_averaged_plastic_strain_goes_over_zones_that_soften():
    numerics = replace(NUMERICS, internal_length=1.5)
    scene, state = layered(LOST, CLAY, ROCK, numerics=numerics)
    after = mpm.advance(mpm.reduced(scene, 2.0), state, 100)
    assert float(jnp.max(after.history)) > 0
    with pytest.raises(ValueError, match=r"internal_length = 1.5 m, but the soil does not soften"):
        layered(FILL, ROCK, numerics=numerics)


def test_what_zones_cannot_be_is_refused():
    scene, _ = layered(FILL, CLAY, at_rest=False)
    with pytest.raises(ValueError, match=r"counts = \(3, 4\) for 2 laws and \d+ particles: give the number of each"):
        mpm.scene(scene.particles, scene.grid, replace(scene.material, counts=(3, 4)), NUMERICS)
    with pytest.raises(ValueError, match="fbar = True with a frictional soil"):
        layered(FILL, CLAY, numerics=replace(NUMERICS, fbar=True))


@pytest.mark.slow
def test_an_embankment_on_clay_fails_as_slip_circles_say():
    # Spencer's method by xslope (benchmarks.sites.limit_equilibrium), critical circle through fill and clay: 1.228.
    bank = mpm.Section([(0, 11), (12, 11), (22, 6), (40, 6)])
    fill = mpm.FrictionalSoil(2e3, 32.0, unit_weight=20e3, young=3e7)
    clay = mpm.Soil(unit_weight=18e3, young=3e7, strength=22e3, tension_cutoff=0.0)
    same = replace(fill, cohesion=22e3, friction=0.0, unit_weight=18e3)
    kinks = []
    for below in (clay, same):
        layers = [mpm.Layer(fill, [(0, 6), (22, 6)]), mpm.Layer(below)]
        scene, state = mpm.section(bank, layers, mpm.Discretisation(1.0, (0.5, 0.5), cell_average=True))
        result = mpm.factor_of_safety(
            scene, state, criterion="limit load", bracket=(0.8, 2.4), resolution=0.02, batch=4, t_end=10.0
        )
        kinks.append(result.kink)
    assert kinks[0] == pytest.approx(1.228, rel=0.06)
    assert kinks[0] == pytest.approx(kinks[1], rel=0.02)
