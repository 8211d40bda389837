"""What a scene does not need is not in its compiled program, its arguments or its state."""

import logging
import re
import subprocess
import sys
from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import equations, seepage
from jaxmpm.tensors import safe_sqrt
from tests import ROOT
from tests.scenes import tables

SHAPE = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
SOIL = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
FORGETS = replace(SOIL, gap_memory=False)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))


def section(soil=SOIL, at_rest=False, **numerics):
    return mpm.slope(SHAPE, soil, replace(NUMERICS, **numerics), at_rest=at_rest)


def program(scene, state):
    """The step as traced, with the transfers spelt out."""
    scene = replace(scene, numerics=replace(scene.numerics, engine=mpm.Engine.XLA))
    return jax.jit(mpm.step).lower(scene, state, scene.numerics.time_step).as_text()


def count(text, operation):
    assert "stablehlo.add " in text  # else the text is of another form, and every count would be 0
    return text.count(f"stablehlo.{operation} ")


def test_elastic_scene_has_no_return_mapping_and_no_history():
    scene, state = section(replace(SOIL, strength=None))
    assert state.history is None
    text = program(scene, state)
    assert count(text, "sqrt") == 0
    assert count(program(*section()), "sqrt") > 1


def test_without_softening_there_is_no_history_in_state_or_program():
    perfect, soft = section(replace(SOIL, softening_modulus=None)), section()
    assert perfect[1].history is None
    assert len(jax.tree.leaves(perfect[1])) == len(jax.tree.leaves(soft[1])) - 1
    assert count(program(*perfect), "divide") < count(program(*soft), "divide")


def test_without_tension_cutoff_nothing_limits_the_mean_stress():
    with_it, without = (program(*section(replace(FORGETS, tension_cutoff=cutoff))) for cutoff in (0.0, None))
    assert count(without, "minimum") == count(with_it, "minimum") - 1


def test_a_gap_is_absent_from_state_and_program_unless_the_cutoff_opens_one():
    remembers, forgets = section(), section(FORGETS)
    without = [section(replace(soil, tension_cutoff=None)) for soil in (SOIL, FORGETS)]
    assert forgets[1].gap is without[0][1].gap is None
    assert len(jax.tree.leaves(remembers)) == len(jax.tree.leaves(forgets)) + 1
    assert count(program(*remembers), "log_plus_one") == count(program(*forgets), "log_plus_one") + 1 == 1
    assert program(*without[0]) == program(*without[1])


def test_homogeneous_strength_and_softening_are_numbers():
    scene, state = section()
    assert scene.material.strength.shape == ()
    uneven = mpm.with_soil(scene, state, strength=jnp.full_like(scene.particles.mass, 9e3))[0]
    modulus = jnp.full_like(scene.particles.mass, 40e3)
    softer, _ = mpm.with_soil(scene, state, softening_modulus=modulus)
    arrays = f"tensor<{scene.particles.mass.size}xf32>"

    def arguments(scene):
        return next(line for line in program(scene, state).splitlines() if "@main" in line).split("->")[0].count(arrays)

    assert arguments(uneven) == arguments(softer) == arguments(scene) + 1
    assert scene.material.softening.modulus.shape == scene.material.softening.residual_ratio.shape == ()


@pytest.mark.parametrize(("name", "value"), [("damping", 0.5), ("flip", 0.9), ("pic_damping", 0.5)])
def test_damping_and_pic_are_absent_unless_asked_for(name, value):
    plain, asked = section(), section(**{name: value})
    assert getattr(plain[0].numerics, name) is None
    assert len(program(*plain)) < len(program(*asked))


def scatters(scene, state):
    count = program(scene, state).count('"stablehlo.scatter"(')
    assert count  # else the text is of another form, and every count below would be 0
    return count


def test_the_water_of_drained_soil_is_absent_from_state_and_program():
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.DruckerPrager)
    drained, sealed = section(sand), section(replace(sand, b_value=0.9))
    assert drained[1].history is None
    assert len(jax.tree.leaves(sealed)) == len(jax.tree.leaves(drained)) + 2  # the B-value, and the growth of volume
    assert count(program(*drained), "log_plus_one") == count(program(*sealed), "log_plus_one") - 1 == 0
    assert scatters(*drained) == scatters(*sealed) - 2  # the average of its pressure over a cell


