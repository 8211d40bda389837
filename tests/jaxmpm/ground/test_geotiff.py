"""Terrain models in GeoTIFFs: what is written is read, and what no ground in metres can be made of is refused."""

import contextlib
import sys
import tracemalloc
import warnings

import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TERRAIN
from cooperative.scene import parse, read_scene
from tests.cooperative.scene.test_random_soil import changed

rasterio = pytest.importorskip("rasterio", reason="the extra terrain is not installed")

HEIGHTS = np.arange(12.0).reshape(4, 3) + 100  # rows from north to south
UTM = "EPSG:32633"


def written(path, heights=HEIGHTS, *, crs=UTM, transform=(5.0, 0, 300.0, 0, -5.0, 420.0), unit=None, scale=None, **how):
    """A GeoTIFF of one band whose upper left corner is x = 300 m, y = 420 m."""
    how = {"dtype": "float32", "nodata": -9999.0, "count": 1, **how}
    rows, columns = heights.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(
            path, "w", driver="GTiff", width=columns, height=rows, crs=crs, transform=rasterio.Affine(*transform), **how
        ) as file:
            for band in range(how["count"]):
                file.write(heights.astype(how["dtype"]), band + 1)
            if unit is not None:
                file.set_band_unit(1, unit)
            if scale is not None:
                file.scales, file.offsets = (scale[0],), (scale[1],)
    return path


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16"])
def test_heights_lie_at_the_middles_of_squares_from_south_to_north(dtype, tmp_path):
    raster = mpm.read_raster(written(tmp_path / "dem.tif", dtype=dtype))
    assert (raster.corner, raster.step) == ((302.5, 402.5), 5.0)
    assert np.array_equal(raster.heights, HEIGHTS[::-1].T)


def test_no_data_is_a_hole(tmp_path):
    holed = HEIGHTS.copy()
    holed[0, 1], holed[3, 2] = -9999, np.inf
    raster = mpm.read_raster(written(tmp_path / "dem.tiff", holed))
    assert np.argwhere(np.isnan(raster.heights)).tolist() == [[1, 3], [2, 0]]
    shape = mpm.Terrain(raster, base=90.0)
    with pytest.raises(ValueError, match=r"2 holes between the walls, the first at \(307.5, 417.5\) m: fill them"):
        shape.check()


def test_scale_and_offset_are_applied(tmp_path):
    raster = mpm.read_raster(written(tmp_path / "dem.tif", dtype="int16", scale=(0.1, 50.0), unit="metre"))
    assert np.allclose(raster.heights, HEIGHTS[::-1].T / 10 + 50)


@pytest.mark.parametrize("bands", [1, 3])
def test_a_scene_carries_the_terrain_of_a_geotiff(bands, tmp_path):
    """Of several bands that of the number behind its name."""
    plane = np.linspace(10.0, 6.0, 9)[None] * np.ones((5, 1))
    with rasterio.open(
        written(tmp_path / "dem.tif", plane, transform=(2.0, 0, -1.0, 0, -2.0, 9.0), count=bands), "r+"
    ) as file:
        for other in range(1, bands):
            file.write(plane + other, other)
    text = changed(TERRAIN[: TERRAIN.index("[files]")], ('"hill"', '"dem.tif"' if bands == 1 else f'"dem.tif#{bands}"'))
    (tmp_path / "scene.toml").write_text(text)
    carried = read_scene(tmp_path / "scene.toml")
    (tmp_path / "dem.tif").unlink()
    shape, known = (parse(each).site.shape for each in (carried, TERRAIN))
    x, y = np.array([0.0, 3.3, 16.0]), np.array([0.0, 5.2, 8.0])
    assert np.allclose(shape.heights(x, y), known.heights(x, y))
    assert (shape.walls, shape.base) == (known.walls, known.base)


def test_steps_may_differ_by_rounding(tmp_path):
    raster = mpm.read_raster(written(tmp_path / "dem.tif", transform=(2.0, 0, 300.0, 0, -2.0000004, 420.0)))
    assert (raster.step, raster.corner[0]) == (2.0, 301.0)
    assert raster.corner[1] == pytest.approx(413.0, abs=1e-5)
    with pytest.raises(ValueError, match=r"has steps of 2 and 2\.01 m: resample"):
        mpm.read_raster(written(tmp_path / "dem.tif", transform=(2.0, 0, 300.0, 0, -2.01, 420.0)))


