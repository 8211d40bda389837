"""Ground under a terrain model: shares of cut boxes, stress at depth, files of heights, and what is refused."""

import math
import tomllib
import tracemalloc
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.cbook import get_sample_data

import jaxmpm as mpm
from benchmarks.robustness.invented import LAYERED, TERRAIN
from cooperative import runs
from cooperative.example_scenes import begin
from cooperative.runs._size import PER_PARTICLE, PER_POINT
from cooperative.scene import parse, read_scene, to_toml
from cooperative.scene._files import packed
from jaxmpm.ground._boxes import boxes
from tests.scenes import model_of

CLAY = mpm.Soil(strength=30e3, young=2e7, tension_cutoff=0.0)


def raster(height, length=16.0, width=8.0, step=1.0):
    """Heights (m) as a function of x and y."""
    x, y = (np.arange(0, end + step / 2, step) for end in (length, width))
    return mpm.Raster(height(*np.meshgrid(x, y, indexing="ij")), (0.0, 0.0), step)


TILTED = raster(lambda x, y: 11.3 - 0.37 * x + 0.11 * y)
HILL = raster(lambda x, y: 5.0 + 3.0 * np.cos(np.pi * x / 16) ** 2 * np.sin(np.pi * y / 8), step=0.25)


def on_cells(cell):
    return mpm.Discretisation(cell, (cell / 2,) * 3)


@pytest.mark.parametrize("cell", [2.0, 1.0])
def test_boxes_that_a_tilted_plane_cuts_keep_their_share(cell):
    shape = mpm.Terrain(TILTED, base=0.0)
    scene, _ = mpm.terrain(shape, CLAY, on_cells(cell), at_rest=False)
    expected = 16 * 8 * (11.3 - 0.37 * 8 + 0.11 * 4)
    assert shape.volume == pytest.approx(expected, rel=1e-6)
    assert float(jnp.sum(scene.particles.volume)) == pytest.approx(expected, rel=2e-3)
    assert float(jnp.sum(scene.particles.mass)) == pytest.approx(expected * 20e3 / 9.81, rel=2e-3)
    # No sliver is left, and none holds more than its box and a sliver.
    share = np.asarray(scene.particles.volume) / (cell / 2) ** 3
    assert 0.019 < share.min() < share.max() < 1.021


@pytest.mark.parametrize("cell", [2.0, 1.0])
def test_particles_have_the_volume_of_a_hill(cell):
    shape = mpm.Terrain(HILL, base=0.0)
    scene, _ = mpm.terrain(shape, CLAY, on_cells(cell), at_rest=False)
    assert np.sum(scene.particles.volume, dtype=float) == pytest.approx(shape.volume, rel=1e-7)


def test_boxes_are_the_same_however_many_are_looked_at_at_once(monkeypatch):
    rock = raster(lambda x, y: 9.3 - 0.37 * x + 0.11 * y)
    polygon = ((1.0, 1.0), (15.0, 2.0), (9.0, 7.5))
    shape = mpm.Terrain(TILTED, base=0.0, bedrock=rock, polygon=polygon, depth=1.5)
    together = boxes(shape, on_cells(1.0), shape.modelled, shape.floor)
    monkeypatch.setattr("jaxmpm.ground._boxes.AT_ONCE", 1)
    row_by_row = boxes(shape, on_cells(1.0), shape.modelled, shape.floor)
    assert np.array_equal(together.position, row_by_row.position)
    assert np.array_equal(together.volume, row_by_row.volume)


