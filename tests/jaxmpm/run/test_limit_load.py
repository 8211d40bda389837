"""A factor of safety by the limit load: the stiffness it is sought at, and where displacement turns over R."""

import re
import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

import jaxmpm as mpm
from jaxmpm.run import _limit_load, _strength_reduction, limit_load_scene
from jaxmpm.run._limit_load import Kink, Moved, Scale, find_kink, find_start, heights, lowest_local, moved, stands_to
from jaxmpm.run._strength_reduction import reductions
from tests.jaxmpm.verification.test_limits import CUT

COARSE = mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.9, cell_average=True)
SLOPE = mpm.Slope(crest=6.0, height=4.0, run_per_rise=1.0, toe=8.0, foundation=1.0)
CLAY = mpm.Soil(unit_weight=20e3, strength=18e3, tension_cutoff=None)


@given(turn=some.floats(1.0, 1.5), off=some.floats(-0.1, 0.12), steep=some.floats(2.0, 20.0), yields=some.floats(0, 8))
def test_the_kink_is_where_the_branches_meet_and_lies_in_its_bracket(turn, off, steep, yields):
    def curve(factor):
        return 0.004 * np.exp(yields * (factor - turn)) + steep * np.maximum(factor - turn, 0)

    kink = find_kink(curve, turn * (1 + off), 0.01, 0.1)
    assert abs(kink.at / turn - 1) < 0.015
    assert kink.stands <= kink.at < kink.moves
    assert kink.moves - kink.stands <= 0.03
    assert kink.sharpness > 5


@given(turn=some.floats(1.0, 1.5), off=some.floats(-0.1, 0.1), jump=some.floats(0.5, 5.0), yields=some.floats(0, 15))
def test_where_displacement_jumps_the_bracket_closes_on_the_jump(turn, off, jump, yields):
    """What yields below the jump bends before it, and is not off the branch that stands."""

    def curve(factor):
        return np.where(factor <= turn, 0.012 * np.exp(yields * (factor - turn)), jump + 3 * (factor - turn))

    kink = find_kink(curve, turn * (1 + off), 0.01, 0.1)
    assert kink.stands <= turn < kink.moves
    assert kink.stands <= kink.at <= kink.moves
    assert kink.moves - kink.stands <= 0.0201
    assert kink.sharpness > 100


def test_lanes_that_slide_off_the_grid_are_beyond_the_kink():
    kink = find_kink(lambda factor: np.where(factor < 1.2, 0.004 * factor, np.inf), 1.21, 0.01, 0.1)
    assert kink.stands < 1.2 <= kink.moves
    assert kink.moves - kink.stands <= 0.0201


def test_displacement_that_grows_evenly_has_no_kink():
    with pytest.raises(ValueError, match=r"no kink, .* grows too evenly .* give a failure_displacement"):
        find_kink(lambda factor: 0.01 * factor, 1.2, 0.01, 0.1)


def test_displacement_that_falls_is_no_even_growth_and_is_named():
    # As a slope of sand with half its weight borne by water does: it moves at 0.80 and 0.82 and stands at 0.84.
    over = [0.76, 0.78, 0.80, 0.82, 0.84, 0.87, 0.95, 1.1]
    displacement = [0.04, 0.05, 0.69, 0.83, 0.12, 0.33, 0.72, 1.9]
    with pytest.warns(UserWarning, match=r"limit load at R = 0.\d+ is in doubt") as warned:
        find_kink(lambda factor: np.interp(factor, over, displacement), 0.82, 0.01, 0.3)
    seen = re.search(r"it moves ([\d.]+) m at R = ([\d.]+) and ([\d.]+) m at R = ([\d.]+),", str(warned[0].message))
    more, at, less, then = map(float, seen.groups())
    assert more > 1.5 * less
    assert 0.78 < at < 0.83 < then < 0.87