@pytest.mark.parametrize(
    ("crs", "at"),
    [
        ("EPSG:32633", (500e3, 5.2e6)),  # UTM
        ("EPSG:28992", (155e3, 463e3)),  # the Netherlands, with the heights of NAP:
        ("EPSG:7415", (155e3, 463e3)),
        ("EPSG:3035", (4.3e6, 2.8e6)),  # Europe in equal areas
        ("EPSG:3857", (1.0e6, 0.1e6)),  # Web Mercator at the equator
        ("EPSG:2056", (2.6e6, 1.2e6)),  # Switzerland
    ],
)
def test_projections_in_metres_of_the_ground_are_read(crs, at, tmp_path):
    assert mpm.read_raster(written(tmp_path / "dem.tif", crs=crs, transform=(5.0, 0, at[0], 0, -5.0, at[1]))).projection


@pytest.mark.parametrize("reader", ["rasterio", None])
def test_metres_of_a_map_of_the_world_are_no_metres(reader, tmp_path, monkeypatch):
    mercator = {"crs": "EPSG:3857", "transform": (5.0, 0, 1e6, 0, -5.0, 5.8e6)}
    path = written(tmp_path / "dem.tif", **mercator)
    projection = rasterio.open(path).crs.to_wkt()
    (tmp_path / "dem.asc").write_text("ncols 2\nnrows 2\nxllcorner 1e6\nyllcorner 5.8e6\ncellsize 5\n1 2\n3 4\n")
    (tmp_path / "dem.prj").write_text(projection)
    if reader is None:
        monkeypatch.setitem(sys.modules, "rasterio.crs", None)
    with pytest.raises(ValueError, match=r"a metre of its projection is 0\.69\d? m of the ground there: project it"):
        mpm.read_raster(tmp_path / "dem.asc")
    if reader is not None:
        with pytest.raises(ValueError, match=r"a metre of its projection is 0\.69"):
            mpm.read_raster(path)
    (tmp_path / "dem.prj").write_text(rasterio.crs.CRS.from_epsg(32633).to_wkt())
    assert mpm.read_raster(tmp_path / "dem.asc").projection


def test_a_band_is_read_by_its_number(tmp_path):
    with rasterio.open(written(tmp_path / "bands.tif", count=3), "r+") as file:
        file.write(HEIGHTS + 7, 2)
        file.set_band_unit(3, "ft")
        file.scales = (1.0, 0.5, 1.0)
    assert np.allclose(mpm.read_raster(tmp_path / "bands.tif", band=2).heights, (HEIGHTS[::-1].T + 7) / 2)
    with pytest.raises(ValueError, match="has heights in 'ft'"):
        mpm.read_raster(tmp_path / "bands.tif", band=3)
    for band in (0, 4):
        with pytest.raises(ValueError, match=f"3 bands of float32 and none of number {band}: give 1 to 3"):
            mpm.read_raster(tmp_path / "bands.tif", band=band)
    (tmp_path / "dem.asc").write_text("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 5\n1 2\n3 4\n")
    with pytest.raises(ValueError, match="only GeoTIFFs have bands"):
        mpm.read_raster(tmp_path / "dem.asc", band=1)


REFUSED = [
    ({"crs": "EPSG:4326", "transform": (8e-4, 0, 12.0, 0, -8e-4, 47.0)}, "is in degrees: project it to metres first"),
    ({"crs": "EPSG:2225"}, "is in feet: project it to metres first"),
    ({"crs": None, "transform": (8e-4, 0, 12.0, 0, -8e-4, 47.0)}, "look like degrees: project it"),
    ({"crs": "EPSG:32633+6360"}, "is in feet"),
    ({"unit": "ft"}, "has heights in 'ft': give them in metres"),
    ({"transform": (5.0, 1.0, 300.0, 1.0, -5.0, 420.0)}, "or is turned: resample it to squares"),
    ({"transform": (5.0, 0, 300.0, 0, -6.0, 420.0)}, "has steps of 5 and 6 m"),
    ({"transform": (-5.0, 0, 300.0, 0, -5.0, 420.0)}, "has steps of -5 and 5 m"),
    ({"transform": (1.0, 0, 0, 0, 1.0, 0), "crs": None}, "has no position"),
    ({"count": 3}, "has 3 bands of float32: give one of heights"),
    ({"dtype": "complex64", "nodata": None}, "has a band of complex64: give heights"),
]