@pytest.mark.parametrize(("choice", "times", "leaves"), [({"fbar": True}, 2, 0), ({"internal_length": 1.5}, 1, 1)])
def test_averages_over_neighbours_map_nothing_unless_asked_for(choice, times, leaves):
    # MUSL maps twice, F-bar the strain and the mean stress; averaged plastic strain goes with what is mapped anyway.
    plain, asked = section(), section(**choice)
    assert (plain[0].numerics.nonlocal_passes, plain[1].unaveraged) == (None, None)
    assert not plain[0].numerics.fbar
    assert scatters(*asked) == times * scatters(*plain)
    assert len(jax.tree.leaves(asked)) == len(jax.tree.leaves(plain)) + leaves


def test_xpic_maps_nothing_unless_asked_for():
    pic, xpic = section(flip=0.0), section(flip=0.0, xpic=3)
    assert pic[0].numerics.xpic == 1
    assert scatters(*xpic) == scatters(*pic) * 2  # MUSL maps twice, and each order above 1 once more
    assert len(jax.tree.leaves(pic)) == len(jax.tree.leaves(xpic))


def test_averages_over_cells_gather_nothing_unless_asked_for():
    # Of the strain; with friction of a gap; without of the stress that acts. Each adds up values and weights.
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.DruckerPrager)
    for soil, more in ((SOIL, 2), (sand, 1), (replace(sand, tension_cutoff=0.0), 2)):
        plain, asked = section(soil, cell_average=False), section(soil, cell_average=True)
        assert scatters(*asked) == scatters(*plain) + 2 * more
        assert len(jax.tree.leaves(asked)) == len(jax.tree.leaves(plain))


def test_affine_transfers_are_absent_from_state_and_program_unless_asked_for():
    splines = {"kernel": mpm.QuadraticBSpline, "flip": 0.0}
    plain, asked = section(**splines), section(**splines, apic=True)
    assert plain[1].affine is None
    assert len(jax.tree.leaves(asked[1])) == len(jax.tree.leaves(plain[1])) + 1
    assert len(program(*plain)) < len(program(*asked))


def test_a_loss_of_strength_over_time_is_absent_unless_given():
    perfect = replace(SOIL, softening_modulus=None)
    plain, lost = section(perfect), section(replace(perfect, loss_time=2.0))
    assert plain[0].material.loss is None
    assert len(jax.tree.leaves(lost)) == len(jax.tree.leaves(plain)) + 2
    assert count(program(*lost), "minimum") == count(program(*plain), "minimum") + 1


def test_rate_effect_viscosity_and_body_force_leave_no_operation_behind():
    scene, state = section()
    assert count(program(scene, state), "log") == 0
    assert count(program(*section(replace(SOIL, rate_coefficient=0.1))), "log") == 1
    thick = section(replace(SOIL, viscosity=1e3))
    assert scene.material.viscosity is None
    assert len(jax.tree.leaves(thick)) == len(jax.tree.leaves((scene, state))) + 1
    assert count(program(*thick), "divide") == count(program(scene, state), "divide") + 1
    assert scene.loads.body_force is None
    assert count(program(scene, state), "sine") == 0
    shaken = replace(scene, loads=replace(scene.loads, body_force=lambda x, t: jnp.zeros_like(x) + jnp.sin(t)))
    assert count(program(shaken, state), "sine") == 1


def test_water_is_absent_from_arguments_and_program_unless_given():
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.DruckerPrager)
    drawn = mpm.Section([(0, 6), (6, 6), (10, 2), (18, 2)])
    dry, table, carried = (
        mpm.section(drawn, sand, NUMERICS, at_rest=False, **water) for water in ({}, {"water": 3.0}, {"r_u": 0.2})
    )
    assert dry[0].loads.water is None
    assert dry[0].loads.pore_pressure is None
    leaves = [len(jax.tree.leaves(each)) for each in (dry, table, carried)]
    assert leaves == [leaves[0], leaves[0] + 4, leaves[0] + 1]
    text = program(*dry)
    for wet in (table, carried):
        assert len(program(*wet)) > len(text)
    # Clay has the same program as before there was water: no force but that of its stress and weight is mapped.
    assert scatters(*section()) == 6


class AtRest:
    """Heads of water at rest at 3 m."""

    def at(self, position):
        return 3.0 - np.asarray(position)[-1]