@given(turn=some.floats(0.55, 2.9), batch=some.integers(2, 8))
def test_the_search_starts_beside_the_factor_that_moves(turn, batch):
    rounds = []

    def displacement(factors):
        rounds.append(len(factors))
        return np.where(factors < turn, 0.01, 1.0)

    start = find_start(displacement, 0.1, (0.5, 3.0), batch)
    assert abs(start / turn - 1) <= _limit_load.COARSE - 1
    assert max(rounds) <= batch


@pytest.mark.parametrize(("metres", "message"), [(0.0, "stands even at R = 3"), (1.0, "fails even at R = 0.5")])
def test_a_bracket_without_the_factor_is_refused(metres, message):
    with pytest.raises(ValueError, match=message):
        find_start(lambda factors: np.full(factors.size, metres), 0.1, (0.5, 3.0), 2)


def test_a_slip_smaller_than_the_least_volume_is_reported_once_it_is_more_than_grains():
    tried = [(0.9, 0.0, 0.1), (1.0, 0.01, 2.0), (1.1, 0.01, 3.0), (1.2, 0.5, 40.0)]
    assert lowest_local(tried, 1.15, 5.0) == (1.0, 2.0)
    assert lowest_local(tried, 0.95, 5.0) is None
    assert lowest_local(tried, 1.15, 50.0) is None


def test_the_relief_is_that_of_the_surface():
    scene, _ = mpm.slope(SLOPE, CLAY, COARSE, at_rest=False)
    assert heights(scene) == pytest.approx((5.0, 4.0), abs=0.3)
    level, _ = mpm.section(mpm.Section([(0, 3), (4, 3)], base=0.0), CLAY, COARSE, at_rest=False)
    assert heights(level) == pytest.approx((3.0, 3.0))


def displacements(scene, state, factors, young=None):
    scene = limit_load_scene(scene) if young is None else limit_load_scene(scene, young)
    varied, axes = reductions(scene, jnp.asarray(factors, jnp.float32))
    return moved(varied, mpm.run.repeat(state, len(factors)), axes, Scale.of(scene, 20.0, None)).displacement


def test_displacement_is_elastic_below_the_limit_load_alone():
    scene, state = mpm.slope(SLOPE, CLAY, COARSE)
    soft, stiff = (displacements(scene, state, [0.9, 1.5], young) for young in (500.0, 2000.0))
    assert 2.5 < soft[0] / stiff[0] < 6.0
    assert soft[1] / stiff[1] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("soil", [CLAY, mpm.FrictionalSoil(5e3, 25.0, unit_weight=20e3)])
def test_the_limit_load_does_not_depend_on_the_modulus_nor_on_poissons_ratio(soil):
    stiff = []
    for young, poisson in ((1e6, 0.3), (1e9, 0.3), (1e7, 0.45)):
        numerics = replace(COARSE, flip=1.0)
        scene, _ = mpm.slope(SLOPE, replace(soil, young=young, poisson=poisson), numerics, at_rest=False)
        stiff.append(limit_load_scene(scene))
    for other in stiff[1:]:
        assert jax.tree.all(jax.tree.map(lambda a, b: np.allclose(a, b, rtol=1e-3), stiff[0], other))


def test_the_share_of_pic_in_a_second_stays():
    scene, _ = mpm.slope(SLOPE, mpm.FrictionalSoil(5e3, 25.0), replace(COARSE, flip=0.98), at_rest=False)
    stiff = limit_load_scene(scene)
    rates = [float(jnp.log(each.numerics.flip) / each.numerics.time_step) for each in (scene, stiff)]
    assert rates[0] == pytest.approx(rates[1], rel=1e-3)
    assert float(stiff.numerics.time_step) != float(scene.numerics.time_step)


