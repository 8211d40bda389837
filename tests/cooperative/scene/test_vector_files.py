"""Lines and polygons of GeoPackages, shapefiles and GeoJSON: read right, or refused by their true reason."""

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from cooperative.measure import ColumnPlan, ElementAtRisk
from cooperative.scene import parse, tables
from cooperative.scene._files import Files
from cooperative.scene._projection import compare_projections, refuse_unmetric
from cooperative.scene._vector import MOST_FEATURES, _of_bytes, read_features
from cooperative.scene.tables._hazard import Exposed
from cooperative.scene.tables._key import of_features
from tests.cooperative.scene.geopackages import blob, write

DATA = Path(__file__).parents[2] / "data" / "vector"
EAST, NORTH = 500000.0, 6650900.0
HOUSE = shapely.box(EAST + 60, NORTH + 60, EAST + 70, NORTH + 70)
RING = {(60.0, 60.0), (60.0, 70.0), (70.0, 70.0), (70.0, 60.0)}
pytest.importorskip("pyproj")


@pytest.fixture
def package(tmp_path):
    return tmp_path / "site.gpkg"


def ring_of(features):
    [feature] = features
    assert len(feature["points"]) == 4
    return feature["name"], {(x - EAST, y - NORTH) for x, y in feature["points"]}


@pytest.mark.parametrize("name", ["houses.shp", "houses.geojson"])
def test_a_shapefile_and_a_geojson_hold_the_house_of_their_column_name_in_any_case(name):
    if name.endswith("shp"):
        pytest.importorskip("shapefile")
    features, projection = read_features(DATA / name, None)
    assert ring_of(features) == ("house", RING)
    assert compare_projections("houses", projection, "surface", "EPSG:32633") is None
    with pytest.raises(ValueError, match="alone has layers: leave out #roofs"):
        read_features(DATA / name, "roofs")


def test_a_shapefile_is_read_by_its_own_bytes_and_those_beside_it_alone(tmp_path):
    pytest.importorskip("shapefile")
    for end in (".shp", ".DBF"):
        shutil.copy(DATA / f"houses{end.lower()}", tmp_path / f"h{end}")
    assert read_features(tmp_path / "h.shp", None) == (read_features(DATA / "houses.shp", None)[0], None)
    (tmp_path / "h.DBF").unlink()
    assert read_features(tmp_path / "h.shp", None)[0][0]["name"] == "1"
    (tmp_path / "h.dbf").symlink_to(DATA / "houses.dbf")
    with pytest.raises(ValueError, match=r"h.dbf is no regular file"):
        read_features(tmp_path / "h.shp", None)


def test_a_layer_is_read_by_name_and_what_is_left_out_is_named(package):
    write(
        package,
        {"risk": [("house", HOUSE)]},
        kinds={"prices": "attributes", "photo": "tiles"},
        also=["CREATE TABLE prices (a)"],
    )
    with pytest.warns(UserWarning, match=r"site.gpkg: 'prices' \(no geometry\), 'photo' \(a view.*\) beside the layer"):
        features, projection = read_features(package, None)
    assert ring_of(features) == ("house", RING)
    assert projection == "EPSG:32633"
    write(package, {"risk": [("house", HOUSE)], "roads": [("a", shapely.LineString([(0, 0), (1, 1)]))]})
    assert ring_of(read_features(package, "risk")[0]) == ("house", RING)
    for layer in (None, "rivers"):
        with pytest.raises(ValueError, match=r"has the layers risk, roads: give one of them, site.gpkg#risk"):
            read_features(package, layer)
    write(package, {}, kinds={"prices": "attributes"}, also=["CREATE TABLE prices (a)"])
    with pytest.raises(ValueError, match=r"has the layers none \(and 'prices' \(no geometry\)\): export a table with"):
        read_features(package, None)


