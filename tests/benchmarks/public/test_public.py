"""Comparisons with public answers: what is compared with what. The answers themselves stand outside the project."""

import importlib
import json
import math
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxmpm as mpm
from benchmarks import results
from benchmarks.__main__ import main
from benchmarks.measure import Refused
from benchmarks.public import dam_breaks, elastic, public, rows, slopes
from benchmarks.public.rows import row, without_answer
from jaxmpm.run._limit_load import find_kink, limit_load_scene


def test_data_are_named_by_the_command_or_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv(public.VARIABLE, raising=False)
    with pytest.raises(ValueError, match="give --data FOLDER or set JAXMPM_PUBLIC"):
        public.folder(None)
    with pytest.raises(Refused, match="none is no folder: give the one that holds one folder a case"):
        public.folder(tmp_path / "none")
    monkeypatch.setenv(public.VARIABLE, str(tmp_path))
    assert public.folder(None) == tmp_path


def test_a_command_that_asks_for_what_is_not_there_is_refused_in_a_line(tmp_path, monkeypatch, capsys):
    asked = {
        "cbgeo": "cases.json of the case cbgeo is missing: docs/notes/verification.md names its source",
        "zz": "--only zz: no case begins so, give beginnings of cantilever 0.25",
    }
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    for case, message in asked.items():
        monkeypatch.setattr(sys, "argv", ["benchmarks", "public", "--data", str(tmp_path), "--only", case])
        with pytest.raises(SystemExit):
            main()
        assert message in capsys.readouterr().err


