"""Lines of sections in DXF drawings: the polyline that is chosen, the units, and what is refused."""

import contextlib
import re
import sys

import numpy as np
import pytest

import jaxmpm as mpm
from cooperative.scene import parse, read_scene
from tests.cooperative.scene.test_scene_sections import LAYERED

ezdxf = pytest.importorskip("ezdxf", reason="the extra sections is not installed")

GROUND = [(0, 10), (8, 10), (16, 2), (32, 2)]


def drawing(path, *lines, version="R2010", units=6):
    """A drawing with polylines, each a layer and points: flat, or in space where they have three numbers."""
    made = ezdxf.new(version, units=units)
    for layer, points, *more in lines:
        add = made.modelspace().add_lwpolyline
        if version == "R12" or len(points[0]) == 3:
            add = made.modelspace().add_polyline3d if len(points[0]) == 3 else made.modelspace().add_polyline2d
        add(points, dxfattribs={"layer": layer}, close="closed" in more)
    made.saveas(path)
    return path


@pytest.mark.parametrize("version", ["R12", "R2000", "R2018"])
@pytest.mark.parametrize("points", [GROUND, GROUND[::-1], [(x, 3.0, z) for x, z in GROUND]], ids=str)
def test_the_one_polyline_is_the_line(version, points, tmp_path):
    path = drawing(tmp_path / "section.dxf", ("GROUND", points), version=version)
    for layer in (None, "ground"):
        # A drawing of that age has no unit.
        none = pytest.warns(UserWarning, match="states no unit") if version == "R12" else contextlib.nullcontext()
        with none:
            assert np.allclose(mpm.read_line(path, layer), GROUND)


def test_a_level_line_and_a_mirrored_one_are_read_as_they_look(tmp_path):
    made = ezdxf.new(units=6)
    made.modelspace().add_line((32, 2), (0, 2), dxfattribs={"layer": "WATER"})
    # Seen from behind, x of the entity's own axes runs to the left.
    mirrored = {"layer": "GROUND", "extrusion": (0, 0, -1)}
    made.modelspace().add_lwpolyline([(-x, z) for x, z in GROUND], dxfattribs=mirrored)
    made.saveas(tmp_path / "section.dxf")
    assert mpm.read_line(tmp_path / "section.dxf", "WATER") == [[0, 2], [32, 2]]
    assert np.allclose(mpm.read_line(tmp_path / "section.dxf", "GROUND"), GROUND)


def test_a_scene_takes_surface_and_layers_from_one_drawing(tmp_path):
    drawing(tmp_path / "a.dxf", ("GROUND", GROUND), ("ROCK", [(0, 1), (32, 1)]))
    drawn = LAYERED.replace("[[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]", '"a.dxf#GROUND"')
    drawn = drawn.replace("[[0.0, 1.0], [32.0, 1.0]]", '"a.dxf#ROCK"')
    assert drawn.count("a.dxf") == 2
    (tmp_path / "scene.toml").write_text(drawn)
    text = read_scene(tmp_path / "scene.toml")
    (tmp_path / "a.dxf").unlink()
    assert parse(text).site == parse(LAYERED).site


REFUSED = [
    ([("A", GROUND), ("B", GROUND)], {}, None, r"has 2 polylines, and the line is one: name its layer, as in a.dxf#A"),
    ([("A", GROUND), ("A", GROUND)], {}, "A", "outline of .* encloses nothing: draw the line once"),
    ([("A", GROUND)], {}, "ROCK", "has no polyline in a layer 'ROCK'; layers with some: 'A'"),
    ([], {}, None, "has 0 polylines, and the line is one: draw one"),
    ([("A", GROUND)], {"units": 3}, None, r"is drawn in miles \(\$INSUNITS = 3\): scale it to metres"),
    ([("A", GROUND)], {"units": 4}, None, r"is drawn in millimeters \(\$INSUNITS = 4\), so that the line is 0\.032 m"),
    ([("A", GROUND, "closed"), ("B", GROUND)], {}, None, "has 2 polylines"),
    ([("A", [(0, 10, 0), (8, 9, 1), (16, 2, 3)])], {}, None, "runs through space, 8 m along y and 3 m along z"),
]


@pytest.mark.parametrize(("lines", "how", "layer", "message"), REFUSED, ids=[message[:40] for *_, message in REFUSED])
def test_drawings_that_do_not_give_one_line_are_refused(lines, how, layer, message, tmp_path):
    path = drawing(tmp_path / "a.dxf", *lines, **how)
    with pytest.raises(ValueError, match=message):
        mpm.read_line(path, layer)


def test_a_drawing_without_units_is_in_metres(tmp_path):
    path = drawing(tmp_path / "a.dxf", ("A", GROUND), units=0)
    with pytest.warns(UserWarning, match="states no unit .* taken in metres: its line is 32 m long and 8 m high"):
        assert np.allclose(mpm.read_line(path), GROUND)