holes = st.lists(st.tuples(st.floats(0, 7), st.floats(0, 7), st.floats(0.5, 3)), min_size=1, max_size=4)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(holes)
def test_holes_of_a_polygon_are_kept(package, holes):
    """Columns of cells that lie in a hole are not of the element, whatever the slit, and those beside it are."""
    yard = HOUSE.difference(
        shapely.union_all([shapely.box(EAST + 60 + x, NORTH + 60 + y, EAST + 60 + x + a, NORTH + 60 + y + a)
                           for x, y, a in holes])
    )  # fmt: skip
    assume(yard.geom_type == "Polygon")
    [feature], _ = read_features(write(package, {"risk": [("yard", yard)]}), None)
    assert feature["holes"] == len(yard.interiors)
    element = ElementAtRisk("yard", tuple((x - EAST, y - NORTH) for x, y in feature["points"]))
    plan = ColumnPlan((50.0, 50.0), 0.5, (60, 60), ((50.0, 80.0), (50.0, 80.0)))
    edges = np.meshgrid(EAST + plan.edges(0), NORTH + plan.edges(1), indexing="ij")
    (x, y) = edges
    shared = shapely.area(shapely.intersection(shapely.box(x[:-1, :-1], y[:-1, :-1], x[1:, 1:], y[1:, 1:]), yard))
    got = element.columns(plan)
    assert not got[shared == 0].any()
    assert got[shared > 0.01].all()


@pytest.mark.parametrize("change", [{"name": 3}, {"points": None}, {"points": [[0.0], [1.0]]}, {"points": [["x", 2]]},
                                    {"points": [[0, 0], [1]]}, {"holes": None}, {"holes": ...}])  # fmt: skip
def test_features_that_are_none_are_refused(change):
    whole = {"name": "a", "points": [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]], "holes": 0}
    assert Files({"site.gpkg#risk": [whole]}).features("site.gpkg#risk") == [whole]
    given = [{key: value for key, value in (whole | change).items() if value is not ...}]
    with pytest.raises(ValueError, match=r"site.gpkg#risk.*give points \[\[x, y\], \.\.\.\]"):
        Files({"site.gpkg#risk": given}).features("site.gpkg#risk")
    for none in ([], [3], None):
        with pytest.raises(ValueError, match=r"site.gpkg#risk.*give points"):
            Files({"site.gpkg#risk": none}).features("site.gpkg#risk")


def test_the_part_of_a_terrain_has_no_holes(package):
    write(package, {"risk": [("yard", HOUSE.difference(HOUSE.buffer(-3)))]})
    features, _ = read_features(package, None)
    with pytest.raises(ValueError, match=r"names 'yard', which has holes, and this polygon cannot have any"):
        of_features(features)
    assert len(of_features(features, "yard", holes=True)) > 8


@pytest.mark.parametrize("column", ["Name", "NAME", "name"])
def test_the_column_name_is_found_in_any_case(column, package):
    write(package, {"risk": [("barn", HOUSE)]}, also=[f'ALTER TABLE risk RENAME COLUMN name TO "{column}"'])
    assert read_features(package, "risk")[0][0]["name"] == "barn"


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        (shapely.Polygon(HOUSE.exterior, [HOUSE.buffer(3).exterior]), r"feature 1, 'barn', is no polygon \(Hole lies"),
        (shapely.MultiPolygon([HOUSE, shapely.box(0, 0, 1, 1)]), "is no line or polygon: give .* each of one part"),
        (shapely.Point(0, 0), "is no line or polygon"),
        (None, "feature 1 is nothing"),
        (shapely.Polygon(), "feature 1 is Polygon: give lines and polygons"),
        (b"no geometry", "is no geometry of a GeoPackage"),
        (blob(shapely.to_wkb(HOUSE)[:-9]), "is a damaged geometry"),
        (blob(b"\1" + (10).to_bytes(4, "little") + bytes(8)), "without curves"),
        (shapely.LineString([(0, 0), (float("inf"), 1)]), "points that are not finite"),
    ],
)  # fmt: skip
def test_what_no_line_or_polygon_of_a_scene_is_has_its_reason(shape, reason, package):
    with pytest.raises(ValueError, match=reason):
        read_features(write(package, {"risk": [("barn", shape)]}), None)


def test_a_multipolygon_of_one_part_and_three_dimensions_are_read_in_plan(package):
    solid = shapely.force_3d(shapely.MultiPolygon([HOUSE]), 7.0)
    flavours = {flavor: blob(shapely.to_wkb(solid, flavor=flavor)) for flavor in ("iso", "extended")}
    for shape in (*flavours.values(), blob(shapely.to_wkb(solid, byte_order=0))):
        assert ring_of(read_features(write(package, {"risk": [("house", shape)]}), None)[0]) == ("house", RING)


