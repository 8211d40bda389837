"""Site data: files to soundings, soundings to soil, soil to a scene whose samples honour what was measured."""

from dataclasses import replace

import numpy as np
import pytest

import kl
from benchmarks.robustness.invented import TINY
from cooperative import runs
from cooperative.__main__ import main
from cooperative.laboratory import read_rows
from cooperative.reporting._soundings import DRAWN, conditioned, measured_of
from cooperative.scene import parse, remarks
from cooperative.tools.site import Assumed, estimate_site, write_site
from cooperative.tools.site._scene import _check_inside
from cooperative.tools.site._write import _horizontal
from cooperative.tools.soundings import (
    Sounding,
    Stresses,
    behaviour_index,
    friction_of,
    proposed_layers,
    read_files,
    strength_of,
)
from jaxmpm import read_raster
from kl.estimation import Interval
from tests import ROOT
from tests.scenes import tables, write_gef

PUBLIC = ROOT / "benchmarks" / "data" / "soundings"
AGS = """"GROUP","LOCA"
"HEADING","LOCA_ID","LOCA_NATE","LOCA_NATN","LOCA_GL"
"UNIT","","m","m","m"
"TYPE","ID","2DP","2DP","2DP"
"DATA","BH1","10.00","20.00","5.00"

"GROUP","SCPG"
"HEADING","LOCA_ID","SCPG_TESN","SCPG_CAR"
"UNIT","","",""
"TYPE","ID","X","2DP"
"DATA","BH1","1","0.80"

"GROUP","SCPT"
"HEADING","LOCA_ID","SCPG_TESN","SCPT_DPTH","SCPT_RES","SCPT_FRES","SCPT_PWP2"
"UNIT","","","m","MN/m2","kN/m2","kN/m2"
"TYPE","ID","X","2DP","3DP","3DP","1DP"
"DATA","BH1","1","1.00","0.500","10.0","100.0"
"DATA","BH1","2","2.00","","12.0","120.0"

"GROUP","TRIT"
"HEADING","LOCA_ID","SPEC_DPTH","TRIT_CU"
"UNIT","","m","kPa"
"TYPE","ID","2DP","0DP"
"DATA","BH1","1.50","30"
"""


def _csv(path, text):
    path.write_text(text)
    return path


def test_gaps_stay_gaps_and_units_come_from_the_header(tmp_path):
    """A void of GEF is no number between its neighbours, and kPa are not MPa."""
    path = write_gef(tmp_path / "a.gef", 1e5, [0.5, -999999, 0.7, 0.8])
    (sounding,), _ = read_files([path])
    np.testing.assert_allclose(sounding.cone, [0.5e6, np.nan, 0.7e6, 0.8e6])
    assert (sounding.x, sounding.y, sounding.top, sounding.datum) == (1e5, 433e3, -1.5, "NAP")
    (other,), _ = read_files([write_gef(tmp_path / "b.gef", 1e5, [500.0, 600.0], unit="kPa")])
    np.testing.assert_allclose(other.cone, [0.5e6, 0.6e6])
    (third,), _ = read_files([_csv(tmp_path / "c.csv", "x [m];top [m];depth [cm];qc [kPa]\n3;2;10;500\n3;2;20;\n")])
    np.testing.assert_allclose(third.depth, [0.1, 0.2])
    np.testing.assert_allclose(third.cone, [0.5e6, np.nan])