def test_zones_get_one_stiffness_and_soil_that_softens_keeps_its_own():
    layers = [mpm.Layer(replace(CLAY, young=1e6), [(0, 0.5), (18, 0.5)]), mpm.Layer(replace(CLAY, young=1e10))]
    scene, _ = mpm.section(mpm.Section([(0, 5), (6, 5), (10, 1), (18, 1)], base=0.0), layers, COARSE, at_rest=False)
    shear = np.unique(limit_load_scene(scene).material.shear)
    assert shear.size == 1
    softening = replace(CLAY, softening_modulus=60e3)
    scene, _ = mpm.slope(SLOPE, softening, COARSE, at_rest=False)
    assert limit_load_scene(scene) == scene


def test_a_lane_that_slides_out_of_the_grid_has_moved_and_one_that_breaks_off_before_is_an_error():
    scene, state = mpm.slope(SLOPE, CLAY, COARSE)
    varied, axes = reductions(limit_load_scene(scene), jnp.asarray([1.0, 2.0], jnp.float32))
    scale = Scale.of(varied, 20.0, None)
    # Two grains start beside the edge of the grid, at a speed that takes them out: of a slope that slides, and stands.
    out = jnp.zeros_like(state.velocity).at[0, -1].set(60.0)
    lanes = mpm.run.repeat(replace(state, velocity=out), 2)
    with pytest.raises(FloatingPointError, match="lane 0"):
        moved(varied, lanes, axes, replace(scale, moves=1e3))
    slid = moved(varied, lanes, axes, replace(scale, moves=1e-9))
    assert isinstance(slid, Moved)
    assert slid.slid.all()
    assert not moved(varied, mpm.run.repeat(state, 2), axes, scale).slid[0]


@pytest.mark.slow
@pytest.mark.parametrize(("young", "poisson"), [(4e6, 0.3), (6e7, 0.45)])
def test_soft_and_stiff_clay_have_the_limit_load_of_slip_circles(young, poisson):
    # The published section: 1.142 to 1.147 by slip circles, 1.14 by finite differences. 100 and 1400 times s_u.
    soil = mpm.Soil(strength=42e3, young=young, poisson=poisson, tension_cutoff=0.0)
    scene, state = mpm.slope(mpm.Slope(), soil, mpm.Discretisation(2.0, (1.0, 1.0), cfl=0.9, fbar=True))
    result = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=(0.9, 1.6), batch=3)
    assert abs(result.kink / 1.144 - 1) < 0.04
    assert result.stable <= result.kink < result.fails <= result.stable + 0.03
    assert result.sharpness > 10
    assert 0.05 * 12**2 < result.volume < 800
    assert result.local is None


@pytest.mark.slow
def test_a_weak_patch_of_less_than_the_least_volume_is_named():
    scene, state = mpm.slope(
        mpm.Slope(),
        mpm.Soil(strength=42e3, tension_cutoff=0.0),
        mpm.Discretisation(2.0, (1.0, 1.0), cfl=0.9, fbar=True),
    )
    x, z = np.asarray(scene.particles.position)
    face = np.interp(x, [30, 54], [16, 4])
    patch = (x > 36) & (x < 48) & (face - z < 3)
    weak = mpm.with_soil(scene, state, strength=np.where(patch, 3e3, 42e3))[0]
    choices = {"criterion": "limit load", "bracket": (0.7, 1.6), "batch": 2, "least_volume": 50.0}
    result = mpm.factor_of_safety(weak, state, **choices)
    assert patch.sum() < 50
    assert abs(result.kink / 1.168 - 1) < 0.03
    assert result.local is not None
    assert result.local[0] < 1.0
    assert 5 <= result.local[1] <= patch.sum()


@pytest.mark.slow
def test_soil_that_dilates_by_its_friction_has_a_factor():
    # Lanes far above the factor leave the grid.
    soil = mpm.FrictionalSoil(10e3, 20.0, dilation=20.0, unit_weight=18e3, young=2e7)
    shape = mpm.Slope(crest=15.0, height=9.0, run_per_rise=1.5, toe=15.0, foundation=3.0)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(1.5, (0.75, 0.75), cfl=0.9, flip=0.99))
    result = mpm.factor_of_safety(scene, state, criterion="limit load", batch=2)
    assert result.kink == pytest.approx(1.32, rel=0.04)
    assert result.stable <= result.kink < result.fails