@pytest.mark.parametrize(("how", "message"), REFUSED, ids=[message[:30] for _, message in REFUSED])
def test_what_is_no_terrain_in_metres_is_refused_with_the_remedy(how, message, tmp_path):
    path = written(tmp_path / "dem.tif", **how)
    with pytest.raises(ValueError, match=message) as refused:
        mpm.read_raster(path)
    assert "\n" not in str(refused.value)


def test_files_that_hold_less_than_they_say_are_refused(tmp_path):
    rough = np.random.default_rng(1).normal(size=(60, 40))
    whole = written(tmp_path / "dem.tif", rough).read_bytes()
    heights = mpm.read_raster(tmp_path / "dem.tif").heights
    for length in (0, 4, 100, len(whole) // 2, len(whole) - 5):
        (tmp_path / "cut.tif").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"cut\.tif cannot be read as a GeoTIFF"):
            mpm.read_raster(tmp_path / "cut.tif")
    # The width stands behind its tag, 256, as one short number.
    at = whole.index(np.array([256, 3, 1, 0, 40, 0], "<u2").tobytes()) + 8
    (tmp_path / "lie.tif").write_bytes(whole[:at] + np.array([60000], "<u2").tobytes() + whole[at + 2 :])
    with pytest.raises(ValueError, match=r"lie\.tif (cannot be read as a GeoTIFF|declares)"):
        mpm.read_raster(tmp_path / "lie.tif")
    generator = np.random.default_rng(2)
    for _ in range(60):
        bytes_ = bytearray(whole)
        for offset in generator.integers(0, 600, 4):
            bytes_[offset] = generator.integers(256)
        (tmp_path / "any.tif").write_bytes(bytes_)
        # Heights that no ground has are taken for holes with a warning, among 60 such files now and then.
        with contextlib.suppress(ValueError), warnings.catch_warnings(action="ignore"):
            assert mpm.read_raster(tmp_path / "any.tif").heights.size <= 2 * heights.size


def test_only_the_file_itself_is_opened(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        mpm.read_raster("/vsizip/none.zip/dem.tif")
    written(tmp_path / "dem.tif")
    (tmp_path / "link.tif").symlink_to(tmp_path / "dem.tif")
    with pytest.raises(ValueError, match="is no regular file"):
        mpm.read_raster(tmp_path / "link.tif")


def test_what_reads_geotiffs_is_asked_for_where_it_lacks(tmp_path, monkeypatch):
    path = written(tmp_path / "dem.tif")
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(ValueError, match=r"is a GeoTIFF, which rasterio reads: pip install rasterio"):
        mpm.read_raster(path)


VIRTUAL = '<VRTDataset rasterXSize="3" rasterYSize="4"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
VIRTUAL += "<SourceFilename>{}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
METADATA = "<PAMDataset><Metadata><MDI key='AREA_OR_POINT'>Point</MDI></Metadata><PAMRasterBand band='1'>"
METADATA += "<NoDataValue>111</NoDataValue><Scale>7</Scale></PAMRasterBand></PAMDataset>"


def test_files_beside_a_geotiff_that_belong_to_it_elsewhere_are_not_read(tmp_path):
    path = written(tmp_path / "dem.tif")
    raster = mpm.read_raster(path)
    bait = written(tmp_path / "bait.tif", np.full((4, 3), 31337.0))
    (tmp_path / "dem.tif.aux.xml").write_text(METADATA)
    for ending in ("ovr", "msk"):
        (tmp_path / f"dem.tif.{ending}").write_text(VIRTUAL.format(bait))
    (tmp_path / "dem.tfw").write_text("7\n0\n0\n-7\n0\n0\n")
    assert mpm.read_raster(path) == raster
    (tmp_path / "virtual.tif").write_text(VIRTUAL.format(bait))
    with pytest.raises(ValueError, match=r"virtual\.tif cannot be read as a GeoTIFF: its first bytes are none"):
        mpm.read_raster(tmp_path / "virtual.tif")


def test_a_grid_of_short_words_takes_little_more_memory_than_its_numbers(tmp_path):
    path = tmp_path / "dem.asc"
    path.write_text("ncols 600\nnrows 600\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + "12 " * 360_000)
    tracemalloc.start()
    assert (mpm.read_raster(path).heights == 12).all()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 15 * path.stat().st_size