def test_thin_soil_in_a_large_box_takes_little_memory(monkeypatch):
    rock = raster(lambda x, y: 200.0 - 3 * x, length=60.0, width=30.0, step=10.0)
    shape = mpm.Terrain(replace(rock, heights=rock.heights + 2.0), base=-10.0, bedrock=rock)
    lattice = 60 * 30 * 212
    monkeypatch.setattr("jaxmpm.ground._boxes.AT_ONCE", 10**4)
    tracemalloc.start()
    try:
        soil = boxes(shape, on_cells(2.0), shape.modelled, shape.floor)
        assert soil.volume.size < lattice / 50
        assert tracemalloc.get_traced_memory()[1] < 20 * lattice  # bytes: less than three numbers a box
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("steep", "length", "width"), [(3.0, 60.0, 30.0), (0.01, 90.0, 90.0)])
def test_the_points_that_a_terrain_holds_are_known_before_it_is_filled(steep, length, width, monkeypatch):
    monkeypatch.setattr("jaxmpm.ground._boxes.AT_ONCE", 10**4)
    rock = raster(lambda x, y: 200.0 - steep * x, length=length, width=width, step=10.0)
    shape, fine = mpm.Terrain(replace(rock, heights=rock.heights + 2.0), base=-10.0, bedrock=rock), on_cells(2.0)
    held = mpm.ground.points_held(shape, fine)
    boxes(shape, fine, shape.modelled, shape.floor)  # which loads what it needs
    tracemalloc.start()
    try:
        soil = boxes(shape, fine, shape.modelled, shape.floor)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.2 < peak / (PER_POINT * held + PER_PARTICLE * soil.volume.size) < 1
    assert held < math.prod(shape.extent) / math.prod(fine.spacing) / 2


def test_the_stress_under_a_tilted_plane_bears_what_lies_above():
    scene, state = mpm.terrain(mpm.Terrain(TILTED, base=0.0), CLAY, on_cells(2.0))
    z = np.asarray(scene.particles.position[2])
    for height in (1.5, 3.5):
        # Walls on rollers bear no weight, so that the mean upright stress of a level is that of the soil above it.
        stress = float(jnp.mean(state.stress[2][np.abs(z - height) < 0.1]))
        mean_height = 11.3 - 0.37 * 8 + 0.11 * 4
        assert stress == pytest.approx(-20e3 * (mean_height - height), rel=0.01)


def test_layers_follow_the_surface_or_a_raster():
    rock = mpm.Raster(np.full((2, 2), 1.0), (0.0, 0.0), 16.0)
    layers = [
        mpm.Layer(CLAY, depth=2.0),
        mpm.Layer(CLAY, rock),
        mpm.Layer(mpm.Soil(strength=1e9, young=2e7, tension_cutoff=0.0, unusual=True)),
    ]
    shape, numerics = mpm.Terrain(TILTED, 0.0), on_cells(1.0)
    scene, _ = mpm.terrain(shape, layers, numerics, at_rest=False)
    x, y, z = np.asarray(scene.particles.position, float)
    layer = np.where(z > TILTED.at(x, y) - 2 - 1e-4, 0, np.where(z > 1, 1, 2))
    assert np.mean(layer == shape.layer_of(layers, scene.particles.position, numerics)) > 0.999
    assert np.array_equal(np.asarray(scene.material.strength) > 1e8, layer == 2)


def test_a_raster_is_linear_between_its_points_and_crops_and_resamples():
    x, y = np.array([0.3, 7.77, 16.0]), np.array([0.2, 3.3, 8.0])
    plane = 11.3 - 0.37 * x + 0.11 * y
    assert np.allclose(TILTED.at(x, y), plane)
    assert np.allclose(TILTED.resampled(0.5).at(x, y), plane)
    part = TILTED.cropped((2.5, 9.0), (1.0, 4.2))
    assert part.ends == ((2.0, 9.0), (1.0, 5.0))
    assert np.allclose(part.at([3.1], [4.0]), 11.3 - 0.37 * 3.1 + 0.44)
    assert np.isnan(TILTED.at([-1.0], [1.0])).all()


HEADER = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 5\nNODATA_value -9999\n"


def written(tmp_path, text, projection=None):
    (tmp_path / "dem.asc").write_text(text)
    if projection:
        (tmp_path / "dem.prj").write_text(projection)
    return tmp_path / "dem.asc"


def test_an_esri_grid_reads_from_north_to_south(tmp_path):
    raster = mpm.read_raster(written(tmp_path, HEADER + "1 2 3\n4 5 -9999\n"))
    assert (raster.corner, raster.step) == ((12.5, 22.5), 5.0)
    assert np.array_equal(raster.heights, [[4, 1], [5, 2], [np.nan, 3]], equal_nan=True)