def test_rain_is_one_array_of_the_scene_that_rests_in_it_and_none_of_the_dry_one():
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.DruckerPrager)
    dry, state = mpm.section(mpm.Section([(0, 6), (6, 6), (10, 2), (18, 2)]), sand, NUMERICS, at_rest=False)
    wet = seepage.with_pressure(dry, AtRest(), retention=seepage.soil_class("loam"), dry_weight=15e3)
    assert dry.loads.pore_pressure is None
    assert len(jax.tree.leaves(wet)) == len(jax.tree.leaves(dry)) + 1
    text = program(dry, state)
    assert len(program(wet, state)) > len(text)
    # What rain has left behind is a number a particle: its program is that of any pore pressure.
    given = replace(dry, loads=replace(dry.loads, pore_pressure=jnp.ones_like(dry.particles.mass)))
    assert program(wet, state) == program(given, state)


DRY = """
[ground]
surface = [[0.0, 8.0], [6.0, 8.0], [14.0, 2.0], [22.0, 2.0]]
[soil]
unit_weight = 19e3
young = 2e7
poisson = 0.3
friction = 30.0
[soil.cohesion]
mean = 3e3
cov = 0.3
length = [10.0, 2.0]
"""
WITHOUT_RAIN = """
import sys
import jax
import jaxmpm as mpm
from cooperative import campaign, exports, reporting, runs
from cooperative.scene import parse
from cooperative.tools import safety

scene = parse(sys.argv[1])
soil = runs.random_soil(scene)
model = runs.build(scene, "rough", soil, at_rest=False)
safety.slices_at_rest(scene)
varied, state = mpm.with_soil(
    model.scene, mpm.unstressed(model.scene), **model.varied(runs.coefficients_of(scene, soil)[0])
)
text = jax.jit(mpm.step).lower(varied, state, varied.numerics.time_step).as_text()
rooms = "jaxmpm.seepage", "cooperative.scene._flow", "cooperative.tools.seepage", "cooperative.tools.in_time"
print("stablehlo.add " in text, [name for name in sys.modules if name.startswith(rooms)])
"""


def test_a_campaign_without_rain_imports_and_compiles_nothing_of_the_flow():
    """A process that has read, screened and traced it has no module of the flow, and so no operation of it."""
    command = [sys.executable, "-c", WITHOUT_RAIN, DRY + tables(1.0)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "True []"


def test_finite_strains_leave_no_operation_and_no_array_behind():
    plain, asked = section(FORGETS), section(FORGETS, finite_strain=True)
    assert not plain[0].numerics.finite_strain
    assert len(jax.tree.leaves(asked)) == len(jax.tree.leaves(plain))
    for operation in ("log_plus_one", "exponential_minus_one", "exponential"):
        assert count(program(*plain), operation) == 0
        assert count(program(*asked), operation) > 0


def stress_update(scene, state):
    """The compiled program that updates the stress."""

    def updated(scene, state, gradient):
        maps = equations.Maps(scene, equations.grid_position(scene, state))
        return equations.update_stress(scene, state, gradient, scene.numerics.time_step, maps)

    gradient = jnp.zeros((scene.grid.dimension,) * 2 + scene.particles.mass.shape)
    return jax.jit(updated).lower(scene, state, gradient).compile()


def longest_loop(program):
    """Operations of the longest loop of a program for CPUs: the largest computation that XLA fuses."""
    fused = re.findall(r"^%fused[^\n]*{\n(.*?)^}", program.as_text(), re.DOTALL | re.MULTILINE)
    assert fused  # else the text is of another form
    return max(part.count(" = ") for part in fused)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="looks at a program for CPU")
def test_finite_strains_do_not_join_the_components_of_a_costly_law_in_one_loop():
    # One loop for all of them is not vectorised: a step with Mohr-Coulomb took fifty times as long.
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.MohrCoulomb, tension_cutoff=None)
    numerics = mpm.Discretisation(1.0, (0.5,) * 3)
    plain, stretched = (
        longest_loop(stress_update(*mpm.column(4.0, sand, replace(numerics, finite_strain=finite), at_rest=False)))
        for finite in (False, True)
    )
    assert stretched <= plain


def in_layers(*soils, **numerics):
    bottoms = [[(0, 2), (6, 2)], None]
    layers = [mpm.Layer(soil, bottom) for soil, bottom in zip(soils, bottoms, strict=False)]
    return mpm.section(mpm.Section([(0, 4), (6, 4)]), layers, replace(NUMERICS, **numerics), at_rest=False)