def test_a_benchmark_without_data_of_others_refuses_them(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmarks", "size", "--data", "somewhere"])
    with pytest.raises(SystemExit):
        main()
    assert "size takes no --data: leave it out" in capsys.readouterr().err


def test_a_change_of_one_family_leaves_the_rows_of_others(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    for name in ("still", "changed"):
        (tmp_path / f"{name}.py").write_text(f"made = 0\n{FAMILY}")
    monkeypatch.syspath_prepend(tmp_path)
    families = {name: importlib.import_module(name) for name in ("still", "changed")}
    monkeypatch.setattr(public, "FAMILIES", {name: module.cases for name, module in families.items()})
    list(public.rows(tmp_path, quick=False))
    (tmp_path / "changed.py").write_text(f"made = 0  # otherwise\n{FAMILY}")
    assert [row["ours"] for row in public.rows(tmp_path, quick=False)] == [1.0, 2.0]
    assert [row["case"] for row in public.rows(tmp_path, quick=False, only=["still"])] == ["still", "changed"]


FAMILY = """
from benchmarks.public.rows import row
from jaxmpm.run._limit_load import find_kink, limit_load_scene
def cases(data, quick):
    return {__name__: make}
def make():
    global made
    made += 1
    return [row(__name__, "q", float(made), 1.0, 0.0)]
"""
"""A family of one case, whose answer counts how often it was made."""


def test_rows_of_cases_that_are_left_out_are_those_kept_before(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    (tmp_path / "one.py").write_text(f"made = 0\n{FAMILY}")
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module("one").cases

    def both(data, quick):
        return one(data, quick) | {f"one {kind}": lambda: [] for kind in ("kept", "new")}

    monkeypatch.setattr(public, "FAMILIES", {"one": lambda *given: both(*given)})
    monkeypatch.setattr(public, "stored", lambda family: rows.stored(one))
    earlier = {"name": "one kept", **row("c", "q", 7.0, 1.0, 0.0), "day": "2020-02-02"}
    new = {"name": "one new", **without_answer("one new"), "day": None}
    (tmp_path / "public.json").write_text(json.dumps({"rows": [earlier, new]}))
    monkeypatch.setattr(public, "beginning_so", lambda made, only: {"one": made["one"]})
    found = list(public.rows(tmp_path, quick=False))
    assert [(each["name"], each["ours"], each["quantity"]) for each in found] == [
        ("one", 1.0, "q"),
        ("one kept", 7.0, "q"),
        ("one new", None, "not run"),
    ]
    assert len({tuple(each) for each in found}) == 1  # one table
    assert found[0]["day"] > found[1]["day"]
    assert [each["quantity"] for each in public.rows(tmp_path, quick=True)][1:] == ["not run"] * 2


def test_figures_are_of_the_finest_rows_that_name_them():
    rows = [
        row("a", "q", 1.1, 1.0, 0.0, figure="exact_error_max", finest=False),
        row("a", "q", 0.98, 1.0, 0.0, figure="exact_error_max", finest=True),
        row("b", "q", 0.94, 0.95, 0.0, figure="reliability_coverage_min", finest=True),
    ]
    rows = [{"name": name, **row, "day": "2020-02-02"} for name, row in zip("aab", rows, strict=True)]
    values = public.summarised(rows)
    assert values["exact_error_max"] == pytest.approx(0.02)
    assert values["reliability_coverage_min"] == 0.94
    assert values["bui_front_error"] is None
    lacking = {"name": "cbgeo bars", **without_answer("cbgeo bars"), "day": None}
    assert public.summarised([*rows, lacking]) == values | {"exact_error_max": None}


@given(st.floats(0.1, 100.0), st.floats(0.0, 35.0), st.floats(0.0, 1.0), st.floats(0.5, 20.0))
def test_mangeneys_fan_holds_the_volume_that_has_left_the_reservoir(h0, slope, share, t):
    friction = math.atan(share * math.tan(math.radians(slope)))
    theta, gravity = math.radians(slope), 9.81
    c0 = math.sqrt(gravity * h0 * math.cos(theta))
    m = gravity * (math.sin(theta) - math.cos(theta) * math.tan(friction))
    known = {"c0_m_s": c0, "m_m_s2": m, "h0_m": h0, "slope_deg": slope}
    tail, front = m * t**2 / 2 - c0 * t, m * t**2 / 2 + 2 * c0 * t
    x = np.linspace(tail, front, 20_001)
    depth = dam_breaks.depth_of(known, gravity, x, t)
    assert np.trapezoid(depth, x) == pytest.approx(h0 * c0 * t, rel=1e-6)


def test_stokers_middle_depth_is_that_of_its_polynomial():
    assert dam_breaks.middle_depth(0.5, 0.025, 9.81) == pytest.approx(0.15504, abs=1e-5)
    assert dam_breaks.middle_depth(1.0, 0.1, 9.81) == pytest.approx(0.39617, abs=1e-5)


def test_davis_b_leaves_the_strength_of_associated_soil():
    assert slopes.davis(6e3, math.pi / 4, 1.0) == pytest.approx((4242.64, math.radians(35.2644)), rel=1e-5)
    assert slopes.davis(6e3, math.pi / 4, 1.2113) == pytest.approx((3819.84, math.radians(32.48244)), rel=1e-5)


@given(st.floats(0.5, 2.0), st.floats(0.6, 1.5))
def test_the_multiplier_at_the_limit_is_found(root, power):
    assert slopes.at_limit(lambda m: (root / m) ** power, 1.0, tries=6) == pytest.approx(root, rel=3e-3 / power)


def test_a_search_that_was_stopped_goes_on_behind_its_last_lane(tmp_path):
    ran = []

    def moved(multiplier):
        ran.append(multiplier)
        return None if multiplier > 1.2 else 0.01 + 20 * max(0.0, multiplier - 1.01)

    def stopped(multiplier):
        if len(ran) == 4:
            raise RuntimeError
        return moved(multiplier)

    with pytest.raises(RuntimeError):
        find_kink(slopes.Lanes(tmp_path, stopped), 1.0, 0.01, 0.5)
    found = find_kink(slopes.Lanes(tmp_path, moved), 1.0, 0.01, 0.5)
    assert len(ran) == len(set(ran)) == 8
    assert found.at == pytest.approx(1.01, abs=0.005)
    assert slopes.Lanes(tmp_path, moved)(np.array([1.03, 1.3])).tolist() == [pytest.approx(0.41), math.inf]


def test_dilating_soil_of_just_the_strength_to_stand_comes_to_rest():
    """A level slab under a horizontal acceleration whose base has just the strength that it takes (closed form)."""
    cohesion, phi, height, weight = 3.9e3, 33.0, 10.0, 2e4
    soil = mpm.FrictionalSoil(cohesion, phi, dilation=phi, unit_weight=weight, young=1e8, unusual=True)
    k_h = cohesion / (weight * height) + math.tan(math.radians(phi))
    scene, state = mpm.section(
        mpm.Section([(0, height), (4, height)]), soil, slopes.discretisation(2.0, 2), ends="tied", k_h=k_h
    )
    scene = limit_load_scene(scene)
    stands = mpm.solve(scene, state, t_end=8.0).raise_if_failed()
    assert float(jnp.abs(stands.state.velocity).max()) < 5e-3
    assert float(jnp.abs(stands.state.displacement).max()) < 0.05 * height
    weaker = mpm.solve(mpm.reduced(scene, 1.05), state, t_end=8.0)
    assert float(jnp.abs(weaker.state.displacement).max()) > 0.1 * height


def test_zones_are_ordered_from_the_top_down(tmp_path):
    square = [[0, 0], [10, 0], [10, 4], [0, 4]]
    wedge = [[0, 4], [10, 4], [0, 8]]
    soil = {"c_Pa": 1e3, "phi_deg": 30.0, "unit_weight_saturated_N_m3": 2e4}
    given = {
        "exterior_xz_m": [[[0, 0], [10, 0], [10, 4], [0, 8]]],
        "zones": [{"rings_xz_m": [square]}, {"rings_xz_m": [wedge]}],
        "soil": [soil | {"zone": "low"}, soil | {"zone": "high"}],
    }
    (tmp_path / "slopes_petsc").mkdir()
    (tmp_path / "slopes_petsc" / "kozinec_2d.json").write_text(json.dumps(given))
    strata = slopes.kozinec(tmp_path)
    assert [each["zone"] for each in strata.soils] == ["high", "low"]
    assert strata.section.surface == [(0.0, pytest.approx(8)), (10.0, pytest.approx(4, abs=1e-5))]
    assert {z for _, z in strata.bottoms[0]} == {4.0}


NOSE = {
    "extent_m": {"x": [-175, 30]},
    "surface": {
        "foundation_top_z_m": 30,
        "crest_z_m": 60,
        "toe_line_xy_m": [[-120, 0], [-145, 40], [-120, 80]],
        "crest_line_xy_m": [[-60, 0], [-85, 40], [-60, 80]],
    },
    "soil": [{"c_Pa": c, "phi_deg": 30.0, "unit_weight_saturated_N_m3": 2e4} for c in (1e4, 4e4, 3e4, 2e4)],
}


def test_half_of_the_nose_is_at_rest_as_each_half_of_all_of_it(tmp_path):
    (tmp_path / "slopes_petsc").mkdir()
    (tmp_path / "slopes_petsc" / "heterogeneous_3d.json").write_text(json.dumps(NOSE))
    half, whole = slopes.nose(tmp_path), slopes.nose(tmp_path, whole=True)
    assert half.surface(-145.0, 40.0) == 30
    assert half.surface(-85.0, 40.0) == 60
    assert half.surface(-90.0, np.array([0.0, 80.0])) == pytest.approx([45, 45])
    assert half.back(-90.0, 0.0) == pytest.approx(42.5)

    def found(nose):
        """Of all particles: place, mass, cohesion and stress, in the order of their places."""
        nose = replace(nose, back=lambda x, y: nose.surface(x - 40.0, y))  # as thick as its coarse particles
        scene, state = nose.built(10.0)
        position, stress = np.asarray(scene.particles.position), np.asarray(state.stress)
        cohesion = np.broadcast_to(scene.material.cohesion, position.shape[1])
        every = np.concatenate([position, [scene.particles.mass, cohesion], stress[:3]])
        return every[:, np.lexsort(np.round(position, 2))]

    one, both = found(half), found(whole)
    near, far = (both[:, both[1] < 40], both[:, both[1] > 40])
    far[1] = 80 - far[1]
    far = far[:, np.lexsort(np.round(far[:3], 2))]
    assert len(np.unique(one[4])) == 4
    for side in (near, far):
        assert side[:5] == pytest.approx(one[:5], rel=1e-5, abs=1e-3)
        assert side[5:] == pytest.approx(one[5:], abs=2e-3 * float(np.abs(one[5:]).max()))


@pytest.mark.parametrize("stretch", [0.6, 0.9, 1.3, 2.0])
def test_the_neo_hookean_law_gives_the_stress_of_a_stretch_reached_in_steps(stretch):
    bulk, modulus = 8e5, 4e5
    with jax.enable_x64(True):
        law = elastic.NeoHookean(np.float64(bulk), np.float64(modulus))
        stress, ratio = tuple(np.zeros(1) for _ in range(6)), np.ones(1)
        steps = 20
        f = stretch ** (1 / steps) - 1
        for _ in range(steps):
            stress, ratio = law.update((f, 0.0, 0.0, 0.0, 0.0, 0.0), stress, ratio)
        stress, ratio = np.asarray(stress), np.asarray(ratio)
    assert float(ratio[0]) == pytest.approx(stretch, rel=1e-9)
    lame = bulk - 2 * modulus / 3
    along = (modulus * (stretch**2 - 1) + lame * math.log(stretch)) / stretch
    across = lame * math.log(stretch) / stretch
    assert float(stress[0][0]) == pytest.approx(along, rel=1e-6, abs=1)
    assert float(stress[2][0]) == pytest.approx(across, rel=1e-6, abs=1)