@pytest.mark.parametrize("ending", [".prj", ".PRJ", ".Prj"])
def test_a_projection_in_a_file_of_capital_ending_is_read(tmp_path, ending):
    path = written(tmp_path, HEADER + "1 2 3\n4 5 6\n")
    path.with_suffix(ending).write_text('PROJCS["NAD83",UNIT["Foot_US",0.3048]]')
    with pytest.raises(ValueError, match=rf"dem{ending}. is in feet: project it"):
        mpm.read_raster(path)


BAD_FILES = [
    (HEADER + "1 2 3\n4 5\n", None, "declares 3 times 2 heights and holds 5: it is damaged"),
    (HEADER.replace("ncols 3", "ncols 3000000000") + "1 2 3\n", None, "declares 3e\\+09 times 2 heights and holds 3"),
    (HEADER.replace("ncols 3", "ncols 3.5") + "1 2 3\n", None, "declares 3.5 times 2"),
    (HEADER + "1 2 3\n4 5 six\n", None, "has an entry that is no number"),
    (HEADER.replace("nrows 2\n", "") + "1 2 3\n", None, "lacks nrows"),
    (HEADER.replace("xllcorner 10\n", "") + "1 2 3\n", None, "lacks xllcorner"),
    (HEADER.replace("cellsize 5", "cellsize five"), None, "cellsize is 'five': give a number"),
    (HEADER.replace("cellsize 5", "dx 5\ndy 6") + "1 2 3\n4 5 6\n", None, "has steps of 5 and 6 m: resample it"),
    (HEADER.replace("cellsize 5", "cellsize 0.0008") + "1 2 3\n4 5 6\n", None, "look like degrees: project it"),
    (HEADER + "1 2 3\n4 5 6\n", 'GEOGCS["WGS 84",UNIT["degree",0.0174]]', "dem.prj. is in degrees: project it"),
    (HEADER + "1 2 3\n4 5 6\n", 'PROJCS["NAD83",UNIT["Foot_US",0.3048]]', "dem.prj. is in feet: project it"),
    (HEADER + "1 2 3\n4 5 6\n", "Projection GEOGRAPHIC\nUnits DD\n", "dem.prj. is in degrees: project it"),
    (HEADER + "1 2 3\n4 5 6\n", "Projection STATEPLANE\nZunits FEET\nUnits METERS\n", "dem.prj. has zunits 'feet'"),
    (HEADER + "1 2 3\n4 5 6\n", "Projection STATEPLANE\nUnits FEET\n", "dem.prj. has units 'feet'"),
    (HEADER + "1 2 3\n4 5 6\n", 'PROJCS["a",UNIT["Kilometer",1000.0]]', "is in 'KILOMETER': project it"),
    (
        HEADER + "130000 131000 132000\n130000 133000 134000\n",
        None,
        "has heights of 134000 m, and no ground lies beyond",
    ),
    (HEADER + "-99999 1e20 9999\n1 2 3\n", None, "has heights of 1e.20 m"),
    ("\x89PNG", None, "is it an ESRI grid"),
]


TAKEN = HEADER + "101 102 103\n104 105 -9999\n"
FORMS = {
    "decimal commas": TAKEN.replace("cellsize 5", "cellsize 5,00").replace("101", "101,0").replace("10\n", "10,00\n"),
    "capitals": TAKEN.replace("ncols", "NCOLS").replace("cellsize", "CELLSIZE"),
    "centres": TAKEN.replace("xllcorner 10", "xllcenter 12,5").replace("yllcorner 20", "yllcenter 22.5"),
    "another number of holes": TAKEN.replace("-9999\n1", "-3.40282346638529e+38\n1").replace(
        "-9999\n", "-3.4028235e+38\n"
    ),
    "no number of holes": TAKEN.replace("NODATA_value -9999\n", "").replace("-9999", "nan"),
    "steps that differ by rounding": TAKEN.replace("cellsize 5", "dx 5.0\ndy 5.0000004"),
}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("form", FORMS)
def test_one_grid_in_any_form_is_one_raster(form, encoding, tmp_path):
    (tmp_path / "dem.asc").write_bytes(FORMS[form].replace("\n", "\r\n").encode(encoding))
    raster = mpm.read_raster(tmp_path / "dem.asc")
    assert (raster.corner, raster.step) == ((12.5, 22.5), 5.0)
    assert np.array_equal(raster.heights, [[104, 101], [105, 102], [np.nan, 103]], equal_nan=True)