@pytest.mark.parametrize(
    "named", ["block 'CUT': explode it", r"curve \(spline\): turn it into", r"curve \(mline\): turn"]
)
@pytest.mark.parametrize("layer", [None, "0"])
def test_blocks_and_curves_are_named(named, layer, tmp_path):
    made = ezdxf.new(units=6)
    if "block" in named:
        made.blocks.new("CUT").add_lwpolyline(GROUND)
        made.modelspace().add_blockref("CUT", (0, 0))
    elif "mline" in named:
        made.modelspace().add_mline(GROUND)
    else:
        made.modelspace().add_spline([(x, z, 0) for x, z in GROUND])
    made.saveas(tmp_path / "a.dxf")
    with pytest.raises(ValueError, match=named):
        mpm.read_line(tmp_path / "a.dxf", layer)


def test_arcs_are_refused(tmp_path):
    made = ezdxf.new(units=6)
    made.modelspace().add_lwpolyline([(0, 10, 0.5), (8, 10, 0), (16, 2, 0)], format="xyb")
    made.saveas(tmp_path / "a.dxf")
    with pytest.raises(ValueError, match="has arcs: turn them into straight pieces"):
        mpm.read_line(tmp_path / "a.dxf")


def test_damaged_drawings_are_named(tmp_path):
    whole = drawing(tmp_path / "a.dxf", ("A", GROUND)).read_bytes()
    heads = [b"", b"\x89PNG", b"AutoCAD Binary DXF\r\n\x1a\x00abc", whole.replace(b"16.0", b"1x.0")]
    for content in (*heads, *(whole[:n] for n in range(200, len(whole) - 4, 1500))):
        (tmp_path / "b.dxf").write_bytes(content)
        with pytest.raises(ValueError, match=r"b.dxf cannot be read as a DXF drawing") as refused:
            mpm.read_line(tmp_path / "b.dxf")
        assert "\n" not in str(refused.value)
    with pytest.raises(ValueError, match=r"none\.dxf cannot be read"):
        mpm.read_line(tmp_path / "none.dxf")
    (tmp_path / "pipe.dxf").mkdir()
    with pytest.raises(ValueError, match="is no regular file"):
        mpm.read_line(tmp_path / "pipe.dxf")
    (tmp_path / "a.csv").write_text("0,1\n2,3\n")
    with pytest.raises(ValueError, match=r"a\.csv is no DXF drawing, which alone has layers"):
        mpm.read_line(tmp_path / "a.csv", "A")


def test_a_mistyped_number_in_the_first_row_is_no_heading(tmp_path):
    (tmp_path / "a.csv").write_text("O,14\n12,14\n36,6\n")
    with pytest.raises(ValueError, match=r"a\.csv, line 1 has 'O', '14': give x and z, two finite numbers"):
        mpm.read_line(tmp_path / "a.csv")


def test_what_reads_drawings_is_asked_for_where_it_lacks(tmp_path, monkeypatch):
    path = drawing(tmp_path / "a.dxf", ("A", GROUND))
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(ValueError, match=r"a\.dxf is a DXF .* ezdxf reads: pip install ezdxf"):
        mpm.read_line(path)


HEADED = {
    "x,z\n0,10\n8,10\n16,2\n32,2\n": "in order",
    "z,x\n10,0\n10,8\n2,16\n2,32\n": "the other way round",
    "Chainage [km];Höhe [cm]\n0;1000\n0,008;1000\n0,016;200\n0,032;200\n": "units in brackets",
    "No,distance,elevation\n,ft,m NAP\n1,0,10\n2,26.246719,10\n3,52.493438,2\n4,104.986877,2\n": "a row of units",
    "x_mm\tz_m\n0\t10\n8000\t10\n16000\t2\n32000\t2\n": "units behind a name",
    "# z x\n10 0\n10 8\n2 16\n2 32\n": "headings in a comment",
    "# surveyed in 2019\n0 10\n8 10\n16 2\n32 2\n": "a comment of two words more",
    "# Slope 7\nx,y\n0,10\n8,10\n16,2\n32,2\n": "y as the height of a section",
    "32,2\n16,2\n8,10\n0,10\n": "from right to left",
}


@pytest.mark.parametrize("text", HEADED, ids=HEADED.values())
@pytest.mark.filterwarnings("ignore:.*columns beside x and z are not read")
def test_columns_are_read_by_their_headings(text, tmp_path):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    assert np.allclose(mpm.read_line(tmp_path / "a.csv"), GROUND, atol=1e-6)


def test_columns_that_are_left_out_are_named(tmp_path):
    (tmp_path / "a.csv").write_text("point,x,z\n1,0,10\n2,8,9\n")
    with pytest.warns(UserWarning, match="columns beside x and z are not read: 'point'"):
        assert mpm.read_line(tmp_path / "a.csv") == [[0, 10], [8, 9]]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("depth,x\n0,1\n2,3\n", "has the headings .*: name the distance along the section x"),
        ("a,b\n0,1\n2,3\n", "has the headings"),
        ("x,y,z\n0,1,2\n2,3,4\n", "has the headings"),
        ("x,distance,z\n0,1,2\n2,3,4\n", "two columns are headed as x"),
        ("x [furlong],z\n0,1\n2,3\n", "is in 'furlong', which is no unit known here"),
        ("0,0,10,0\n8,0,10,0\n", "has 4 columns: give two, x and z, .* semicolons if commas mark decimals"),
        ("x,z\n0,1\n2,\n", "line 3 has '2', '': give x and z"),
        ("x,z\n0,1\n2,nan\n", "line 3 has '2', 'nan'"),
    ],
)
def test_lines_that_are_not_clear_are_refused(text, why, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=why):
        mpm.read_line(tmp_path / "a.csv")


