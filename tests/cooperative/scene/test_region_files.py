"""Files of a region: a raster in a national grid, an extent that no cell divides, features of a GeoPackage."""

import re
from pathlib import Path

import numpy as np
import pytest

from cooperative.example_scenes import begin
from cooperative.scene import parse, read_scene, remarks
from cooperative.scene._region import shift_of

ORIGIN = (689000.0, 5334000.0)


@pytest.fixture
def scene(tmp_path):
    """A terrain scene whose raster is in the projection, and reaches 102 m along x."""
    begin("terrain", tmp_path / "terrain.toml")
    text, grid = (tmp_path / "terrain.toml").read_text(), (tmp_path / "terrain.asc").read_text()
    rows = [line.split() for line in grid.splitlines()]
    head, heights = rows[:5], np.array([row + row[-1:] for row in rows[5:]], float)
    assert [key for key, _ in head] == ["ncols", "nrows", "xllcenter", "yllcenter", "cellsize"]
    lines = [
        f"ncols {heights.shape[1]}",
        f"nrows {heights.shape[0]}",
        f"xllcenter {ORIGIN[0]}",
        f"yllcenter {ORIGIN[1]}",
    ]
    np.savetxt(tmp_path / "terrain.asc", heights, "%.6g", header="\n".join([*lines, "cellsize 4"]), comments="")
    text = re.sub(r"^[xy] = .*\n", "", text, flags=re.M)
    return tmp_path / "terrain.toml", text.replace("base = 90.0", f"base = 90.0\norigin = {list(ORIGIN)}")


def read(path: Path, text: str):
    path.write_text(text)
    source = read_scene(path)
    return source, parse(source)


def test_the_origin_is_subtracted_once_and_what_no_cell_divides_is_cut(scene):
    path, text = scene
    source, campaign = read(
        path, text.replace("cell = 4.0\nspacing = [2.0, 2.0, 2.0]", "cell = 8.0\nspacing = [4.0, 4.0, 4.0]")
    )
    shape = campaign.site.shape
    assert shape.surface.corner == (0.0, 0.0)
    assert campaign.site.origin == ORIGIN
    assert shape.surface.ends == ((0.0, 100.0), (0.0, 64.0))
    assert shape.walls == ((0.0, 96.0), (0.0, 64.0))
    [remark] = [each for each in remarks(campaign) if "wall" in each]
    assert remark.startswith("the surface reaches from x = 0 to 100 m, and the wall stands at 96 m")
    assert parse(source).site.shape == shape
    # A raster that is counted from the origin already stays so.
    grid = path.with_name("terrain.asc")
    grid.write_text(grid.read_text().replace(str(ORIGIN[0]), "0").replace(str(ORIGIN[1]), "0"))
    assert read(path, text)[1].site.shape.surface.corner == (0.0, 0.0)


@pytest.mark.parametrize(
    ("corner", "size", "origin", "shift"),
    [
        ((1000.0, 2000.0), 60.0, (1000.0, 2000.0), (1000.0, 2000.0)),  # a site's own grid
        ((340000.0, 90000.0), 10000.0, (340000.0, 90000.0), (340000.0, 90000.0)),  # a large tile
        ((0.0, 0.0), 60.0, (1000.0, 2000.0), (0.0, 0.0)),
        ((-5000.0, -5000.0), 10000.0, (340000.0, 90000.0), (0.0, 0.0)),
        ((20.0, 30.0), 60.0, (0.0, 0.0), (0.0, 0.0)),
        ((100.0, 0.0), 200.0, (100.0, 0.0), None),  # from either
    ],
)
def test_an_origin_is_subtracted_from_what_lies_nearer_to_it_than_to_zero(corner, size, origin, shift):
    points = np.array(corner) + size * np.array([[0.0, 0.0], [1.0, 1.0]])
    if shift is not None:
        assert shift_of(origin, points).tolist() == list(shift)
        return
    with pytest.raises(ValueError, match="it is not clear whether the origin is to be subtracted: give an origin at"):
        shift_of(origin, points)


def test_a_national_grid_without_an_origin_is_refused_with_one(scene):
    path, text = scene
    with pytest.raises(ValueError, match=r"national grid: add origin = \[689000.0, 5334000.0\], which is subtracted"):
        read(path, text.replace(f"origin = {list(ORIGIN)}", ""))


def test_features_of_a_geopackage_are_read_by_their_name(scene):
    geopandas = pytest.importorskip("geopandas")
    pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    path, text = scene
    east, north = ORIGIN
    houses = {"barn": (60, 20), "mill": (80, 40)}
    frame = geopandas.GeoDataFrame(
        {"name": list(houses)},
        geometry=[shapely.box(east + x, north + y, east + x + 4, north + y + 4) for x, y in houses.values()],
        crs=25832,
    )
    frame.to_file(path.with_name("site.gpkg"), layer="houses")
    line = shapely.LineString([(east + 4, north + 32), (east + 60, north + 30), (east + 90, north + 36)])
    geopandas.GeoDataFrame({"name": ["creek"]}, geometry=[line], crs=25832).to_file(
        path.with_name("site.gpkg"), layer="line"
    )
    text = text.replace("base = 90.0", 'base = 90.0\nrun_out_line = "site.gpkg#line"')
    exposed = '[[exposed]]\nname = "mill"\npolygon = "site.gpkg#houses"\n'
    source, campaign = read(path, text + exposed)
    assert campaign.site.track.points == ((4.0, 32.0), (60.0, 30.0), (90.0, 36.0))
    corners = np.array(campaign.elements_at_risk[0].corners)
    assert corners.shape == (4, 2)
    assert (corners.min(axis=0) == (80, 40)).all()
    assert (corners.max(axis=0) == (84, 44)).all()
    # The files go along in the folder, so that the scene stands alone.
    path.with_name("site.gpkg").unlink()
    assert parse(source).hazard == campaign.hazard
    frame.to_file(path.with_name("site.gpkg"), layer="houses")
    for wrong, message in (
        (exposed.replace("mill", "tower"), r"2 features \('barn', 'mill'\), and 0 are called 'tower'"),
        (exposed.replace("#houses", "#huts"), r"site.gpkg has the layers houses: give one of them, site.gpkg#houses"),
        (exposed.replace("site.gpkg", "other.gpkg"), r"other.gpkg cannot be read"),
    ):
        with pytest.raises(ValueError, match=message):
            read(path, scene[1] + wrong)