def test_zones_are_absent_unless_layers_are_of_different_kinds():
    of_one_kind = in_layers(SOIL, replace(SOIL, strength=18e3))
    plain = mpm.section(mpm.Section([(0, 4), (6, 4)]), SOIL, NUMERICS, at_rest=False)
    same = mpm.with_soil(*plain, strength=of_one_kind[0].material.strength)[0]
    assert program(*of_one_kind) == program(same, plain[1])


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="looks at a program for CPU")
@pytest.mark.parametrize("finite", [False, True])
def test_a_zone_costs_its_own_particles_only(finite):
    sand = mpm.FrictionalSoil(5e3, 30.0, law=mpm.laws.MohrCoulomb, tension_cutoff=0.0)
    choices = {"finite_strain": finite, "cell_average": False}
    drawn, numerics = mpm.Section([(0, 4), (6, 4)]), replace(NUMERICS, **choices)
    alone = [mpm.section(drawn, soil, numerics, at_rest=False) for soil in (sand, SOIL)]
    dear, cheap, both = (stress_update(*each) for each in (*alone, in_layers(sand, SOIL, **choices)))
    flops = [program.cost_analysis()["flops"] for program in (cheap, both, dear)]
    assert flops[0] < flops[1] < 0.5 * (flops[0] + flops[2]) * 1.1
    assert longest_loop(both) < 1.1 * longest_loop(dear)


def test_motion_of_the_base_and_tied_sides_are_absent_unless_asked_for():
    drawn, sand = mpm.Section([(0, 4), (6, 4)]), replace(SOIL, strength=None)
    motion = mpm.BaseMotion(jnp.ones((2, 5)), jnp.asarray(0.1))
    still, shaken, tied = (
        mpm.section(drawn, sand, NUMERICS, at_rest=False, **given)
        for given in ({}, {"motion": motion}, {"ends": "tied"})
    )
    assert (still[0].loads.motion, still[0].boundary.tied) == (None, None)
    leaves = [len(jax.tree.leaves(each)) for each in (still, shaken, tied)]
    assert leaves == [leaves[0], leaves[0] + 2, leaves[0]]
    text = program(*still)
    assert (count(text, "dynamic_slice"), count(text, "remainder")) == (0, 0)
    assert count(program(*shaken), "dynamic_slice") == 1
    assert count(program(*tied), "remainder") > 0


def test_a_free_field_is_absent_unless_asked_for():
    drawn = mpm.Section([(0, 4), (6, 4)])
    walled, open_ = (
        mpm.section(drawn, replace(SOIL, strength=None), NUMERICS, ends=ends, at_rest=False)
        for ends in ("roller", "free field")
    )
    assert (walled[0].free_field, walled[1].free_field) == (None, None)
    text = program(*walled)
    assert count(text, "sqrt") == 0  # of the speed of waves, for the impedance of the ends
    assert count(program(*open_), "sqrt") > 1
    assert scatters(*walled) < scatters(*open_)


def test_walls_with_friction_leave_no_operation_behind():
    soil, sizes = replace(SOIL, strength=None), {"domain": (4, 4), "corner": (1, 0)}
    free, held, sliding = (
        mpm.block((2, 2), soil, NUMERICS, walls=walls, friction=friction, **sizes)
        for walls, friction in (("roller", 0.0), ("fixed", 0.0), ("friction", 0.3))
    )
    assert (held[0].boundary.friction, held[0].boundary.base, sliding[0].boundary.base) == (None, None, None)
    # The speed along each of four walls on which soil slides.
    assert [count(program(*each), "sqrt") for each in (free, held, sliding)] == [0, 0, 4]


def test_bedrock_is_no_argument_of_a_scene_on_a_level_base():
    level, rock = (
        mpm.section(mpm.Section([(0, 4), (6, 4)], -2.0, bedrock=bedrock, interface=mpm.Interface(20.0)), SOIL, NUMERICS)
        for bedrock in (None, [(0, 0), (6, -1)])
    )
    assert (level[0].boundary.base, level[0].boundary.cut) == (None, None)
    assert len(jax.tree.leaves(rock[0])) == len(jax.tree.leaves(level[0])) + 3


