"""A cut's section: its surface cuts off readings, its file begins the scene; what of soundings is said or left out."""

import numpy as np
import pytest

from cooperative.__main__ import main
from cooperative.laboratory import read_rows
from cooperative.scene import parse
from cooperative.tools.site import Assumed, estimate_site
from cooperative.tools.site._section import read_section
from tests.scenes import tables

HEAD = f"""name = "cut"
[ground]
surface = [[0, 8], [10, 8], [18, 0], [40, 0]]
base = -6.0
{tables()}"""


def _csv(path, text):
    path.write_text(text)
    return path


def _soundings(path, xs=(4.0, 24.0), *, clay=(0.5, 0.05), header="qc [MPa],fs [kPa]", end=""):
    """Clay of 14 m below a surface at 8 m in soundings along x, before the cut is made."""
    random = np.random.default_rng(4)
    rows = [f"name,x [m],top [m],depth [m],{header}"]
    for number, x in enumerate(xs):
        for depth in np.arange(0.4, 14, 0.4):
            cone = np.exp(0.15 * random.standard_normal()) * (clay[0] + clay[1] * depth)
            rows.append(f"s{number},{x},8.0,{depth:.1f},{cone:.3f},{40 * cone:.1f}{end}")
    return _csv(path, "\n".join(rows))


def test_the_surface_of_a_cut_cuts_off_what_lies_above_it(tmp_path, capsys):
    """All in one command: the scene that it writes is read, and no value lies above the cut or beside its walls."""
    head = _csv(tmp_path / "head.toml", HEAD)
    files = _soundings(tmp_path / "cpt.csv", (4.0, 24.0, 99.0))
    out = tmp_path / "site"
    given = [str(files), "--n-kt", "15", "2", "--layers", "3", "--section", str(head), "--out", str(out)]
    assert main(["site", *given]) == 0
    printed = capsys.readouterr()
    assert "beside the ground or above its surface do not condition the field" in printed.out
    assert "layer 1 of 2, clay from 8.00 to 3.00 m" in printed.err
    campaign = parse(out / "scene.toml")
    lower = np.array(campaign.site.layers[1].random["strength"].boreholes)
    assert set(lower[:, 0]) == {4.0, 24.0}
    section = read_section(head)
    assert section.inside(lower[:, :2].T).all()
    upper = np.array(read_rows(out / "clay_1_strength.csv"))
    assert set(upper[:, 0]) == {4.0}
    assert "bottom = [[0.0, 3.0], [15.0, 3.0], [18.0, 0.0], [40.0, 0.0]]" in (out / "scene.toml").read_text()


