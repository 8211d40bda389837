"""Lines of sections in DXF drawings: the polyline that is chosen, the units, and what is refused."""

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
    assert np.allclose(mpm.read_line(path), GROUND)
    assert np.allclose(mpm.read_line(path, "ground"), GROUND)


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
    ([("A", GROUND), ("A", GROUND)], {}, "A", "has 2 polylines in its layer 'A', and the line is one: join them"),
    ([("A", GROUND)], {}, "ROCK", "has no polyline in a layer 'ROCK'; layers with some: 'A'"),
    ([], {}, None, "has 0 polylines, and the line is one: draw one"),
    ([("A", GROUND)], {"units": 2}, None, r"is drawn in feet \(\$INSUNITS = 2\): scale it to metres"),
    ([("A", GROUND)], {"units": 4}, None, r"is drawn in millimeters \(\$INSUNITS = 4\)"),
    ([("A", GROUND)], {"units": 1}, None, r"is drawn in inches"),
    ([("A", GROUND, "closed")], {}, None, "in layer 'A' is closed: give the open line"),
    ([("A", [(0, 10, 0), (8, 9, 1), (16, 2, 3)])], {}, None, "runs through space, 8 m along y and 3 m along z"),
]


@pytest.mark.parametrize(("lines", "how", "layer", "message"), REFUSED, ids=[message[:40] for *_, message in REFUSED])
def test_drawings_that_do_not_give_one_line_are_refused(lines, how, layer, message, tmp_path):
    path = drawing(tmp_path / "a.dxf", *lines, **how)
    with pytest.raises(ValueError, match=message):
        mpm.read_line(path, layer)


def test_a_drawing_without_units_is_in_metres(tmp_path):
    assert np.allclose(mpm.read_line(drawing(tmp_path / "a.dxf", ("A", GROUND), units=0)), GROUND)


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
    with pytest.raises(ValueError, match=r"a\.csv, line 1 is 'O,14': give x and z, two numbers"):
        mpm.read_line(tmp_path / "a.csv")


def test_what_reads_drawings_is_asked_for_where_it_lacks(tmp_path, monkeypatch):
    path = drawing(tmp_path / "a.dxf", ("A", GROUND))
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(ValueError, match=r"a\.dxf is a DXF .* ezdxf reads: pip install ezdxf"):
        mpm.read_line(path)