@pytest.mark.parametrize("code", ["-32767", "-32768", "-3.4028235e+38", "32767", "1e+20", "0", "-99", "-9999", "9999"])
def test_a_number_that_no_ground_has_is_a_hole_and_named(code, tmp_path):
    text = TAKEN.replace("NODATA_value -9999", "NODATA_value -1234").replace("-9999", code)
    with pytest.warns(UserWarning, match=r"1 heights of .* m are taken for holes, beside ground at 101 to 105 m"):
        raster = mpm.read_raster(written(tmp_path, text))
    assert np.array_equal(raster.heights, [[104, 101], [105, 102], [np.nan, 103]], equal_nan=True)


@pytest.mark.parametrize("heights", ["0 1 2\n3 4 5\n", "0 0 20\n20 22 25\n", "-1 -99 60\n0 0 0\n", "0 0 0\n0 0 0\n"])
@pytest.mark.filterwarnings("error")
def test_ground_near_sea_level_has_no_holes(heights, tmp_path):
    assert np.isfinite(mpm.read_raster(written(tmp_path, HEADER + heights)).heights).all()


def test_a_surface_at_a_code_below_the_base_may_be_a_hole(tmp_path):
    low = mpm.read_raster(written(tmp_path, HEADER + "0 40 30\n0 30 20\n"))
    with pytest.raises(
        ValueError, match=r"where 0 marks a hole, let the file name it \(NODATA\) and fill it, else lower"
    ):
        mpm.Terrain(low, base=10.0).check()


@pytest.mark.parametrize("text", ["Projection UTM\nZone 32\nZunits NO\nUnits METERS\n", "EPSG:32632", 'PROJCS["cut',
                                  'LOCAL_CS["site",UNIT["metre",1]]'])  # fmt: skip
def test_a_projection_that_is_no_text_of_gis_is_left_out_and_named(text, tmp_path):
    with pytest.warns(UserWarning, match="exported maps have"):
        assert mpm.read_raster(written(tmp_path, HEADER + "1 2 3\n4 5 6\n", text)).projection is None