@pytest.mark.parametrize(
    ("srs", "reason"),
    [
        ((2225, "EPSG", 2225, ""), "in 'US survey foot', not in metres"),
        ((4326, "EPSG", 4326, ""), "is in degrees"),
        ((0, "NONE", 0, "undefined"), "is in degrees"),
        ((3857, "EPSG", 3857, ""), "whose metres are stretched"),
        ((9, "NONE", 9, "PROJCS[" * 2500), "has a coordinate system that is not known"),
        ((9, "NONE", 9, 'PROJCS["a",EXTENSION["PROJ4","+init=BAIT:x"]]'), "has a coordinate system that is not known"),
        ((9, "NONE", 9, "/etc/passwd"), "has a coordinate system that is not known, '/etc/passwd'"),
        ((-1, "NONE", -1, "undefined"), None),
        (("\0" * 9, "NONE", -1, "undefined"), "has a coordinate system that is not known"),
    ],
)  # fmt: skip
def test_units_of_a_geopackage_are_those_of_its_coordinate_system(srs, reason, package):
    write(package, {"risk": [("house", HOUSE)]}, srs=srs)
    if reason is None:
        assert read_features(package, None)[1] is None
        return
    with pytest.raises(ValueError, match=reason):
        read_features(package, None)


@pytest.mark.parametrize(
    ("one", "other", "end"),
    [
        ("EPSG:32633", "EPSG:32632", "refused"),
        ("EPSG:26710", "EPSG:26910", "refused"),  # NAD27 and NAD83 lie 200 m apart
        ("EPSG:23032", "EPSG:25832", "refused"),
        ("EPSG:32633", "EPSG:25833", "remark"),
        ("EPSG:28355", "EPSG:7855", "remark"),
        ("EPSG:25832", "EPSG:5555", "same"),  # with heights
        ("EPSG:32633", (DATA / "houses.prj").read_text(), "same"),
    ],
)  # fmt: skip
def test_files_of_a_scene_have_one_projection(one, other, end):
    if end == "refused":
        with pytest.raises(ValueError, match=r"a is in .* and b in .*: project it to the same one"):
            compare_projections("a", one, "b", other)
        return
    remark = compare_projections("a", one, "b", other)
    assert (remark is None) == (end == "same")
    assert remark is None or "one projection of two datums" in remark


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([2056, 2154, 2180, 2193, 27700, 28992, 31254, 31370, 31467, 3006, 3067, 5514, 6677, 7415]))
def test_a_projection_is_known_again_in_the_words_of_other_programs(code):
    import pyproj

    crs = pyproj.CRS.from_epsg(code)
    crs = crs.sub_crs_list[0] if crs.is_compound else crs
    for version in ("WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"):
        try:
            text = crs.to_wkt(version)
        except pyproj.exceptions.CRSError:
            continue  # that program has no words for it
        refuse_unmetric("file", text)
        assert compare_projections("a", f"EPSG:{code}", "b", text) is None, version


def test_a_second_file_in_another_zone_is_refused_beside_the_surface(package):
    files = Files({}, package.parent)
    write(package, {"risk": [("house", HOUSE)]})
    assert files.features("site.gpkg#risk")
    write(package.with_name("other.gpkg"), {"risk": [("house", HOUSE)]}, srs=(32632, "EPSG", 32632, ""))
    with pytest.raises(ValueError, match=r"other.gpkg is in 'WGS 84 / UTM zone 32N' and site.gpkg in .* zone 33N'"):
        files.features("other.gpkg")


def test_a_geojson_without_a_coordinate_system_is_in_degrees_unless_it_cannot_be(tmp_path):
    content = json.loads((DATA / "houses.geojson").read_text())
    del content["crs"]
    path = tmp_path / "h.geojson"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(content).encode())
    features, projection = read_features(path, None)
    assert (ring_of(features), projection) == (("house", RING), None)
    content["features"][0]["geometry"]["coordinates"] = [[[7.1, 46.0], [7.2, 46.0], [7.2, 46.1], [7.1, 46.0]]]
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"no member crs, so that its coordinates are degrees \(RFC 7946\)"):
        read_features(path, None)
    path.write_text(json.dumps({**content, "crs": {"type": "link", "properties": {"href": "http://localhost"}}}))
    with pytest.raises(ValueError, match="cannot be read as GeoJSON"):
        read_features(path, None)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ({"type": "FeatureCollection", "features": []}, "has no features"),
        ({"type": "Topology", "objects": {}}, "its type is 'Topology'"),
        ({"type": "GeometryCollection", "geometries": []}, "its type is 'GeometryCollection'"),
        ({"features": []}, "its type is None"),
    ],
)
def test_a_json_without_lines_and_polygons_is_refused_by_that(tmp_path, content, reason):
    path = tmp_path / "h.geojson"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=reason):
        read_features(path, None)