def test_ags_has_soundings_of_several_pushes_and_strengths(tmp_path):
    pytest.importorskip("python_ags4")
    (sounding,), (lab,) = read_files([_csv(tmp_path / "a.ags", AGS)])
    np.testing.assert_allclose(sounding.cone, [0.5e6, np.nan])
    np.testing.assert_allclose(sounding.pore, [1e5, 1.2e5])
    assert sounding.area_ratio == 0.8
    assert (lab.parameter, lab.z.tolist(), lab.value.tolist()) == ("strength", [3.5], [30e3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth [m],qc\n1,0.5\n", r"column 'qc' has no unit: write qc \[pa\] in the header, or give --units qc="),
        ("depth [m],qc [parsec]\n1,0.5\n", "which is no unit of stress"),
        ("depth [m],qc [Pa]\n1,0.5\n2,0.6\n", r"median of 0.55 Pa .* give the right unit"),
        ("depth [m],qc [MPa]\n1,-1\n2,0\n", "every reading is a gap or a void code"),
        ("depth [m],qc [MPa]\n1000,1\n2000,1\n", r"a depth of 2000 m, the limit is 200 m"),
        ("depth [m],qc [MPa],qc [kPa]\n1,1,1\n", "two columns of cone"),
        ("x [m],z [m]\n1,1\n", "no column of a sounding or of the laboratory"),
        ("depth [m],qc [MPa]\n", "no rows below its header"),
        ("x [m],su [kPa]\n1,30\n", r"no column z \[m\]"),
    ],
)
def test_files_that_cannot_be_used_name_file_value_and_remedy(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as error:
        read_files([_csv(tmp_path / "site.csv", text)])
    assert "site.csv" in str(error.value)


def test_soundings_do_not_contradict_each_other(tmp_path):
    """Two of one name or at one place are one too many; equal depths are averaged."""
    line = "name,x [m],top [m],depth [m],qc [MPa]\n"
    twice = _csv(tmp_path / "twice.csv", line + "a,1,0,1,0.5\nb,1,0,1,0.5\n")
    with pytest.raises(ValueError, match=r"'b' and 'a' lie at one place"):
        read_files([twice])
    again = _csv(tmp_path / "again.csv", line + "c,2,0,1,0.5\nc,2,0,1,0.7\nc,2,0,2,\n")
    with pytest.raises(ValueError, match="both hold the sounding 'c'"):
        read_files([again, again])
    (sounding,), _ = read_files([again])
    np.testing.assert_allclose(sounding.cone, [0.6e6, np.nan])


def _uniform(cone, sleeve, pore=0.0, ratio=None):
    depth = np.arange(0.5, 10, 0.1)
    full = np.ones_like(depth)
    return Sounding("a", "a.csv", 0.0, np.nan, 0.0, None, depth, cone * full, sleeve * full, pore * full, ratio)


def test_parameters_are_those_of_the_sources():
    """s_u, phi and I_c by hand at 5 m, with 18 kN/m3 and water at the surface."""
    stresses = Stresses(18e3, 0.0)
    at = 45
    clay = _uniform(0.6e6, 30e3, pore=0.2e6, ratio=0.8)
    assert clay.depth[at] == pytest.approx(5.0)
    assert strength_of(clay, stresses, 14.0)[at] == pytest.approx((0.6e6 + 0.2 * 0.2e6 - 90e3) / 14)
    # A gap in u_2 is a gap, not a pressure of 0.
    part = strength_of(replace(clay, pore=np.where(clay.depth == clay.depth[at], np.nan, clay.pore)), stresses, 14.0)
    assert np.flatnonzero(np.isnan(part)).tolist() == [at]
    assert strength_of(replace(clay, pore=np.nan * clay.pore), stresses, 14.0)[at] == pytest.approx((0.6e6 - 90e3) / 14)
    sand = _uniform(10e6, 80e3)
    effective = (18e3 - 9.81e3) * 5
    assert friction_of(sand, stresses)[at] == pytest.approx(17.6 + 11 * np.log10(100 / np.sqrt(effective / 1e5)))
    # Robertson (2009): with I_c of clay the exponent of the stress is 1.
    net = 0.64e6 - 90e3
    expected = np.hypot(3.47 - np.log10(net / effective), 1.22 + np.log10(100 * 30e3 / net))
    assert behaviour_index(clay, stresses)[at] == pytest.approx(expected)
    assert behaviour_index(sand, stresses)[at] < 2.05 < expected


def test_layers_are_proposed_by_soil_behaviour_type():
    """Sand over clay with a seam too thin for a layer; without sleeve friction there is no proposal."""
    both = _uniform(10e6, 80e3)
    soft = (both.depth > 6) | ((both.depth > 3) & (both.depth < 3.4))
    cone, sleeve = np.where(soft, 0.6e6, both.cone), np.where(soft, 15e3, both.sleeve)
    layered = Sounding("a", "a.csv", 0.0, np.nan, 0.0, None, both.depth, cone, sleeve, both.pore * np.nan)
    first, second = proposed_layers([layered], Stresses())
    assert (first.kind, second.kind) == ("sand", "clay")
    assert first.bottom == second.top == pytest.approx(-6, abs=0.3)
    with pytest.raises(ValueError, match="no sleeve friction"):
        proposed_layers([Sounding(**{**vars(layered), "sleeve": sleeve * np.nan})], Stresses())


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Soft clay over sand in two soundings of a section that leads east."""
    random = np.random.default_rng(3)
    rows = ["name,x [m],y [m],top [m],depth [m],qc [MPa],fs [kPa]"]
    for name, x in (("a", 105.0), ("b", 113.0)):
        for depth in np.arange(0.2, 7, 0.2):
            cone = np.exp(0.2 * random.standard_normal()) * (0.5 + 0.05 * depth if depth < 4 else 8)
            rows.append(f"{name},{x},50,1.0,{depth:.1f},{cone:.3f},{30 if depth < 4 else 60}")
    path = _csv(tmp_path_factory.mktemp("site") / "cpt.csv", "\n".join(rows))
    return estimate_site([path], Assumed(n_kt=(15.0, 2.0), line=((100.0, 50.0), (200.0, 50.0)), base=-5.0))


def test_estimates_are_written_as_a_part_of_a_scene(site, tmp_path):
    """The scene takes the tables and files as they are; the cone factor's scatter widens the mean."""
    clay, sand = site.layers
    assert (clay.parameter, sand.parameter) == ("strength", "friction")
    assert clay.mean.high / clay.mean.low > clay.fit.mean.high / clay.fit.mean.low
    written = {path.name for path in write_site(site, tmp_path)}
    assert {"site.toml", "estimates.csv", "soundings.png", "clay_1_strength.csv"} <= written
    rows = np.array(read_rows(tmp_path / "clay_1_strength.csv"))
    assert set(rows[:, 0]) == {5.0, 13.0}
    at = [np.abs(clay.points - row[:2, None]).sum(axis=0).argmin() for row in rows]
    np.testing.assert_allclose(rows[:, 2], clay.values[at], rtol=1e-4)
    assert min(read_rows(tmp_path / "sand_2_friction.csv"), key=lambda row: row[1])[1] >= -5
    table = (tmp_path / "estimates.csv").read_text()
    assert "with the scatter of N_kt" in table
    head = f"""name = "site"
[ground]
surface = [[0, 1], [10, 1], [14, -1], [24, -1]]
base = -5.0
{tables(run="t_end = 1.0")}"""
    (tmp_path / "scene.toml").write_text(head + (tmp_path / "site.toml").read_text())
    random = parse(tmp_path / "scene.toml").site.layers[0].random["strength"]
    assert len(random.boreholes) == len(rows)
    assert random.mean_error > 0 < random.cov_error
    assert random.factor_cov == pytest.approx(2 / 15, abs=1e-3)
    # The factor's share of the uncertainty is not in that of the mean, too.
    assert random.mean == pytest.approx(clay.fit.mean.value, rel=1e-3)
    assert random.mean_error / random.mean < clay.mean.error / clay.mean.value


def test_surface_makes_it_a_whole_scene(tmp_path):
    """Grids, walls and maps of a first look over a raster of heights; a sounding beside it is refused."""
    heights = "\n".join(" ".join(f"{max(4 - 0.25 * k, 1):g}" for k in range(17)) for _ in range(9))
    raster = _csv(
        tmp_path / "hill.asc", f"ncols 17\nnrows 9\nxllcorner 0\nyllcorner 0\ncellsize 2\nnodata_value -9\n{heights}\n"
    )
    random = np.random.default_rng(5)
    rows = [
        f"{x},8,3,{0.4 * k:g},{20 * np.exp(0.2 * random.standard_normal()):.2f}" for x in (6, 20) for k in range(12)
    ]
    lab = _csv(tmp_path / "lab.csv", "x [m],y [m],top [m],depth [m],su [kPa]\n" + "\n".join(rows))
    fitted = estimate_site([lab], Assumed(base=-2.0), boundaries=[])
    above_surface = r"values above the surface of .*hill.asc do not condition the field"
    with pytest.warns(UserWarning, match=f"3 {above_surface}"):
        written = write_site(fitted, tmp_path / "site", raster)
    campaign = parse(tmp_path / "site" / "scene.toml")
    assert tmp_path / "site" / "hill.asc" in written  # a scene names no file outside its folder
    with pytest.warns(UserWarning, match=f"3 {above_surface}"):
        write_site(fitted, tmp_path, raster)
    assert parse(tmp_path / "scene.toml").site.shape == campaign.site.shape
    (tmp_path / "site" / "hill.asc").write_text("another")
    refused = pytest.raises(ValueError, match=r"site.hill.asc is there and is not .*hill.asc: move it away")
    with pytest.warns(UserWarning, match=f"3 {above_surface}"), refused:
        write_site(fitted, tmp_path / "site", raster)
    assert campaign.hazard is not None
    assert campaign.site.shape.extent[:2] == (32, 16)
    assert campaign.grids["refined"].cell == 2
    assert len(campaign.site.layers[0].random["strength"].boreholes[0]) == 4
    (tmp_path / "cpt.csv").write_text("x [m],y [m],top [m],depth [m],qc [MPa]\n" + "\n".join(
        f"99,8,3,{0.2 * k:g},{np.exp(0.2 * random.standard_normal()):.3f}" for k in range(20)
    ))  # fmt: skip
    beside = estimate_site([tmp_path / "cpt.csv"], Assumed(n_kt=(14.0, 0.0)), boundaries=[])
    with pytest.raises(ValueError, match=r"lies at x = 99 m, and .*hill.asc reaches from 1 to 33 m"):
        write_site(beside, tmp_path / "other", raster)
    abroad = replace(beside, soundings=(replace(beside.soundings[0], x=12.0, projection="EPSG:32631"),))
    projected = replace(read_raster(raster), projection="EPSG:28992")
    with pytest.raises(ValueError, match=r"UTM zone 31N.* and .*hill.asc in .*RD New.*: project"):
        _check_inside(abroad, raster, projected)
    text = (tmp_path / "cpt.csv").read_text().replace("\n99,8,3,", "\n12,8,13,")
    (tmp_path / "above.csv").write_text(text)
    above = estimate_site([tmp_path / "above.csv"], Assumed(n_kt=(14.0, 0.0), base=-2.0), boundaries=[])
    begins = r"begins at 13 m, and .*hill.asc has the ground at 2\.\S+ m there: correct"
    with pytest.warns(UserWarning, match=begins), pytest.warns(UserWarning, match=f"19 {above_surface}"):
        write_site(above, tmp_path / "above", raster)
    # A cut that the terrain model has and the sounding had not.
    assert not (tmp_path / "above" / "clay_1_strength.csv").exists()
    (tmp_path / "cut.csv").write_text(text.replace("\n12,8,13,", "\n12,8,5.5,"))
    cut = estimate_site([tmp_path / "cut.csv"], Assumed(n_kt=(14.0, 0.0), base=-2.0), boundaries=[])
    begins = r"begins at 5.5 m, and .*hill.asc has the ground at 2\.\S+ m there: correct"
    with pytest.warns(UserWarning, match=begins), pytest.warns(UserWarning, match=above_surface):
        write_site(cut, tmp_path / "cut", raster)
    rows = np.array(read_rows(tmp_path / "cut" / "clay_1_strength.csv"))
    assert 1.7 < rows[:, 2].max() <= 3.2
    (tmp_path / "hill.prj").write_text(pytest.importorskip("pyproj").CRS.from_epsg(32633).to_wkt("WKT1_ESRI"))
    zone = text.replace("\n12,8,13,", "\nEPSG:25832,12,8,3,").replace("x [m]", "projection,x [m]")
    (tmp_path / "zone.csv").write_text(zone.replace("\n99,8,3,", "\nEPSG:25832,12,8,3,"))
    zone = estimate_site([tmp_path / "zone.csv"], Assumed(n_kt=(14.0, 0.0), base=-2.0), boundaries=[])
    with pytest.raises(
        ValueError, match=r"zone.csv is in 'ETRS89 / UTM zone 32N' and .*hill.asc in 'WGS 84 / UTM zone 33N'"
    ):
        write_site(zone, tmp_path / "zone", raster)


def test_the_walk_runs_as_written_on_files_in_a_national_grid(tmp_path):
    """The origin is that which the scene would ask for, and the files that `site` writes are counted from it."""
    west, south = 2_600_155.5, 1_200_463.25
    heights = "\n".join(" ".join(f"{max(4 - 0.25 * k, 1):g}" for k in range(17)) for _ in range(9))
    head = f"ncols 17\nnrows 9\nxllcorner {west}\nyllcorner {south}\ncellsize 2\n"
    raster = _csv(tmp_path / "hill.asc", f"{head}{heights}\n")
    random = np.random.default_rng(5)
    rows = [
        f"{west + x},{south + 8},3,{0.4 * k:g},{20 * np.exp(0.2 * random.standard_normal()):.2f}"
        for x in (6, 20)
        for k in range(12)
    ]
    lab = _csv(tmp_path / "lab.csv", "x [m],y [m],top [m],depth [m],su [kPa]\n" + "\n".join(rows))
    given = ["site", lab, "--surface", raster, "--out", tmp_path / "site", "--base", "-2", "--layers"]
    with pytest.warns(UserWarning, match=r"3 values above the surface of .*hill.asc do not condition the field"):
        assert main([*map(str, given)]) in (0, None)
    campaign = parse(tmp_path / "site" / "scene.toml")
    assert campaign.site.origin == (2_600_100.0, 1_200_400.0)
    assert campaign.site.shape.walls == ((56.5, 88.5), (64.25, 80.25))
    (layer,) = campaign.site.layers
    assert {round(x, 3) for x, *_ in layer.random["strength"].boreholes} == {61.5, 75.5}
    # Values in the coordinates of the projection are counted from the origin too.
    values = next((tmp_path / "site").glob("*strength.csv"))
    shifted = [line.split(",") for line in values.read_text().splitlines()]
    far = [[f"{float(x) + 2_600_100:.3f}", f"{float(y) + 1_200_400:.3f}", *rest] for x, y, *rest in shifted[1:]]
    values.write_text("\n".join(",".join(row) for row in [shifted[0], *far]) + "\n")
    assert parse(tmp_path / "site" / "scene.toml").site.layers == campaign.site.layers


def test_what_is_not_used_of_a_file_is_stated(tmp_path):
    """Columns, values and readings that nothing rests on, each with its reason; no length to sweep stands twice."""
    depths = 0.2 * np.arange(1, 16)
    cones = np.where(depths > 2.9, 0.01, np.exp(0.1 * np.sin(7 * depths)))  # the last bears less than its overburden
    rows = [f"5,3,{depth:.1f},{cone:.3f},2" for depth, cone in zip(depths, cones, strict=True)]
    cpt = _csv(tmp_path / "cpt.csv", "x [m],top [m],depth [m],qc [MPa],speed [cm/s]\n" + "\n".join(rows))
    lab = _csv(
        tmp_path / "lab.csv",
        "x [m],z [m],su [kPa],c [kPa],phi [deg],gamma [kN/m3],E50 [MPa]\n1,2,30,5,25,19,8\n1,1,-3,,,,\n1,-9,40,,,,\n",
    )
    with (
        pytest.warns(UserWarning, match=r"cpt.csv: unknown columns are not read: 'speed \[cm/s\]'"),
        pytest.warns(UserWarning, match="1 values of strength are left out, which have no position or are not above 0"),
        pytest.warns(UserWarning, match="1 values of strength are left out, which lie above or below .* 3 to 0 m"),
    ):
        site = estimate_site([cpt, lab], Assumed(n_kt=(14.0, 0.0)), boundaries=[])
    remarks = " ".join(site.layers[0].remarks)
    assert "1 readings that give no strength above 0 are left out" in remarks
    for layer in (
        "strength, mean 3e+04 Pa, not part of the estimate: compare N_kt",
        "cohesion, mean 5000 Pa, not part of the estimate: the layer has strength in its place",
        "friction, mean 25 degrees, not part of the estimate: the layer has strength in its place",
        "unit_weight, mean 1.9e+04 N/m3, not part of the estimate: the weight is that of --unit-weight",
        "young, mean 8e+06 Pa, not part of the estimate: site.toml has a guess, replace it",
    ):
        assert f"1 laboratory values of {layer}" in remarks


@pytest.mark.parametrize(
    ("assumed", "message"),
    [
        ({"unit_weight": 18.0}, "unit_weight = 18 N/m3, below 3000 N/m3: were kN/m3"),
        ({"unit_weight": -18e3}, "unit_weight = -18000 N/m3: give a finite value above 0"),
        ({"water": np.nan}, "water = nan m: give a finite value"),
        ({"line": ((1.0, 2.0), (1.0, 2.0))}, "starts and ends at one point: give two points"),
    ],
)
def test_assumptions_that_no_ground_has_are_refused(assumed, message):
    with pytest.raises(ValueError, match=message):
        Assumed(**assumed)


def test_lengths_to_sweep_differ(site):
    """The published mean may lie outside the interval, whose end it then takes."""
    fit = replace(site.layers[0].fit, horizontal=Interval(60.0, 30.0, 280.0, 1.0), unknown={"horizontal": "few"})
    assert _horizontal(replace(site.layers[0], fit=fit), site.assumed) == (30.0, [30.0, 40.0])


def test_command_needs_a_cone_factor_for_clay(tmp_path, capsys):
    with pytest.warns(UserWarning, match="u_2 of .* is not used, since no area ratio of the cone is known"):
        assert main(["site", str(PUBLIC / "polder.csv"), "--layers", "-2.5", "-7", "--out", str(tmp_path)]) == 2
    assert "give --n-kt, such as 14" in capsys.readouterr().err


def _with(keys):
    assert "cov = 0.4" in TINY
    return TINY.replace("cov = 0.4", f"cov = 0.4\n{keys}")


def _scene(tmp_path, keys):
    path = tmp_path / "scene.toml"
    path.write_text(_with(keys))
    return path


def test_boreholes_come_from_a_file_that_goes_with_the_scene(tmp_path):
    """The same as rows in the scene, and still there when the file is gone."""
    _csv(tmp_path / "cpt.csv", "x [m],z [m],strength [kPa]\n1.0,1.0,35\n3.0,1.0,\n4.0,2.0,50\n")
    campaign = parse(_scene(tmp_path, 'boreholes = "cpt.csv"'))
    (tmp_path / "cpt.csv").unlink()
    typed = parse(_scene(tmp_path, "boreholes = [[1.0, 1.0, 35e3], [4.0, 2.0, 50e3]]"))
    assert campaign.random == typed.random
    assert parse(campaign.source).random == typed.random
    with pytest.raises(ValueError, match=r"there is no file .*cpt.csv"):
        parse(_scene(tmp_path, 'boreholes = "cpt.csv"'))


def test_boreholes_that_do_not_belong_to_the_ground_or_the_field_are_named(tmp_path):
    beyond = parse(_scene(tmp_path, "boreholes = [[1.0, 1.0, 35e3], [99.0, 1.0, 35e3]]"))
    with pytest.raises(ValueError, match=r"value 35000 at \[99.0, 1.0\] m lies outside the ground, which reaches from"):
        runs.random_soil(beyond)
    with pytest.warns(UserWarning, match=r"value 400000 of strength at .* deviations from the median of Lognormal"):
        runs.random_soil(parse(_scene(tmp_path, "boreholes = [[1.0, 1.0, 400e3]]")))
    ground = beyond.site.shape
    [remark] = remarks(parse(_scene(tmp_path, f"boreholes = [[{ground.extent[0] - 1}, {ground.extent[1]}, 35e3]]")))
    assert remark.startswith("1 borehole values lie above the ground, such as that of strength at [")


def test_each_sample_draws_its_mean_and_honours_what_was_measured(tmp_path):
    """Two more coefficients; their scores move the mean far from the datum, and nothing at it."""
    keys = "boreholes = [[1.0, 1.0, 35e3]]\nborehole_error = 0.01\n"
    plain = parse(_scene(tmp_path, keys))
    uncertain = parse(_scene(tmp_path, f"{keys}mean_error = 8e3\ncov_error = 0.1"))
    known, soil = runs.random_soil(plain), runs.random_soil(uncertain)
    assert soil.modes == known.modes + 2
    model = runs.build(uncertain, "rough", soil)
    sample = np.random.default_rng(1).standard_normal(soil.modes).astype(np.float32)
    field = uncertain.random["strength"]
    values = []
    for score in (-2.0, 0.0, 2.0):
        sample[:2] = score, 0.0
        own = soil.coefficients(sample)["strength"]
        marginal = field.marginal_of(sample[:2])
        at = np.array([[1.0], [1.0]], np.float32)
        here = marginal.transform(kl.field_at(soil.expansions["strength"], own, at))
        assert float(here[0]) == pytest.approx(35e3, rel=0.02)
        values.append(float(np.asarray(model.strength(sample)).mean()))
    assert values[0] < values[1] < values[2]
    x, z = np.asarray(model.scene.particles.position)
    coefficients = runs.coefficients_of(uncertain, soil)
    mean, deviation = conditioned(model, "strength", coefficients, np.arange(x.size))
    few, count = np.array([3, 40]), min(len(coefficients), DRAWN)
    samples = np.array([model.strength(row)[few] for row in coefficients[:count]])
    np.testing.assert_allclose(mean[few], samples.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(conditioned(model, "strength", coefficients, few)[1], deviation[few], rtol=1e-4)
    distance = np.hypot(x - 1.0, z - 1.0)
    assert deviation[distance.argmin()] < 0.6 * deviation[distance.argmax()]
    np.testing.assert_allclose(measured_of(uncertain, "strength"), [[1.0, 1.0, 35e3]])
    # A field whose mean is known has the same samples as ever.
    assert known.groups[0].indices is None
    with pytest.raises(ValueError, match="need marginal = 'lognormal' or 'normal'"):
        parse(_scene(tmp_path, 'marginal = "gumbel"\nmean_error = 8e3'))


def test_an_uncertain_cone_factor_moves_readings_and_field_alike(tmp_path):
    """At a reading strength varies by the factor's cov, else it would be known better than the instrument is."""
    keys = "boreholes = [[X, Z, 35e3]]\nborehole_error = 0.01\n"
    at = runs.build(parse(TINY), "rough", runs.random_soil(parse(TINY))).scene.particles.position[:, 40]
    keys = keys.replace("X", repr(float(at[0]))).replace("Z", repr(float(at[1])))
    known, uncertain = parse(_scene(tmp_path, keys)), parse(_scene(tmp_path, f"{keys}factor_cov = 0.2"))
    draws = np.random.default_rng(11).standard_normal((300, 1 + runs.random_soil(known).modes)).astype(np.float32)
    values = {}
    for name, campaign, used in (("known", known, draws[:, 1:]), ("uncertain", uncertain, draws)):
        soil = runs.random_soil(campaign)
        assert soil.modes == used.shape[1]
        model = runs.build(campaign, "rough", soil)
        values[name] = np.array([np.asarray(model.strength(sample)) for sample in used])
    # The factor's score is the first coefficient, and the field is what it is without.
    factor = np.asarray(kl.Lognormal(1.0, 0.2).transform(draws[:, 0]))
    np.testing.assert_allclose(values["uncertain"], factor[:, None] * values["known"], rtol=1e-4)
    here = values["uncertain"][:, 40]
    assert values["known"][:, 40].std() < 0.02 * 35e3
    np.testing.assert_allclose(here.mean(), 35e3, rtol=0.05)
    np.testing.assert_allclose(here.std() / here.mean(), 0.2, rtol=0.15)
    with pytest.raises(ValueError, match="factor_cov"):
        parse(_scene(tmp_path, "factor_cov = 1.5"))


def test_layers_share_the_draw_of_the_cone_factor(tmp_path):
    """Two fields that stop at layers, and one whose strength was not measured by the cone."""
    layer = "[[layer]]\nname = '{name}'\n{bottom}[layer.strength]\nmean = 30e3\ncov = 0.0\nlength = [20.0, 2.0]\n{own}"
    drawn = "".join(
        layer.format(name=name, bottom=bottom, own=own)
        for name, bottom, own in (
            ("a", "bottom = [[-100, 2.0], [100, 2.0]]\n", "factor_cov = 0.1\n"),
            ("b", "bottom = [[-100, 1.0], [100, 1.0]]\n", "factor_cov = 0.2\n"),
            ("c", "", ""),
        )
    )
    path = tmp_path / "scene.toml"
    ground = "[ground]\nsurface = [[0, 10], [8, 10], [16, 2], [32, 2]]\n"
    begin = TINY.replace(TINY[TINY.index("[slope]") : TINY.index("[soil]")], ground)
    path.write_text(f"{begin}\n{drawn}")
    campaign = parse(path)
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil)
    sample = np.zeros(soil.modes, np.float32)
    sample[0] = 1.5
    strength, number = np.asarray(model.strength(sample)), np.asarray(model.layer)
    for layer, cov in enumerate((0.1, 0.2, 0.0)):
        factor = float(kl.Lognormal(1.0, cov).transform(1.5)) if cov else 1.0
        np.testing.assert_allclose(strength[number == layer], 30e3 * factor, rtol=1e-4)


def test_means_of_samples_have_the_standard_error_that_is_given():
    draws = np.random.default_rng(2).standard_normal((20000, 2))
    field = parse(_with("mean_error = 8e3\ncov_error = 0.1")).random["strength"]
    marginal = field.marginal_of(draws.T)
    np.testing.assert_allclose([np.mean(marginal.mean), np.std(marginal.mean)], [field.mean, 8e3], rtol=0.03)
    np.testing.assert_allclose([np.mean(marginal.cov), np.std(marginal.cov)], [0.4, 0.1], rtol=0.03)
