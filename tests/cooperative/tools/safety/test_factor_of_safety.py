"""The factor of safety of a scene: slices with the strength of the particles, and the command."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import jaxmpm as mpm
from cooperative.__main__ import main
from cooperative.example_scenes import example
from cooperative.runs import coefficients_of
from cooperative.scene import failing_volume, parse
from cooperative.tools import safety
from cooperative.tools.safety import _factor, _pictures
from jaxmpm.run import FactorOfSafety
from tests.scenes import model_of, tables

CUT = f"""
name = "cut in two clays"
[ground]
surface = [[0, 12], [20, 12], [36, 4], [60, 4]]
[water]
level = 5.0
[[layer]]
name = "crust"
depth = 3.0
unit_weight = 19e3
young = 1e8
poisson = 0.3
cohesion = 4e3
friction = 30.0
[[layer]]
name = "clay"
bottom = [[0, 1], [60, 1]]
unit_weight = 18e3
young = 5e7
poisson = 0.3
[layer.strength]
mean = 22e3
cov = 0.3
trend = 1.5e3
trend_from = 12.0
length = [30.0, 3.0]
[[layer]]
name = "rock"
rock = true
unit_weight = 24e3
young = 2e8
poisson = 0.25
{tables(run="")}"""


def test_slices_have_the_strength_of_the_particles():
    model = model_of(CUT, "refined")
    coefficients = coefficients_of(model.campaign, model.soil)[2]
    scene = _factor._with_soil(model, coefficients)
    clay = model.layer == 1
    x, z = np.asarray(scene.particles.position, float)[:, clay]
    cohesion, friction = _factor._strength(model, scene)(x, z, np.full(x.size, 1))
    assert np.allclose(cohesion, np.asarray(model.strength(coefficients))[clay], rtol=1e-5)
    assert not friction.any()


def test_a_raised_pool_carries_and_an_earthquake_drives(monkeypatch):
    circle = safety.Circle(30.0, 22.0, 20.0)

    def of_one_circle(slices):
        slip = slices.slip(circle)
        return safety.Critical(slip, slip, 1)

    monkeypatch.setattr(_factor, "critical_surface", of_one_circle)
    campaign = parse(CUT)
    given = {"plain": {}, "water": {"water": 2.0}, "k_h": {"k_h": 0.1}, "back": {"k_h": -0.1}}
    answers = {name: safety.factor_of_safety(campaign, solver=False, **loads) for name, loads in given.items()}
    factors = {name: answer.equilibrium.slip.factor for name, answer in answers.items()}
    assert factors["k_h"] < factors["plain"] < min(factors["back"], factors["water"])
    assert answers["water"].loads == ("water +2 m",)


def test_no_surface_enters_rock():
    slices = safety.Slices.of(campaign_section(), parse(CUT).site.soils(None), water=5.0, rock=[2])
    slip = slices.slip(safety.Circle(30.0, 22.0, 24.0))
    assert np.isclose(slip.points[:, 1].min(), 1.0)


def campaign_section():
    return parse(CUT).site.shape


def test_the_command_prints_both_factors_and_why_they_differ(tmp_path, monkeypatch, capsys):
    scene = tmp_path / "demo.toml"
    scene.write_text(example("demo"))

    def canned(campaign, scene, state, *, bracket, progress):
        progress([0.5, 3.0], [0.01, 12.0])
        return FactorOfSafety(1.19, 1.20, ((1.19, 0.1), (1.2, 2.0)), 1.195, 4.0, 61.0, (1.05, 3.0))

    monkeypatch.setattr(_factor, "limit_load_factor", canned)
    monkeypatch.setattr(_factor.jaxmpm, "solve", lambda scene, state, **_: replace(state_of(state), state=state))
    assert main(["fos", str(scene), "--grid", "rough"]) == 0
    printed, progress = capsys.readouterr()
    assert "displacement at R = 0.5: 0.01 m, 3: 12 m" in progress
    assert "limit equilibrium  1.09" in printed
    assert "solver             1.195  limit load, rough grid, cells of 2 m; stands at R = 1.19" in printed
    assert "61 m2 moves there, and 4 times as fast with R as below" in printed
    assert "displacement grows 4 times as fast beyond the limit load as below, no sharp limit" in printed
    assert "a slip of 3 m2 moves at R = 1.05 already; it is smaller than the 7.2 m2 that is a failure" in printed
    assert "what slides in limit equilibrium is 6.6 cells deep, and coarse cells resist" in printed
    content = json.loads((tmp_path / "demo-fos" / "fos.json").read_text())
    assert content["solver"]["kink"] == 1.195
    assert 0.05 < content["difference"] < 0.15
    assert (tmp_path / "demo-fos" / "fos.png").stat().st_size > 10_000


def test_a_wall_that_what_moves_reaches_is_named():
    model = model_of(CUT, "rough")
    scene, state = model.scene, mpm.unstressed(model.scene)
    x = np.asarray(scene.particles.position[0])

    def held(moves):
        displacement = np.zeros(state.displacement.shape, np.float32)
        displacement[0, moves] = 1.0
        return list(_factor._held(model, scene, replace(state, displacement=jnp.asarray(displacement))))

    assert held((x > 10) & (x < 50)) == []
    [one], [other] = held(x < 30), held(x > 30)
    assert "what moves reaches x = 0 m, where no surface of limit equilibrium ends" in one
    assert "what moves reaches x = 60 m" in other
    assert held(np.zeros(x.size, bool)) == []


@pytest.mark.parametrize(("share", "higher", "named"), [(0.99, True, True), (1.01, True, False), (0.99, False, False)])
def test_a_slip_smaller_than_a_failure_is_why_the_solver_stands_longer(share, higher, named):
    model = model_of(CUT, "rough")
    result = safety.factor_of_safety(model.campaign, solver=False)
    slip = replace(result.equilibrium.slip, area=share * failing_volume(model.campaign))
    result = replace(result, equilibrium=replace(result.equilibrium, slip=slip))
    reasons = " ".join(_factor._causes(result, model, higher=higher))
    assert ("give least_volume" in reasons) == named


def test_the_title_of_a_picture_has_room(monkeypatch, tmp_path):
    shape = mpm.Slope(crest=12.0, height=12.0, run_per_rise=2.0, toe=16.0, foundation=4.0)
    failing = mpm.slope(
        shape, mpm.Soil(20e3, strength=25e3, tension_cutoff=0.0), mpm.Discretisation(4.0, (2.0, 2.0)), at_rest=False
    )
    solver = FactorOfSafety(1.19, 1.20, ((1.19, 0.1),), 1.195, 12.0)
    result = safety.Safety("median soil", (), "rough grid", solver=solver, failing=failing)
    drawn = []
    monkeypatch.setattr(_pictures, "save", lambda figure, path: drawn.append(figure))
    safety.draw_safety(result, SimpleNamespace(site=SimpleNamespace(shape=shape)), tmp_path / "fos.png")
    [figure] = drawn
    FigureCanvasAgg(figure).draw()
    with_title = figure.axes[0].get_tightbbox()
    assert with_title.y1 <= figure.bbox.height
    assert with_title.x0 >= 0


def state_of(state):
    from jaxmpm.run import Result

    return Result(state, 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--water", "+1"], r"the scene has no \[water\], so none can be raised: draw a \[slope\] as \[ground\]"),
        (["--k-h", "1.5"], "k_h = 1.5: give a value above -1 and below 1"),
        (["--sample", "40"], "sample = 40: the scene has samples 0 to 39"),
    ],
)
def test_what_the_scene_has_not_is_named(arguments, message, tmp_path, capsys):
    scene = tmp_path / "demo.toml"
    scene.write_text(example("demo"))
    assert main(["fos", str(scene), "--quick", *arguments]) == 2
    assert re.search(message, capsys.readouterr().err)


CERTAIN = """
name = "certain"
[ground]
surface = [[0, 12], [30, 12], [54, 4], [80, 4]]
[[layer]]
name = "fill"
bottom = [[0, 4], [80, 2]]
unit_weight = 19e3
young = 2e7
poisson = 0.3
cohesion = 8e3
friction = 28
[[layer]]
name = "seam"
thickness = 0.2
unit_weight = 19e3
young = 2e7
poisson = 0.3
cohesion = 1e3
friction = 10
[[layer]]
name = "below"
unit_weight = 19e3
young = 2e7
poisson = 0.3
cohesion = 8e3
friction = 28
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[campaign]
samples = 10
"""
"""Nothing varies, and a layer is thinner than a particle."""


def test_slices_need_neither_a_grid_nor_anything_random(tmp_path, capsys):
    scene = tmp_path / "certain.toml"
    scene.write_text(CERTAIN)
    assert main(["fos", str(scene), "--quick"]) == 0
    assert "Spencer's method, a surface of another shape" in capsys.readouterr().out
    assert json.loads((tmp_path / "certain-fos" / "fos.json").read_text())["limit_equilibrium"]["method"] == "spencer"
    with pytest.warns(UserWarning, match="layer 'seam', 0.2 m thick, is weak and thin for the cells of"):
        assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "nothing in the scene is random" in capsys.readouterr().err


def test_a_scene_that_is_refused_leaves_no_folder(tmp_path, capsys):
    scene = tmp_path / "certain.toml"
    scene.write_text(CERTAIN)
    assert main(["fos", str(scene), "--quick", "--sample", "0"]) == 2
    assert "sample = 0 is given, and nothing in the scene is random: leave it out" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [scene]


def test_the_solver_says_which_layer_it_has_no_cells_for():
    result = safety.factor_of_safety(parse(CERTAIN))
    assert result.equilibrium.slip.factor < result.equilibrium.circle.factor
    assert re.search("the solver gives no factor of safety: .*seam.* 0.2 m thick", result.notes[0])


def test_median_soil_is_that_of_the_particles():
    model = model_of(CUT, "refined")
    layers, _, strength = _factor._median(model.campaign)
    particles = _factor._strength(model, _factor._with_soil(model, None))
    rng = np.random.default_rng(1)
    clay = model.layer == 1
    x, z = np.asarray(model.scene.particles.position, float)[:, rng.choice(np.flatnonzero(clay), 50)]
    number = np.full(x.size, 1)
    assert np.allclose(strength(x, z, number)[0], particles(x, z, number)[0], rtol=1e-4)
    assert [each.soil.unit_weight for each in layers] == [19e3, 18e3, 24e3]


def test_the_limit_load_stands_with_its_bracket():
    solver = FactorOfSafety(1.19, 1.2, ((1.19, 0.1), (1.2, 2.0)), 1.195, 12.0)
    [line] = safety.lines_of_solver(safety.Safety("median soil", (), "rough grid", solver=solver))
    assert "stands at R = 1.19, fails at R = 1.2" in line