@pytest.mark.slow
def test_where_soil_softens_both_criteria_mean_the_same():
    shape = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
    soil = mpm.Soil(young=1e7, strength=22e3, softening_modulus=60e3, tension_cutoff=0.0)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    choices = {"bracket": (1.1, 1.6), "resolution": 0.02, "batch": 4, "t_end": 6.0}
    by_displacement = mpm.factor_of_safety(scene, state, failure_displacement=0.5, **choices)
    by_load = mpm.factor_of_safety(scene, state, criterion="limit load", **choices)
    assert by_displacement.kink is by_displacement.sharpness is by_displacement.volume is None
    assert abs(by_load.fails - by_displacement.fails) <= 0.02
    assert abs(by_load.kink - by_displacement.stable) < 0.04


def test_other_criteria_and_times_too_short_are_refused():
    soil = mpm.Soil(young=1e5, strength=22e3, tension_cutoff=0.0, unusual=True)
    scene, state = mpm.slope(CUT, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match="criterion = 'limit': give 'limit load', or a failure_displacement"):
        mpm.factor_of_safety(scene, state, criterion="limit")
    with pytest.raises(ValueError, match="both criterion and failure_displacement"):
        mpm.factor_of_safety(scene, state, criterion="limit load", failure_displacement=0.5)
    with pytest.raises(ValueError, match="settle is given by the limit load"):
        mpm.factor_of_safety(scene, state, criterion="limit load", settle=mpm.Settle())
    weightless = replace(scene, loads=replace(scene.loads, gravity=0 * scene.loads.gravity))
    with pytest.raises(ValueError, match="gravity = 0 m/s2"):
        mpm.factor_of_safety(weightless, state, criterion="limit load")
    with pytest.raises(ValueError, match=r"t_end = 1 s, but ground 6 m high takes 1.6 s to show that it moves"):
        mpm.factor_of_safety(scene, state, criterion="limit load", t_end=1.0)
    softening = mpm.Soil(young=1e5, strength=22e3, softening_modulus=2e3, tension_cutoff=0.0, unusual=True)
    scene, state = mpm.slope(CUT, softening, mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match=r"t_end = 4 s, but soil this soft takes .* give [\d.]+ s or more"):
        mpm.factor_of_safety(scene, state, criterion="limit load", t_end=4.0)


ENDLESS = mpm.Section([(0, 4), (2, 4)])
TILT = 0.3
"""Horizontal over vertical acceleration of a layer without ends, which stands for the tangent of a slope."""
LAYERS = {
    "mu(I)": (mpm.GranularSoil(30.0, 38.0, 0.01, unit_weight=18e3), np.tan(np.radians(30.0)) / TILT),
    "Cam Clay": (mpm.CamClaySoil(0.1, 0.02, 1.0, unit_weight=18e3), 1.0 / np.sqrt(3) / TILT),
    "anisotropic": (mpm.AnisotropicSoil(40e3, 30e3, 20e3, unit_weight=18e3), 30e3 / (18e3 * 3.5 * TILT)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", LAYERS)
def test_an_endless_slope_fails_where_its_law_bears_no_more_in_simple_shear(kind):
    """mu_s p, M p / sqrt(3) at the critical state, where the mean stress is the vertical one, and the simple strength.

    Clay, which sticks to the base, shears in the lowest cell, half a cell above it, and grains at any height.
    """
    soil, exact = LAYERS[kind]
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), flip=0.9)
    scene, state = mpm.section(ENDLESS, soil, numerics, k_h=TILT, ends="tied", speed=3.0)
    result = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=(0.5, 1.7 * exact))
    assert result.kink == pytest.approx(exact, rel=0.05)