RING = [(0, 0), *GROUND, (32, 0)]


@pytest.mark.parametrize("turn", [1, -1], ids=["clockwise", "anticlockwise"])
@pytest.mark.parametrize("start", range(len(RING)))
@pytest.mark.parametrize("form", ["closed", "open", "pieces"])
def test_the_surface_is_the_upper_edge_of_an_outline(form, start, turn, tmp_path):
    ring = (RING[start:] + RING[:start])[::turn]
    ends = [*ring, ring[0]]
    lines = {"closed": [("A", ring, "closed")], "open": [("A", ends)]}
    lines["pieces"] = [("A", ends[k : k + 2][:: (-1) ** k]) for k in (0, 3, 1, 5, 2, 4)]
    path = drawing(tmp_path / "a.dxf", *lines[form])
    assert np.allclose(mpm.read_line(path), GROUND)
    with pytest.raises(ValueError, match="is closed: give the open line"):
        mpm.read_line(path, outline=False)


def test_only_the_surface_of_a_scene_may_be_an_outline(tmp_path):
    drawing(tmp_path / "a.dxf", ("GROUND", RING, "closed"), ("ROCK", [(0, 0), (0, 1), (32, 1), (32, 0)], "closed"))
    drawn = LAYERED.replace("[[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]", '"a.dxf#GROUND"')
    assert parse(_written(tmp_path, drawn)).site == parse(LAYERED).site
    with pytest.raises(ValueError, match=r"layer .*the line of .*a\.dxf is closed"):
        read_scene(_written(tmp_path, drawn.replace("[[0.0, 1.0], [32.0, 1.0]]", '"a.dxf#ROCK"')))


def _written(folder, text):
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


@pytest.mark.parametrize(("code", "metres"), [(1, 0.0254), (2, 0.3048), (4, 0.001), (5, 0.01), (7, 1e3), (10, 0.9144)])
def test_drawings_are_converted_to_metres(code, metres, tmp_path):
    path = drawing(tmp_path / "a.dxf", ("A", [(x / metres, z / metres) for x, z in GROUND]), units=code)
    assert np.allclose(mpm.read_line(path), GROUND)


@pytest.mark.parametrize("offset", [0.0, 685000.0])
def test_an_upright_face_may_lean_by_rounding(offset):
    lines = ([(0, 4), (8, 4), (8 + lean, 1), (16, 1)] for lean in (0.0, -1e-9, 1e-9))
    upright, *leaning = (mpm.Section([(x + offset, z) for x, z in line]) for line in lines)
    x = offset + np.array([0.0, 7.9, 8.1, 16.0])
    assert all(np.allclose(each.heights(x), upright.heights(x)) for each in leaning)
    with pytest.raises(ValueError, match=r"turns back from .* give points with x rising"):
        mpm.Section([(0, 4), (8, 4), (7.999, 1), (16, 1)]).check()


def test_a_section_in_a_national_grid_asks_for_the_origin_and_takes_it(tmp_path):
    drawing(tmp_path / "a.dxf", ("GROUND", [(x + 685000, z) for x, z in GROUND]), ("ROCK", [(0, 1), (32, 1)]))
    drawn = LAYERED.replace("[[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]", '"a.dxf#GROUND"')
    drawn = drawn.replace("[[0.0, 1.0], [32.0, 1.0]]", '"a.dxf#ROCK"')
    with pytest.raises(ValueError, match=r"begins at x = 685000 m, in a national grid: add origin = 685000\.0, "):
        parse(_written(tmp_path, drawn))
    shifted = parse(_written(tmp_path, drawn.replace("[ground]", "[ground]\norigin = 685000.0")))
    assert shifted.site.shape == parse(LAYERED).site.shape
    assert shifted.site.layers == parse(LAYERED).site.layers
    assert shifted.site.origin == (685000.0, 0.0)


@pytest.mark.parametrize("code", ["-9999", "-9999.0", "-999.25", "-3.4e38"])
def test_a_height_that_stands_for_nothing_measured_is_no_height(code, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"x [m],z [m]\n-999,10\n0,{code}\n20,2\n")
    with pytest.raises(ValueError, match=rf"line 3 has '0', '{re.escape(code)}': give x and z, two finite numbers"):
        mpm.read_line(path)
    path.write_text("x [m],z [m]\n-999,10\n20,2\n")
    assert mpm.read_line(path)[0] == [-999.0, 10.0]
