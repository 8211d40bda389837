"""Earthquakes, ends without walls, finite strains and random saturated weight in scenes."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxmpm as mpm
from cooperative import runs
from cooperative.scene import built, parse, read, read_scene
from jaxmpm.soil import STANDARD_GRAVITY
from tests.scenes import model_of, tables

HEIGHT, WEIGHT, STRENGTH = 6.0, 20e3, 12e3
LEVEL = f"""
[ground]
surface = [[0.0, {HEIGHT}], [2.0, {HEIGHT}]]
ends = "tied"
[soil]
unit_weight = {WEIGHT}
young = 2e7
poisson = 0.45
[strength]
mean = {STRENGTH}
cov = 0.1
length = [inf, inf]
"""
SCENE = LEVEL + tables(1.0)
RECORD = "time,x,z\n" + "\n".join(f"{0.01 * k:.2f},{0.2 * np.sin(k / 8):.6f},{0.05 * (k % 2)}" for k in range(101))
MOTION = '[motion]\nrecord = "record.csv"\nrecord_unit = "g"\nscale = 0.5\n'


def shaken(folder, record=RECORD, motion=MOTION, scene=SCENE):
    (folder / "record.csv").write_text(record)
    (folder / "shaken.toml").write_text(scene + motion)
    return folder / "shaken.toml"


def program(scene, state):
    scene = replace(scene, numerics=replace(scene.numerics, engine=mpm.Engine.XLA))
    return jax.jit(mpm.step).lower(scene, state, scene.numerics.time_step).as_text()


def test_level_ground_slides_on_its_base_from_the_coefficient_of_the_closed_form():
    # The shear stress at depth z is k_h times the weight above; the lowest particles are half a spacing above the base.
    critical = STRENGTH / (WEIGHT * (HEIGHT - 0.125))
    displacements = []
    for k_h in (0.95 * critical, 1.05 * critical):
        scene, state = model_of(LEVEL + tables(1.0, f"t_end = 6.0\nk_h = {k_h}"), "refined", at_rest=True).median
        scene = mpm.with_soil(scene, state, strength=STRENGTH)[0]
        displacements.append(float(mpm.diagnostics.largest_displacement(mpm.solve(scene, state, t_end=6.0).state)))
    assert displacements[0] < 0.1
    assert displacements[1] > 0.5


def test_k_h_and_k_v_are_those_of_the_solver_and_leave_the_consolidated_strength():
    coefficients = {"k_h": 0.1, "k_v": -0.05}
    campaign = parse(SCENE.replace("t_end = 4.0", "t_end = 4.0\nk_h = 0.1\nk_v = -0.05"))
    scene, state = built(campaign, "rough")
    shape = mpm.Section(((0.0, HEIGHT), (2.0, HEIGHT)))
    own, start = mpm.section(shape, campaign.soil, campaign.grids["rough"], ends="tied", **coefficients)
    np.testing.assert_array_equal(scene.loads.gravity, own.loads.gravity)
    np.testing.assert_array_equal(state.stress, start.stress)
    slope = mpm.Slope(crest=4, height=4, run_per_rise=1.0, toe=8, foundation=2)
    scene, _ = mpm.slope(slope, campaign.soil, campaign.grids["rough"], at_rest=False, **coefficients)
    np.testing.assert_allclose(scene.loads.gravity, [0.981, -1.05 * 9.81], rtol=1e-6)
    ratio = "strength_ratio = 0.25\nstrength_minimum = 2e3\n[water]\nlevel = 4.0\n[soil.young]\nmean = 2e7\n"
    consolidated = SCENE.replace("young = 2e7\n", "").replace(
        SCENE[SCENE.index("[strength]") : SCENE.index("cov")], ratio
    )
    lifted = consolidated.replace("t_end = 4.0", "t_end = 4.0\nk_v = 0.5")
    strengths = [
        runs.build(campaign, "rough", runs.random_soil(campaign), at_rest=False).strength()
        for campaign in map(parse, (consolidated, lifted))
    ]
    np.testing.assert_array_equal(*strengths)


def test_a_record_gives_the_numbers_of_the_solver_and_goes_with_the_scene(tmp_path):
    source = read_scene(shaken(tmp_path))
    (tmp_path / "record.csv").unlink()
    campaign = parse(source)
    (tmp_path / "again.csv").write_text(RECORD)
    motion = mpm.read_motion(tmp_path / "again.csv", scale=0.5 * STANDARD_GRAVITY)
    np.testing.assert_allclose(campaign.shaking.acceleration, motion.acceleration, rtol=1e-6)
    shape = mpm.Section(((0.0, HEIGHT), (2.0, HEIGHT)))
    own = mpm.section(shape, campaign.soil, campaign.grids["rough"], ends="tied", motion=campaign.shaking)
    ends = [mpm.advance(*each, 60) for each in (built(campaign, "rough"), own)]
    np.testing.assert_array_equal(ends[0].displacement, ends[1].displacement)
    assert np.abs(ends[0].displacement[0]).max() > 1e-4
    assert read(campaign).shaking.acceleration.shape == (2, 101)  # as a folder keeps one that was written in Python


@pytest.mark.parametrize(("unit", "factor"), [("g", STANDARD_GRAVITY), ("cm/s2", 0.01), ("m/s2", 1.0)])
def test_the_unit_that_a_record_states_is_that_of_the_scene(unit, factor, tmp_path):
    headed = RECORD.replace("time,x,z", f"Time (s),ax [{unit}],az [{unit}]")
    usual = SCENE.replace("[soil]", "[soil]\nunusual = true")
    read = parse(shaken(tmp_path, headed, MOTION.replace('"g"', f'"{unit}"'), usual)).shaking
    assert np.isclose(np.abs(read.acceleration[0]).max(), 0.5 * 0.2 * factor, rtol=1e-3)
    other = "cm/s2" if unit == "g" else "g"
    with pytest.raises(ValueError, match=f"has its x in {unit}, and {other} is asked for"):
        read_scene(shaken(tmp_path, headed, MOTION.replace('"g"', f'"{other}"')))


def test_no_run_settles_before_its_record_ends(tmp_path):
    quiet = "time,x\n" + "\n".join(f"{0.1 * k:.1f},{0.3 * (k > 30)}" for k in range(36))
    model = model_of(shaken(tmp_path, quiet), at_rest=True)
    scene, state = model.median
    for shaking, most in ((scene, 4.0), (replace(scene, loads=replace(scene.loads, motion=None)), 2.0)):
        end = mpm.solve(shaking, state, t_end=4.0, rules=[mpm.Settle()]).state
        assert most - 1.0 < int(end.step) * float(scene.numerics.time_step) < most + 0.1
    varied = {"strength": [model.strength()]}
    ((_, result),) = mpm.solve_each(scene, state, varied, width=1, t_end=4.0, rules=[mpm.Settle()])
    assert int(result.state.step) * float(result.time_step) > 3.5


def test_what_a_scene_does_not_ask_for_is_absent_from_its_program(tmp_path):
    plain = built(parse(SCENE), "rough", at_rest=False)
    zero = built(parse(SCENE.replace("t_end = 4.0", "t_end = 4.0\nk_h = 0.0")), "rough", at_rest=False)
    assert plain[0].loads.motion is plain[0].free_field is None
    assert program(*plain) == program(*zero)
    moving = built(parse(shaken(tmp_path)), "rough", at_rest=False)
    finite = built(parse(SCENE.replace("cell = 1.0", "cell = 1.0\nfinite_strain = true")), "rough", at_rest=False)
    for more in (moving, finite):
        assert len(program(*more)) > len(program(*plain))


def test_a_free_field_replaces_the_walls_and_refuses_a_random_weight():
    ends = SCENE.replace('"tied"', '"free field"').replace("[2.0,", "[6.0,")
    model = model_of(ends, at_rest=True)
    assert [wall.axis for wall in model.scene.boundary.walls] == [1]
    assert np.abs(model.scene.free_field.reaction).max() > 1e3
    assert model.state.free_field[0].stress.shape[1] == 2 * 12
    heavy = ends.replace(f"unit_weight = {WEIGHT}\n", "")
    heavy += "[soil.unit_weight]\nmean = 20e3\ncov = 0.05\nlength = [10.0, 2.0]\n"
    with pytest.raises(ValueError, match="unit_weight varies beside ends = 'free field'"):
        parse(heavy)


def test_saturated_weight_varies_below_the_water_table_alone():
    sand = SCENE[: SCENE.index("[strength]")] + "cohesion = 5e3\nfriction = 30.0\n[water]\nlevel = 3.0\n"
    sand += "[soil.saturated_unit_weight]\nmean = 21e3\ncov = 0.05\nlength = [10.0, 2.0]\n"
    model = model_of(sand + SCENE[SCENE.index("[rough]") :], at_rest=True)
    coefficients = runs.coefficients_of(model.campaign, model.soil)[0]
    scene, state = model.of_sample(coefficients)
    weight = np.asarray(scene.particles.mass / scene.particles.volume * STANDARD_GRAVITY)
    wet = np.asarray(scene.particles.position[1]) < 3.0
    np.testing.assert_allclose(weight[~wet], WEIGHT, rtol=1e-6)
    np.testing.assert_allclose(weight[wet], model.parameters(coefficients)["saturated_unit_weight"][wet], rtol=1e-6)
    assert np.std(weight[wet]) > 100
    mean = built(model.campaign, "rough", at_rest=False)[0]
    np.testing.assert_array_equal(np.asarray(mpm.ground.wet(mean)), wet)
    assert not np.array_equal(np.asarray(state.stress), np.asarray(model.state.stress))


@pytest.mark.parametrize(
    ("record", "motion", "message"),
    [
        ("time,x\n0,1\n", MOTION, r"record.csv has 1 rows of numbers: give two or more"),
        (
            RECORD.replace("0.05,", "0.05,nan,", 1).replace("nan,0", "nan#0"),
            MOTION,
            "line 7: x = 'nan#0.*': give a finite",
        ),
        (
            RECORD,
            MOTION.replace('"g"', '"m/s2"'),
            r"reaches 0\.2 m/s2 by record_unit = 'm/s2', .* was another unit meant",
        ),
        (RECORD, MOTION.replace('"g"', '"gal"'), r"\[motion\] record_unit = 'gal': give one of 'm/s2', 'cm/s2', 'g'"),
        (RECORD, MOTION.replace("record.csv", "records.csv"), r"\[motion\] record: .*records\.csv"),
        (RECORD.replace("x,z", "y,z"), MOTION, "has a column y, along which a section does not move"),
        ("time,x\n0,0\n1,0\n", MOTION, "has no acceleration but 0"),
        ("time,x\n0,0\n9,0.3\n", MOTION, r"lasts 9 s, beyond t_end = 4 s .*: give t_end = 9 or more"),
        (RECORD, MOTION.replace("scale = 0.5", "scale = -1"), r"\[motion\] scale = -1: give a finite value above 0"),
    ],
)
def test_records_that_no_scene_can_have_are_refused(record, motion, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        parse(shaken(tmp_path, record, motion))


def test_a_damaged_packed_record_is_named(tmp_path):
    source = read_scene(shaken(tmp_path))
    packed = source.beside["files"]["record.csv"]
    for damage in ({"samples": 90}, {"acceleration": "!"}, {"interval": -1.0}):
        beside = {"files": {"record.csv": packed | damage}}
        with pytest.raises(ValueError, match=r"files 'record\.csv' is damaged"):
            parse(replace(source, beside=beside))


def test_a_strength_factor_multiplies_all_strength_once():
    halved = SCENE.replace("t_end = 4.0", "t_end = 4.0\nstrength_factor = 0.5")
    sand = halved[: halved.index("[strength]")] + "friction = 30.0\n[soil.cohesion]\nmean = 5e3\ncov = 0.1\n"
    sand += "length = [10.0, 2.0]\n" + halved[halved.index("[rough]") :]
    for text in (halved, sand):
        models = [
            runs.build(campaign, "rough", runs.random_soil(campaign), at_rest=False)
            for campaign in map(parse, (text, text.replace("factor = 0.5", "factor = 1.0")))
        ]
        coefficients = runs.coefficients_of(models[0].campaign, models[0].soil)[0]
        weak, full = (model.of_sample(coefficients)[0].material for model in models)
        # A calibration multiplies what the factor left, once.
        calibrated = models[0].with_strength_factor(0.25).of_sample(coefficients)[0].material
        name = "strength" if text is halved else "cohesion"
        for law, factor in ((weak, 0.5), (calibrated, 0.25)):
            np.testing.assert_allclose(getattr(law, name), factor * np.asarray(getattr(full, name)), rtol=1e-6)
            if text is sand:
                np.testing.assert_allclose(np.tan(law.friction), factor * np.tan(full.friction), rtol=1e-5)