def least_by_circles(section, weight, active, simple, passive):
    """Upper bound of the factor: the least work of the strength along slip circles over that of the weight.

    On a plane that dips by t downhill the strength is that of simple shear, and sin(2 t) times half the difference of
    active and passive.
    """
    x_line, z_line = np.array(section).T
    least = np.inf
    for centre in np.stack(np.meshgrid(np.linspace(6, 13, 15), np.linspace(5.2, 12, 21)), axis=-1).reshape(-1, 2):
        for bottom in np.linspace(0.0, 1.0, 5):
            radius = centre[1] - bottom
            x = centre[0] + radius * np.linspace(-1, 1, 2001)
            z = centre[1] - np.sqrt(np.maximum(radius**2 - (x - centre[0]) ** 2, 0))
            inside = np.flatnonzero(z < np.interp(x, x_line, z_line))
            x, z = x[inside[0] : inside[-1] + 1], z[inside[0] : inside[-1] + 1]
            height = np.interp(x, x_line, z_line) - z
            if x[0] < x_line[0] or x[-1] > x_line[-1] or height.min() < 0:
                continue
            dx, dz = np.diff(x), np.diff(z)
            strength = simple + (active - passive) / 2 * np.sin(2 * np.arctan2(-dz, dx))
            weighed = weight * (height[1:] + height[:-1]) / 2 * dx * (centre[0] - (x[1:] + x[:-1]) / 2)
            if weighed.sum() > 0:
                least = min(least, radius * (strength * np.hypot(dx, dz)).sum() / weighed.sum())
    return least


@pytest.mark.slow
@pytest.mark.parametrize(("active", "passive", "cell"), [(1.0, 1.0, 0.5), (1.3, 0.7, 0.25)])
def test_strength_by_direction_has_the_factor_of_slip_circles(active, passive, cell):
    """Eight cells of height give 0.4 % more, with strength by direction 2.1 %, and sixteen there 0.2 % less."""
    section = [(0, 5), (6, 5), (12, 1), (20, 1)]
    strengths = 16e3 * active, 16e3, 16e3 * passive
    numerics = mpm.Discretisation(cell, (cell / 2, cell / 2), cell_average=True)
    scene, state = mpm.section(mpm.Section(section), mpm.AnisotropicSoil(*strengths, unit_weight=20e3), numerics)
    result = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=(1.1, 1.6), batch=3)
    assert result.kink == pytest.approx(least_by_circles(section, 20e3, *strengths), rel=0.02)


@pytest.mark.parametrize("kind", ["Cam Clay", "anisotropic"])
def test_a_law_that_hardens_is_stiffened_and_keeps_its_strength(kind):
    soil, cam = LAYERS[kind][0], kind == "Cam Clay"
    strains = ("compression", "swelling") if cam else ("failure_strain",)
    laws = []
    for factor in (1.0, 3.0):
        stiffer = {name: getattr(soil, name) / factor for name in strains} | (
            {} if cam else {"young": factor * soil.young}
        )
        scene, _ = mpm.section(ENDLESS, replace(soil, **stiffer), COARSE, at_rest=False)
        laws.append(limit_load_scene(scene).material)
    assert all(np.allclose(a, b, rtol=1e-5) for a, b in zip(*map(jax.tree.leaves, laws), strict=True))
    test = "triaxial drained" if cam else "simple shear undrained"
    before = mpm.laws.element_test(soil.material(np.float32, 1.0), test, pressure=50e3, strain=1.0, steps=500)
    after = mpm.laws.element_test(laws[0], test, pressure=50e3, strain=0.1, steps=500)
    measure = "deviatoric" if cam else "shear_stress"
    assert float(getattr(after, measure)[-1]) == pytest.approx(float(getattr(before, measure)[-1]), rel=0.01)


GRAINS = mpm.GranularSoil(30.0, 38.0, 0.01, unit_weight=18e3)