def test_a_slope_that_faces_left_is_cut_likewise(tmp_path):
    path = _csv(
        tmp_path / "left.toml",
        HEAD.replace("[[0, 8], [10, 8], [18, 0], [40, 0]]", "[[0, 0], [22, 0], [30, 8], [40, 8]]"),
    )
    section = read_section(path)
    assert section.bottom(3.0) == [[0.0, 0.0], [22.0, 0.0], [25.0, 3.0], [40.0, 3.0]]
    assert section.inside(np.array([[10.0, 36.0, 36.0, 41.0], [0.5, 0.5, -7.0, 0.0]])).tolist() == [
        False,
        True,
        False,
        False,
    ]
    assert section.holds(7.0)
    assert not section.holds(8.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[slope]\nheight = 3.0\n", r"has no table \[ground\]"),
        ("[ground]\nsurface = [[0, 1], [4, 1]]\n[soil]\nyoung = 1e7\n", "has soil already, which the soundings give"),
        ("[ground]\nsurface = [[0, 1], [4, 1]]\nbse = 1.0\n", "bse"),
        ("[ground\n", "is no scene in TOML"),
    ],
)
def test_sections_that_cannot_be_used_are_named(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_section(_csv(tmp_path / "head.toml", text))


def test_soundings_beside_a_section_are_refused(tmp_path):
    section = read_section(_csv(tmp_path / "head.toml", HEAD))
    path = _soundings(tmp_path / "cpt.csv", (1000.0, 1010.0))
    with pytest.raises(ValueError, match=r"no position lies in .* from x = 0 to 40 m, but from 1000 to 1010 m"):
        estimate_site([path], Assumed(n_kt=(15.0, 0.0), section=section))


def test_pore_pressure_without_an_area_ratio_is_named_and_used_with_one(tmp_path):
    path = _soundings(tmp_path / "cpt.csv", (4.0,), header="qc [MPa],fs [kPa],u2 [kPa]", end=",100")
    with pytest.warns(UserWarning, match="u_2 of s0 is not used, since no area ratio of the cone is known"):
        without = estimate_site([path], Assumed(n_kt=(14.0, 0.0)), boundaries=[])
    given = estimate_site([path], Assumed(n_kt=(14.0, 0.0), area_ratio=0.8), boundaries=[])
    np.testing.assert_allclose(given.layers[0].values - without.layers[0].values, 0.2 * 100e3 / 14)
    with pytest.raises(ValueError, match="area_ratio = 80: cones have"):
        Assumed(area_ratio=80.0)


def _clay_and_sand(path):
    """6 m of clay, then sand into which the sounding was pushed by 1.6 m; nothing was read in the upper 2 m."""
    random = np.random.default_rng(6)
    rows = ["x [m],top [m],depth [m],qc [MPa],fs [kPa]"]
    for depth in np.arange(2.1, 7.65, 0.1):
        cone, sleeve = (0.3, 8) if depth < 6 else (11, 60)
        rows.append(f"5,0,{depth:.1f},{cone * np.exp(0.08 * random.standard_normal()):.4f},{sleeve}")
    return _csv(path, "\n".join(rows))


def test_sand_at_the_end_of_clay_is_a_layer_or_left_out_by_name(tmp_path):
    path = _clay_and_sand(tmp_path / "cpt.csv")
    clay, sand = estimate_site([path], Assumed(n_kt=(14.0, 0.0))).layers
    assert (clay.parameter, sand.parameter) == ("strength", "friction")
    assert clay.fit.cov.value < 0.2
    assert 10e3 < clay.mean.value < 25e3
    assert "no reading from 0.00 to -2.10 m: the soil there is taken to be that of the layer" in clay.remarks
    (whole,) = estimate_site([path], Assumed(n_kt=(14.0, 0.0)), boundaries=[]).layers
    assert whole.fit.cov.value < 0.2
    assert any("readings of sand from -6" in each and "are left out" in each for each in whole.remarks)


def test_estimates_that_no_soil_has_are_warned_of(tmp_path):
    """Sand that is called clay, since nothing tells its type."""
    random = np.random.default_rng(7)
    rows = [f"5,3,{0.2 * k:.1f},{10 * np.exp(0.1 * random.standard_normal()):.3f}" for k in range(1, 30)]
    path = _csv(tmp_path / "cpt.csv", "\n".join(["x [m],top [m],depth [m],qc [MPa]", *rows]))
    with pytest.warns(
        UserWarning, match=r"a mean of \d+ kPa, above 300, which no such soil has: look for another soil"
    ):
        (layer,) = estimate_site([path], Assumed(n_kt=(14.0, 0.0)), boundaries=[]).layers
    assert any("which no such soil has" in each for each in layer.remarks)


def test_the_water_table_of_each_sounding_is_named(tmp_path):
    path = _soundings(tmp_path / "cpt.csv")
    text = path.read_text().splitlines()
    rows = [text[0] + ",water [m]"] + [f"{line},{2.5 if line.startswith('s0') else ''}" for line in text[1:]]
    path.write_text("\n".join(rows))
    (layer,) = estimate_site([path], Assumed(n_kt=(14.0, 0.0), water=4.0), boundaries=[]).layers
    assert "unit weight 18 kN/m3, water 2.5 m below the surface at s0; 4 m below the surface at s1" in layer.remarks


def test_a_sounding_that_does_not_reach_a_layer_in_3d_leaves_it_to_the_others(tmp_path):
    path = _soundings(tmp_path / "cpt.csv")
    text = path.read_text().splitlines()
    deep = [
        f"{line},{7 if line.startswith('s0') else 9}"
        for line in text[1:]
        if "s0" in line or float(line.split(",")[3]) < 5
    ]
    path.write_text("\n".join([f"{text[0]},y [m]", *deep]))
    upper, lower = estimate_site([path], Assumed(n_kt=(14.0, 0.0)), boundaries=[2.0]).layers
    assert set(upper.points[1]) == {7.0, 9.0}
    assert set(lower.points[1]) == {7.0}
