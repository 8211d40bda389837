"""Ground on a base of given strength: blocks and layers that slide on it as theory says, and what sticks."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.accuracy import earthquakes
from jaxmpm.laws import softened
from jaxmpm.run._strength_reduction import reductions
from jaxmpm.transfer import band_thickness, passes_for, thickness_on
from tests.differences import check_run
from tests.jaxmpm.step.test_absent import count, program

HALVES = mpm.Discretisation(1.0, (0.5, 0.5), flip=0.9)
STIFF = mpm.FrictionalSoil(200e3, 30.0, unit_weight=20e3, young=2e7)
HEIGHT, WATER = 4.0, 9810.0


def layer(interface, k_h, **water):
    """A layer without end on a level base, pulled along it."""
    shape = mpm.Section([(0, HEIGHT), (4, HEIGHT)], interface=interface)
    return mpm.section(shape, STIFF, HALVES, k_h=k_h, ends="tied", **water)


ON_A_BASE = {
    "both": (mpm.Interface(10.0, 8e3), 0.3, {}, 0.0),
    "r_u": (mpm.Interface(20.0, 5e3), 0.2, {"r_u": 0.3}, 0.3 * STIFF.unit_weight * HEIGHT),
    "water table": (mpm.Interface(20.0, 5e3), 0.2, {"water": 2.0}, 2 * WATER),
}


@pytest.mark.parametrize(("interface", "k_h", "water", "borne"), ON_A_BASE.values(), ids=ON_A_BASE)
def test_a_layer_without_end_slides_from_its_factor_of_safety_on(interface, k_h, water, borne):
    pressed, pull = STIFF.unit_weight * HEIGHT - borne, k_h * STIFF.unit_weight * HEIGHT
    exact = (interface.cohesion + pressed * math.tan(math.radians(interface.friction))) / pull
    scene, state = layer(interface, k_h, **water)
    varied, axes = reductions(scene, exact * jnp.array([0.99, 1.25]))
    result = mpm.solve(varied, mpm.run.repeat(state, 2), t_end=1.0, axes=axes).raise_if_failed()
    stands, slides = np.asarray(result.state.displacement[:, 0]).mean(axis=1)
    assert abs(stands) < 1e-5
    assert np.isclose(slides, 0.5 * k_h * 9.81 * (1 - 1 / 1.25), rtol=0.01)


SOFTENING = {
    "friction": (mpm.Interface(20.0, residual_ratio=0.25, slip_length=0.4), 0.4, {}),
    "cohesion": (mpm.Interface(0.0, 24e3, residual_ratio=0.0, slip_length=0.2), 0.33, {}),
    "both, under water": (mpm.Interface(20.0, 8e3, residual_ratio=0.5, slip_length=0.3), 0.4, {"r_u": 0.3}),
}


@pytest.mark.parametrize(
    ("kind", "scheme"),
    [
        *((kind, mpm.Scheme.MUSL) for kind in SOFTENING),
        *(("friction", each) for each in (mpm.Scheme.USF, mpm.Scheme.USL)),
    ],
)
def test_a_layer_on_a_base_that_softens_runs_away_as_the_closed_form(kind, scheme):
    """u'' = a + (R - r R) u / L up to the slip L, from rest; after it u'' is constant."""
    interface, k_h, water = SOFTENING[kind]
    shape = mpm.Section([(0, HEIGHT), (4, HEIGHT)], interface=interface)
    numerics = replace(HALVES, scheme=scheme, cfl=0.5)
    rigid = replace(STIFF, young=4e8)  # the shear strain of the layer would add some per cent
    scene, state = mpm.section(shape, rigid, numerics, k_h=k_h, ends="tied", **water)
    weight = STIFF.unit_weight * HEIGHT
    pressed = (1 - water.get("r_u", 0.0)) * weight
    held = 9.81 * (interface.cohesion + pressed * math.tan(math.radians(interface.friction))) / weight
    start, growth = k_h * 9.81 - held, held * (1 - interface.residual_ratio) / interface.slip_length
    reached = math.acosh(1 + interface.slip_length * growth / start) / math.sqrt(growth)
    for t_end in (0.8 * reached, 1.4 * reached):
        final = mpm.solve(scene, state, t_end=t_end).raise_if_failed().state
        time = float(scene.numerics.time_step) * int(final.step)
        within = min(time, reached)
        exact = start / growth * (math.cosh(math.sqrt(growth) * within) - 1)
        speed = start / math.sqrt(growth) * math.sinh(math.sqrt(growth) * within)
        beyond = time - within
        exact += speed * beyond + 0.5 * (k_h * 9.81 - held * interface.residual_ratio) * beyond**2
        assert float(np.mean(final.displacement[0])) == pytest.approx(exact, rel=0.01)


@pytest.mark.usefixtures("x64")
def test_gradients_by_the_softening_of_a_base_are_those_of_differences_and_engines_and_lanes_agree():
    scene, state = layer(SOFTENING["both, under water"][0], 0.4, r_u=0.3)

    def travel(scene, residual, length):
        softened = replace(scene, boundary=replace(scene.boundary, softening=jnp.stack([residual, length])))
        return jnp.sum(mpm.advance(softened, state, 150).displacement[0] ** 2)

    check_run(travel, scene, (0.5, 0.05), (1e-6, 1e-7), 1e-4)


@pytest.mark.usefixtures("x64")
def test_gradients_by_a_contact_that_differs_at_its_nodes_are_those_of_differences():
    scene, state = layer(mpm.Interface(20.0, 8e3), 0.5)
    along = jnp.arange(scene.grid.nodes) // scene.grid.shape[1] / scene.grid.shape[0]

    def travel(scene, friction, cohesion):
        contact = replace(scene.boundary, friction=0.2 + friction * along, cohesion=cohesion * (1 + along))
        return jnp.sum(mpm.advance(replace(scene, boundary=contact), state, 60).displacement[0] ** 2)

    check_run(travel, scene, (0.1, 5e3), (1e-6, 1e-1), 1e-4)


def test_a_contact_holds_at_each_node_by_the_strength_there():
    """A base that is smooth at every second node holds by half of the friction; alike numbers are as one number."""
    scene, state = layer(mpm.Interface(20.0, 8e3), 0.5)
    nodes = jnp.ones(scene.grid.nodes)
    same, _ = mpm.with_soil(scene, state, wall_friction=scene.boundary.friction * nodes, wall_cohesion=8e3 * nodes)
    one, each = (mpm.advance(given, state, 60).displacement for given in (scene, same))
    assert np.allclose(one, each, rtol=1e-5)
    every_second = (jnp.arange(scene.grid.nodes) // scene.grid.shape[1]) % 2
    speeds = []
    for friction in (0.4 * every_second, 0.2):
        contact, _ = mpm.with_soil(scene, state, wall_friction=friction, wall_cohesion=0.0)
        speeds.append(float(jnp.mean(mpm.advance(contact, state, 200).velocity[0])))
    assert speeds[0] == pytest.approx(speeds[1], rel=0.03)
    assert speeds[1] == pytest.approx((0.5 - 0.2) * 9.81 * 200 * float(scene.numerics.time_step), rel=0.01)
    with pytest.raises(ValueError, match=r"wall_cohesion has shape \(3,\): give a number or \(\d+,\)"):
        mpm.with_soil(scene, state, wall_cohesion=jnp.ones(3))


@pytest.mark.parametrize("opened", [1.5, 3.0])
def test_soil_that_has_opened_has_the_cohesion_of_its_base_and_no_more(opened):
    scene, state = layer(mpm.Interface(0.0, 8e3), 0.4)
    loose = replace(state, volume_ratio=opened * state.volume_ratio, stress=state.stress / opened)
    final = mpm.solve(scene, loose, t_end=0.3).raise_if_failed().state
    speed = float(np.average(final.velocity[0], weights=scene.particles.mass))
    held = 8e3 / (STIFF.unit_weight * HEIGHT / 9.81)
    assert speed / (float(scene.numerics.time_step) * int(final.step)) == pytest.approx(0.4 * 9.81 - held, rel=0.01)


@pytest.mark.parametrize(("friction", "cohesion"), [(0.0, 4e3), (0.2, 3e3)])
def test_a_block_on_a_plane_is_held_back_by_the_cohesion_under_it(friction, cohesion):
    tilt, length, height = math.radians(30.0), 3.0, 1.0
    soil = mpm.Soil(unit_weight=20e3, young=1e8, poisson=0.0)
    pull = (9.81 * math.sin(tilt), -9.81 * math.cos(tilt))
    scene, _ = mpm.block(
        (length, height), soil, replace(HALVES, cell=0.5, spacing=(0.25, 0.25)), domain=(8.0, 2.0), corner=(1.0, 0.0),
        gravity=pull, walls="friction", friction=friction, cohesion=cohesion, speed=2.0,
    )  # fmt: skip
    scene = replace(scene, boundary=replace(scene.boundary, walls=scene.boundary.walls[2:3]))
    held = friction * 9.81 * math.cos(tilt) + cohesion * 9.81 / (soil.unit_weight * height)
    result = mpm.solve(scene, mpm.at_rest(scene), t_end=1.0).raise_if_failed()
    displacement = float(jnp.mean(result.state.displacement[0]))
    assert np.isclose(displacement, 0.5 * (pull[0] - held), rtol=0.02)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("cell", [0.25, 0.125])
def test_a_block_at_the_edge_of_sliding_rests_and_beyond_it_slides_at_the_rate_of_coulombs_law(cell):
    """From the stress of a block that is glued down it would creep, the more the finer the cells, and slide too far."""
    tilt, t_end = math.radians(25.0), 1.0
    scene, glued = earthquakes.block(cell, 1e7, tilt=tilt)

    def travel(coefficient):
        on_it, _ = mpm.with_soil(scene, glued, wall_friction=coefficient)
        return float(jnp.mean(mpm.solve(on_it, mpm.at_rest(on_it), t_end=t_end).state.displacement[0]))

    assert abs(travel(1.0008 * math.tan(tilt))) < 1e-6
    exact = earthquakes.GRAVITY * (math.sin(tilt) - 0.45 * math.cos(tilt)) * t_end**2 / 2
    assert travel(0.45) == pytest.approx(exact, rel=0.01)


def test_a_layer_without_end_has_one_stress_at_rest_on_every_contact():
    """It draws on all of its contact alike, so that of a contact too weak no part slips before the others."""
    rough, smooth = (np.asarray(layer(mpm.Interface(each), 0.3)[1].stress) for each in (30.0, 10.0))
    np.testing.assert_array_equal(rough, smooth)


def test_strength_reduction_divides_that_of_the_base_too():
    scene, _ = layer(mpm.Interface(30.0, 10e3), 0.2)
    weaker = mpm.reduced(scene, 2.0)
    assert np.isclose(weaker.boundary.friction, math.tan(math.radians(30)) / 2)
    assert np.isclose(weaker.boundary.cohesion, 5e3)


def test_soil_slides_over_a_strong_base_as_over_a_fixed_one():
    surface, soil = [(0, 6), (6, 6), (10, 2), (18, 2)], mpm.FrictionalSoil(3e3, 20.0, young=1e7)
    displacements = []
    for interface in (None, mpm.Interface(60.0, 1e6)):
        scene, state = mpm.section(mpm.Section(surface, interface=interface), soil, HALVES)
        final = mpm.solve(mpm.reduced(scene, 2.0), state, t_end=1.5).raise_if_failed().state
        displacements.append(float(mpm.diagnostics.mean_displacement(scene, final)))
    assert displacements[0] > 0.2
    # Nodes that stick take from particles what those bring; nodes that are fixed leave it to them.
    assert np.isclose(*displacements, rtol=0.05)


def test_only_cohesion_and_water_map_the_area_of_soil_on_a_base():
    plain, rubbed, stuck = (layer(each, 0.2)[0] for each in (None, mpm.Interface(20.0), mpm.Interface(20.0, 1e3)))
    assert (plain.boundary.friction, plain.boundary.cohesion, plain.boundary.pressure) == (None, None, None)
    assert (rubbed.boundary.cohesion, rubbed.boundary.pressure, stuck.boundary.pressure) == (None, None, None)
    assert stuck.boundary.cohesion.shape == ()
    assert plain.boundary.softening is rubbed.boundary.softening is stuck.boundary.softening is None
    pressure = layer(mpm.Interface(20.0), 0.2, r_u=0.25)[0].boundary.pressure
    assert np.allclose(pressure, 0.25 * STIFF.unit_weight * HEIGHT)


def test_a_base_softens_in_the_program_only_if_asked():
    firm, soft = (layer(each, 0.2) for each in (mpm.Interface(20.0), SOFTENING["friction"][0]))
    assert len(jax.tree.leaves(soft[0])) == len(jax.tree.leaves(firm[0])) + 1
    assert count(program(*soft), "sqrt") == count(program(*firm), "sqrt") + 1


def test_a_base_that_softens_is_not_shaken():
    """Its slip is the displacement, which shaking takes back."""
    record = mpm.BaseMotion(jnp.stack([jnp.sin(jnp.linspace(0.0, 6.0, 200)), jnp.zeros(200)]), jnp.asarray(0.01))
    with pytest.raises(ValueError, match="motion of the base, with a contact that softens"):
        layer(SOFTENING["friction"][0], 0.0, motion=record)


REFUSED = [
    ({"interface": mpm.Interface(61.0)}, "the interface's friction = 61"),
    ({"interface": mpm.Interface(20.0, -1.0)}, "the interface's cohesion = -1 Pa"),
    ({"interface": mpm.Interface(20.0, residual_ratio=1.2, slip_length=1.0)}, "the interface's residual_ratio = 1.2"),
    ({"interface": mpm.Interface(20.0, residual_ratio=0.5, slip_length=0.0)}, "the interface's slip_length = 0 m"),
    ({"interface": mpm.Interface(20.0, residual_ratio=0.5)}, "residual_ratio = 0.5 and slip_length = None: give both"),
    ({"interface": mpm.Interface(20.0, slip_length=0.5)}, "residual_ratio = 1 and slip_length = 0.5: give both"),
]


@pytest.mark.parametrize(("given", "message"), REFUSED)
def test_strengths_that_no_contact_has_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        mpm.section(mpm.Section([(0, 4), (4, 4)], **given), STIFF, HALVES)
    with pytest.raises(ValueError, match="ends = 'free field' with an interface on the base"):
        mpm.section(mpm.Section([(0, 4), (4, 4)], interface=mpm.Interface(20.0)), STIFF, HALVES, ends="free field")
    with pytest.raises(ValueError, match="cohesion = 5 with walls = 'fixed'"):
        mpm.block((2, 2), STIFF, HALVES, domain=(4, 4), corner=(1, 0), walls="fixed", cohesion=5.0)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("cell", [2.0, 1.0])
def test_a_slab_of_softening_clay_stops_on_a_contact_of_its_strength_after_the_same_work_on_every_grid(cell):
    """Strength falls over a slip of 2 m, as in a band as thick as the softening length; on a fixed base half a cell
    would stick, and without softening the slab would stop after half of the way."""
    strength, residual, modulus, length, height, speed = 20e3, 0.5, 5e3, 1.0, 4.0, 2.5
    clay = mpm.Soil(
        unit_weight=20e3, young=2e8, poisson=0.49, strength=strength, tension_cutoff=0.0,
        softening_modulus=modulus, residual_ratio=residual, softening_length=length,
    )  # fmt: skip
    shape = mpm.Section([(0, height), (2 * cell, height)], interface=mpm.Interface(0.0, strength, softens=True))
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2, cell_average=True)
    scene, state = mpm.section(shape, clay, numerics, ends="tied", speed=2 * speed)
    moving = replace(state, velocity=state.velocity.at[0].set(speed))
    final = mpm.solve(scene, moving, t_end=2.0).raise_if_failed().state
    slip, energy = (1 - residual) * strength / modulus * length, 20e3 / 9.80665 * height * speed**2 / 2
    # Within the slip that softens: the work up to u is strength u - modulus u^2 / (2 length).
    exact = (strength - math.sqrt(strength**2 - 2 * modulus / length * energy)) / (modulus / length)
    assert exact < slip
    assert float(jnp.mean(final.displacement[0])) == pytest.approx(exact, rel=0.01)


def test_a_contact_softens_as_its_soil_only_where_undrained_soil_does():
    firm = mpm.Soil(unit_weight=20e3, young=2e7, poisson=0.49, strength=20e3, tension_cutoff=0.0)
    for soil, softens in (
        (firm, False),
        (STIFF, False),
        (replace(firm, softening_modulus=1e4, residual_ratio=0.5), True),
    ):
        programs = []
        for each in (False, True):
            shape = mpm.Section([(0, HEIGHT), (4, HEIGHT)], interface=mpm.Interface(5.0, 8e3, softens=each))
            programs.append(program(*mpm.section(shape, soil, HALVES, ends="tied", at_rest=False)))
        assert (programs[0] != programs[1]) == softens
    with pytest.raises(ValueError, match=r"softens = True with slip_length = 0\.5 m: let it soften as its soil"):
        mpm.Interface(20.0, residual_ratio=0.5, slip_length=0.5, softens=True).check()


def test_of_zones_the_softening_clay_alone_loses_strength_by_slip():
    moduli = {"bulk": jnp.asarray(1e7), "shear": jnp.asarray(5e6)}
    softening = mpm.laws.Softening(jnp.asarray(1e4), jnp.asarray(0.5))
    clay = mpm.laws.J2(**moduli, strength=jnp.asarray(20e3), softening=softening)
    firm = mpm.laws.Elastic(**moduli)
    strain = jnp.asarray([0.0, 0.5, 3.0])
    np.testing.assert_allclose(softened(mpm.laws.Zoned((firm, clay), (1, 2)), strain), [1.0, 0.75, 0.5], rtol=1e-6)
    assert softened(mpm.laws.Zoned((firm, firm), (1, 2)), strain) is None
    assert softened(firm, strain) is None


def test_slip_counts_over_the_thickness_of_bands():
    kernel, cell = HALVES.kernel.of_spacing((0.5, 0.5)), 0.5
    assert thickness_on(None, kernel, cell) == cell
    assert thickness_on(passes_for(2.0, kernel, cell), kernel, cell) == pytest.approx(band_thickness(2.0), rel=0.01)