@given(slope=some.floats(0.2, 1.5), angle=some.floats(20.0, 40.0))
def test_no_flow_in_plane_strain_bears_grains_on_a_plane_beyond_their_factor(slope, angle):
    """Of all stresses along the plane one is within mu_s p below the factor, and none above."""
    law = replace(GRAINS, static_friction=angle, dynamic_friction=angle + 5).material(jnp.float32, 1.0)
    along = np.linspace(0.01, 10.0, 10_000)
    pressure, shear = (1 + along) / 2, np.hypot((1 - along) / 2, slope)
    assert np.tan(np.radians(angle)) / np.min(shear / pressure) == pytest.approx(float(law.stands_to(slope)), rel=1e-3)


@pytest.mark.parametrize("width", [None, 2.0])
@pytest.mark.parametrize(("run_per_rise", "cell"), [(1.0, 1.0), (1.5, 0.5), (2.0, 0.5)])
def test_soil_without_cohesion_stands_to_the_factor_of_its_face(run_per_rise, cell, width):
    shape = mpm.Slope(crest=4.0, height=4.0, run_per_rise=run_per_rise, toe=4.0, foundation=1.0, width=width)
    numerics = mpm.Discretisation(cell, (cell / 2,) * (2 if width is None else 3))
    factors = {"sand": 1.0, "grains": np.hypot(1, 1 / run_per_rise)}  # 1 / tan and 1 / sin of the slope
    for soil, kind in ((mpm.FrictionalSoil(0.0, 30.0, unusual=True), "sand"), (GRAINS, "grains")):
        exact = np.tan(np.radians(30)) * run_per_rise * factors[kind]
        most = stands_to(mpm.slope(shape, soil, numerics, at_rest=False)[0])
        assert exact < most < exact / (1 - cell / 2 / 4.0) * 1.01
    assert stands_to(mpm.slope(shape, mpm.FrictionalSoil(1e2, 30.0), numerics, at_rest=False)[0]) == np.inf


@pytest.mark.parametrize("facing", [1, -1])
def test_the_face_is_that_to_the_level_of_gravity_and_level_ground_has_none(facing):
    numerics, sand = mpm.Discretisation(0.5, (0.25, 0.25)), mpm.FrictionalSoil(0.0, 30.0, unusual=True)
    face = [(0, 5), (4, 5), (8, 1), (12, 1)]
    drawn = mpm.Section([(facing * x, z) for x, z in face][::facing])
    scene, _ = mpm.section(drawn, sand, numerics, k_h=0.2, at_rest=False)
    exact = np.tan(np.radians(30)) / np.tan(np.pi / 4 + np.arctan(0.2))
    assert exact < stands_to(scene) < 1.12 * exact
    level, _ = mpm.section(ENDLESS, sand, numerics, at_rest=False)
    assert stands_to(level) == np.inf
    tilted, _ = mpm.section(ENDLESS, sand, numerics, k_h=TILT, ends="tied", speed=3.0, at_rest=False)
    assert stands_to(tilted) == pytest.approx(np.tan(np.radians(30)) / TILT, rel=1e-5)


@pytest.mark.parametrize(("at", "flip"), [(1.2, 0.95), (0.5, 1.0), (0.5, 0.95)])
def test_a_limit_load_that_no_stress_bears_is_refused_and_one_of_pure_flip_in_doubt(at, flip, monkeypatch):
    scene, state = mpm.slope(SLOPE, GRAINS, replace(COARSE, flip=flip), at_rest=False)
    monkeypatch.setattr(_strength_reduction, "find_start", lambda *_: at)
    monkeypatch.setattr(_strength_reduction, "find_kink", lambda *_: Kink(at, at - 0.01, at + 0.01, 80.0))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if at > 1:
            with pytest.raises(ValueError, match=r"R = 1.2 is that of .* cells of 1 m.* up to R = 0.877 at most"):
                mpm.factor_of_safety(scene, state, criterion="limit load")
        else:
            assert mpm.factor_of_safety(scene, state, criterion="limit load").kink == at
    assert ["compare with flip = 0.95" in str(each.message) for each in said] == [True] * (flip == 1.0)