@pytest.mark.parametrize(("text", "projection", "message"), BAD_FILES, ids=[message[:24] for *_, message in BAD_FILES])
def test_files_that_hold_no_terrain_in_metres_are_refused(text, projection, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        mpm.read_raster(written(tmp_path, text, projection))
    with pytest.raises(ValueError, match="cannot be read"):
        mpm.read_raster(tmp_path / "none.asc")


def test_a_real_terrain_model_in_degrees_is_refused_with_the_remedy():
    with get_sample_data("jacksboro_fault_dem.npz") as data:
        heights, corner, step = data["elevation"], (float(data["xmin"]), float(data["ymin"])), float(data["dx"])
    with pytest.raises(ValueError, match=r"steps of 0.00083\d* from \(-84.* look like degrees: project it to metres"):
        mpm.Terrain(mpm.Raster(heights[::-1].T, corner, step), base=0.0).check()


def with_hole(mark=np.nan):
    heights = TILTED.heights.copy()
    heights[3, 2] = mark
    return mpm.Raster(heights, TILTED.corner, TILTED.step)


REFUSED = [
    (mpm.Terrain(with_hole(), 0.0), CLAY, r"surface has 1 holes between the walls, the first at \(3, 2\) m: fill them"),
    (mpm.Terrain(with_hole(-32768.0), 0.0), CLAY, r"surface has 1 holes between the walls, the first at \(3, 2\) m"),
    (mpm.Terrain(TILTED, 6.0), CLAY, r"surface at \(16, 0, 5.38\) m lies below the base at 6 m"),
    (mpm.Terrain(TILTED, 0.0, x=(-4.0, 8.0)), CLAY, "x = -4 to 8 m: give two within the raster, x = 0 to 16 m"),
    (mpm.Terrain(TILTED, 0.0, y=(0.0, 7.0)), CLAY, "length along y = 7 m is no whole multiple of cell = 2 m"),
    (
        mpm.Terrain(TILTED, 0.0),
        [mpm.Layer(CLAY, raster(lambda x, y: 12 + 0 * x)), mpm.Layer(CLAY)],
        r"bottom of layer 1 lies .* m above the one above it at \(",
    ),
    (
        mpm.Terrain(TILTED, 0.0),
        [mpm.Layer(CLAY, [(0, 1), (16, 1)]), mpm.Layer(CLAY)],
        "layer 1 is a line: under a terrain",
    ),
    (
        mpm.Terrain(TILTED, 0.0),
        [mpm.Layer(CLAY, with_hole()), mpm.Layer(CLAY)],
        r"layer 1 has \d+ holes between",
    ),
    (mpm.Terrain(TILTED, 0.0), [mpm.Layer(CLAY, depth=20.0), mpm.Layer(CLAY)], "layer 2 holds no particle"),
    (
        mpm.Terrain(TILTED, 0.0),
        [mpm.Layer(CLAY, depth=2.0), mpm.Layer(CLAY, thickness=0.6), mpm.Layer(CLAY)],
        r"layer 2 is at most 0.6 m thick, at \(\S+, \S+\) m, less than a particle of 1 m",
    ),
]


@pytest.mark.parametrize(("shape", "soil", "message"), REFUSED, ids=[message[:28] for *_, message in REFUSED])
def test_terrain_that_will_not_do_is_refused_with_its_position(shape, soil, message):
    with pytest.raises(ValueError, match=message):
        mpm.terrain(shape, soil, on_cells(2.0), at_rest=False)


@pytest.fixture
def begun(tmp_path):
    """The scene to begin with, on a grid that is coarse enough for a test."""
    begin("terrain", tmp_path / "terrain.toml")
    text = (tmp_path / "terrain.toml").read_text()
    for old, new in (
        ("samples = 100", 'samples = 4\nestimator = "monte carlo"'),
        ("mean = 35e3", "mean = 12e3"),
        ("t_end = 20.0 ", "t_end = 4.0 "),
        ("cell = 2.0\nspacing = [1.0, 1.0, 1.0]", "cell = 4.0\nspacing = [4.0, 4.0, 2.0]"),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "terrain.toml").write_text(text)
    return tmp_path / "terrain.toml"


def test_a_scene_carries_its_terrain(begun, tmp_path):
    campaign = parse(read_scene(begun))
    assert isinstance(campaign.site.shape, mpm.Terrain)
    model = runs.build(campaign, "rough", runs.random_soil(campaign), at_rest=False)
    size = runs.grid_size(campaign, "rough")
    assert size.nodes == np.prod(model.scene.grid.shape)
    assert float(jnp.sum(model.scene.particles.volume)) == pytest.approx(campaign.site.shape.volume, rel=0.01)
    rock = np.asarray(model.strength(np.zeros(model.soil.modes))) > 1e7
    x, y, z = np.asarray(model.scene.particles.position, float)
    assert np.mean(rock == (z < campaign.site.shape.heights(x, y) - 8)) > 0.99
    source = read_scene(begun)
    ((name, table),) = source.beside["files"].items()
    assert table["shape"] == [25, 17]
    heights = table["heights"]
    for bad in ({"heights": heights[:1] + "AAAA" + heights[5:]}, {"shape": [25, 18]}):
        with pytest.raises(ValueError, match=r"files .* is damaged"):
            parse(replace(source, beside={"files": {name: table | bad}}))


def test_a_scene_says_the_water_in_its_terrain(tmp_path):
    """As a level, as heights, as a depth: the same table where they say the same."""
    start, end = TERRAIN.index("softening_modulus"), TERRAIN.index("[rough]")
    sand = "cohesion = { mean = 5e3, cov = 0.3, length = [20.0, 20.0, 4.0] }\nfriction = 30.0\n"
    text = TERRAIN[:start] + sand + TERRAIN[end : TERRAIN.index("[files]")]
    (tmp_path / "hill.asc").write_text("ncols 5\nnrows 3\nxllcenter 0\nyllcenter 0\ncellsize 4\n" + "10 9 8 7 6\n" * 3)
    (tmp_path / "water.asc").write_text("ncols 3\nnrows 2\nxllcenter 0\nyllcenter 0\ncellsize 8\n" + "8 6 4\n" * 2)
    built = {}
    for name, water in (("raster", 'raster = "water.asc"'), ("depth", "depth = 2.0"), ("level", "level = 4.0")):
        (tmp_path / "scene.toml").write_text(text.replace('"hill"', '"hill.asc"') + f"\n[water]\n{water}\n")
        campaign = parse(read_scene(tmp_path / "scene.toml"))
        built[name] = runs.build(campaign, "rough", None, at_rest=False).scene
    x, _, z = np.asarray(built["raster"].particles.position, float)
    push = {name: np.asarray(scene.loads.water.push(scene.particles.position)) for name, scene in built.items()}
    assert np.allclose(push["raster"], push["depth"], rtol=1e-4, atol=1e-2)
    assert np.array_equal(push["raster"][2] > 0, z - 0.5 < 8 - x / 4 - 1e-5)
    assert np.array_equal(push["level"][2] > 0, z < 4.5 - 1e-5)
    (tmp_path / "scene.toml").write_text(
        text.replace('"hill"', '"hill.asc"') + "\n[water]\ntable = [[0, 1], [16, 1]]\n"
    )
    with pytest.raises(ValueError, match=r"\[water\] table is not for a scene with \[terrain\]"):
        parse(read_scene(tmp_path / "scene.toml"))


def with_line(points):
    return TERRAIN.replace("base = 0.0\n", f"base = 0.0\nrun_out_line = {points}\n")


def test_a_scene_draws_the_line_along_which_run_out_is_measured():
    campaign = parse(with_line("[[1, 4], [9.5, 4], [15, 6]]"))
    model = runs.build(campaign, "rough", None, at_rest=False)
    assert model.geometry.track.points == ((1, 4), (9.5, 4), (15, 6))
    assert runs.build(parse(TERRAIN), "rough", None, at_rest=False).geometry.track is None
    for points, message in (
        ("[[1, 4], [17, 4]]", "has a point 2 at x = 17 m, outside the ground, which reaches from 0 to 16 m"),
        ("[[1, 4], [7]]", r"has a point 2 = \[7.0\]: give \[x, y\]"),
        ("[[1, 4], [1, 4]]", r"has the point \(1, 4\) m twice"),
    ):
        with pytest.raises(ValueError, match=r"\[terrain\] run_out_line .*" + message):
            parse(with_line(points))
    with pytest.raises(ValueError, match="unknown key 'run_out_line'"):
        parse(LAYERED.replace("[ground]", "[ground]\nrun_out_line = [[1, 4], [2, 4]]"))


def test_particles_that_the_highest_point_cuts_have_a_strength():
    # Middles of boxes of 1 m that reach 0.2 m into the ground lie above all of it.
    tables = tomllib.loads(TERRAIN)
    peak = mpm.Raster(np.linspace(9.2, 6.0, 5)[:, None] * np.ones(3), (0.0, 0.0), 4.0)
    tables["files"]["hill"] = packed("hill", peak)
    model = model_of(to_toml(tables))
    assert float(model.scene.particles.position[2].max()) > 9.2
    strength = np.asarray(model.strength(np.zeros(model.soil.modes)))
    assert np.isfinite(strength).all()
    assert (strength > 0).all()