def test_a_geopackage_that_is_open_elsewhere_is_refused_and_one_that_was_is_read(package):
    write(package, {"risk": [("house", HOUSE)]})
    data = package.read_bytes()
    package.write_bytes(data[:18] + b"\2\2" + data[20:])  # in the mode of a write-ahead log
    assert ring_of(read_features(package, None)[0]) == ("house", RING)
    package.with_name("site.gpkg-wal").write_bytes(b"changes")
    with pytest.raises(ValueError, match=r"site.gpkg-wal holds changes that site.gpkg lacks: close the program"):
        read_features(package, None)


VIEW = "CREATE VIEW risk AS {} UNION SELECT 1 AS fid, geom, name FROM real"


@pytest.mark.parametrize(
    "also",
    [
        [VIEW.format("SELECT load_extension('bait'), 1, 2")],
        [VIEW.format("WITH RECURSIVE n(a) AS (SELECT 1 UNION ALL SELECT a + 1 FROM n) SELECT a, a, a FROM n")],
        ["CREATE VIRTUAL TABLE risk USING fts3(geom, name)"],
        ["CREATE TABLE risk (geom, name, size AS (length(zeroblob(1000000000))))", "INSERT INTO risk VALUES (2, 3)"],
    ],
)  # fmt: skip
def test_a_layer_that_is_a_program_is_not_run(also, package):
    placed = "INSERT INTO gpkg_geometry_columns VALUES ('risk', 'geom', 32633)"
    write(package, {"real": [("house", HOUSE)]}, kinds={"risk": "features"}, also=[*also, placed])
    with pytest.raises(ValueError, match=r"has the layers real \(and 'risk'|cannot be read as a GeoPackage"):
        read_features(package, "risk")


def test_statements_of_a_database_can_neither_write_nor_attach_nor_call(package):
    from cooperative.scene._vector import _database

    database = _database(write(package, {"risk": [("house", HOUSE)]}).read_bytes())
    target = package.with_name("written.db")
    for statement in (f"VACUUM INTO '{target}'", f"ATTACH '{target}' AS b", "DELETE FROM risk", "SELECT length('a')",
                      "CREATE TABLE b (a)", "PRAGMA query_only = OFF", "SELECT load_extension('x')"):  # fmt: skip
        with pytest.raises(sqlite3.DatabaseError):
            database.execute(statement).fetchall()
    assert not target.exists()


def test_geometry_within_geometry_without_end_is_refused():
    head = b"\1" + (6).to_bytes(4, "little") + (1).to_bytes(4, "little")
    with pytest.raises(ValueError, match="is no line or polygon"):
        _of_bytes("feature 1", blob(head * 200_000))


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=80), st.integers(0, 3000))
def test_damaged_files_are_refused_in_words(tmp_path_factory, junk, at):
    pytest.importorskip("shapefile")
    folder = tmp_path_factory.mktemp("damaged")
    whole = write(folder / "a.gpkg", {"risk": [("house", HOUSE)]}).read_bytes()
    for name, data in (("a.gpkg", whole), ("a.shp", (DATA / "houses.shp").read_bytes()),
                       ("a.geojson", (DATA / "houses.geojson").read_bytes())):  # fmt: skip
        at = at % len(data)
        (folder / name).write_bytes(data[:at] + junk + data[at + len(junk) :])
        try:
            features, _ = read_features(folder / name, None)
        except ValueError:
            continue
        assert len(features) <= MOST_FEATURES


SCENE = """name = "hill"
[ground]
surface = [[0, 8], [8, 8], [16, 0], [32, 0]]
base = -2.0
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
softening_modulus = 85e3
residual_ratio = 0.5
[strength]
mean = 40e3
cov = 0.2
length = [20.0, 4.0]
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 1.0
[campaign]
samples = 4
[[exposed]]
name = "house"
polygon = POLYGON
"""


def test_a_closed_ring_is_the_open_one():
    ring = [[60.0, 60.0], [70.0, 60.0], [70.0, 70.0], [60.0, 70.0]]
    opened, closed = (
        tables.read(Exposed, {"name": "house", "polygon": given}, "exposed").polygon
        for given in (ring, [*ring, ring[0]])
    )
    assert opened == closed == tuple(map(tuple, ring))
    with pytest.raises(ValueError, match="give three or more different corners"):
        parse(SCENE.replace("POLYGON", str([ring[0], ring[1], ring[0]])))