def test_parts_that_a_scene_lacks_are_those_that_it_was_never_given():
    scene, state = section()
    assert [part.name for part in fields(mpm.Scene)] == [
        "grid", "particles", "material", "numerics", "boundary", "loads", "free_field",
    ]  # fmt: skip
    bare = mpm.Scene(
        scene.grid,
        scene.particles,
        scene.material,
        mpm.Numerics(scene.numerics.time_step, scene.numerics.kernel),
        mpm.Boundary(scene.boundary.walls),
        mpm.Loads(scene.loads.gravity),
    )
    assert jax.tree.structure(bare) == jax.tree.structure(scene)
    assert program(bare, state) == program(scene, state)
    leaves = len(jax.tree.leaves((scene.particles, scene.material)))
    assert len(jax.tree.leaves(scene)) == leaves + 2  # time step and gravity


def test_columns_leave_nothing_in_state_or_program_unless_asked_for():
    scene, state = section()
    assert state.columns is None
    looked = mpm.with_columns(scene, state)
    assert len(jax.tree.leaves(looked)) == len(jax.tree.leaves(state)) + 3

    def run(state):
        on_xla = replace(scene, numerics=replace(scene.numerics, engine=mpm.Engine.XLA))
        return jax.jit(lambda s: mpm.advance(on_xla, s, jnp.asarray(4))).lower(state)

    plain, asked = run(state).as_text(), run(looked).as_text()
    assert plain.count('"stablehlo.case"(') == 0
    assert asked.count('"stablehlo.case"(') == 1
    counts = [text.count('"stablehlo.scatter"(') for text in (plain, asked)]
    # Sums of volume, mass and two components of momentum, and the first particle of each column.
    assert counts[1] == counts[0] + 5
    # The step itself is the same, whoever looks at what it made.
    assert program(scene, looked).count("stablehlo.") == program(scene, state).count("stablehlo.")


def test_section_carries_no_out_of_plane_shear():
    for d, components in ((1, 3), (2, 4), (3, 6)):
        _, state = mpm.column(4.0, SOIL, mpm.Discretisation(1.0, (0.5,) * d), at_rest=False)
        assert state.stress.shape[0] == components


def test_single_mapping_schemes_map_once():
    # MUSL maps particles to the grid twice in a step, USL once; a map is one scatter for each layer of the stencil.
    assert scatters(*section(scheme=mpm.Scheme.USL)) == 3
    assert scatters(*section()) == 6


def test_walls_cost_no_memory():
    scene, state = section()
    nodes = scene.grid.nodes
    # Held components come from index arithmetic: no constant of the grid's size is stored.
    assert 'dense<"0x' not in program(scene, state)
    assert all(leaf.size != nodes for leaf in jax.tree.leaves(scene))


def test_grid_spans_what_particles_can_reach():
    numerics = mpm.Discretisation(2.0, (1.0, 2.0, 1.0))
    scene, _ = mpm.slope(mpm.Slope(width=96.0), mpm.Soil(), numerics, at_rest=False)
    # 96 m of cells, one beyond each wall; above the crest one cell and the stencil's reach.
    assert scene.grid.shape == (51, 51, 12)


def test_second_sample_compiles_nothing(caplog):
    scene, state = section(at_rest=True)
    strengths = [jnp.full_like(scene.particles.mass, 9e3 + 100 * i) for i in range(3)]
    run = mpm.solve_each(scene, state, {"strength": strengths}, width=1, t_end=0.2)
    next(run)
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        # The first refill compiles the refill itself; after it everything is there.
        next(run)
        caplog.clear()
        next(run)
    assert not [record for record in caplog.records if "Compiling" in record.getMessage()]


def test_many_samples_end_the_same_whatever_the_width():
    scene, state = section(at_rest=True)
    results = []
    for width in (1, 3):
        varied = {"strength": (9e3 * (0.5 + 0.25 * i) for i in range(5))}
        each = mpm.solve_each(scene, state, varied, width=width, t_end=0.4)
        results.append({number: result.state.displacement for number, result in each})
    assert sorted(results[0]) == list(range(5))
    assert all((results[0][number] == results[1][number]).all() for number in results[0])
    with pytest.raises(ValueError, match="width = 0: give a whole number of 1 or more"):
        next(mpm.solve_each(scene, state, {"strength": []}, width=0, t_end=1.0))


def test_a_root_is_computed_once_for_all_its_uses():
    # XLA duplicates a selection into every use with all that its condition needs, a root never.
    operations = jax.make_jaxpr(safe_sqrt.__wrapped__)(jnp.ones(3)).eqns
    assert operations[-1].primitive.name == "sqrt"
    assert float(jax.grad(safe_sqrt)(0.0)) == 0
    assert float(safe_sqrt(jnp.asarray(-1e-30))) == 0
