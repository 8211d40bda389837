"""What a campaign writes for other programs, read back by those: rasterio, xarray, pandas, and the project's own."""

import json
import sys
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TERRAIN
from cooperative import hazard
from cooperative.__main__ import main
from cooperative.exports import _dataset as dataset
from cooperative.exports import _export, export
from cooperative.exports import _map_files as map_files
from cooperative.scene import parse, to_toml
from cooperative.scene._files import packed
from cooperative.store import FinishedRun, open_store, read_sample, read_store, write_sample
from tests.scenes import model_of

# rioxarray multiplies transforms by an operator that their library is about to give up.
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

UTM = (
    'PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],AUTHORITY["EPSG","32633"]]'
)

ORIGIN = (500_000.0, 5_200_000.0)


def scene_of(projection):
    """The tilted plane, asked for maps, with a file of heights that has a projection or none."""
    tables = tomllib.loads(TERRAIN)
    hill = mpm.Raster(np.linspace(10.0, 6.0, 5)[:, None] * np.ones(3), (0.0, 0.0), 4.0, projection)
    tables["files"]["hill"] = packed("hill", hill)
    tables["terrain"]["origin"] = list(ORIGIN if projection else (0.0, 0.0))
    tables["hazard"] = {}
    tables["campaign"] = {"samples": 10, "seed": 3, "estimator": "monte carlo"}
    return to_toml(tables)


def filled(folder, text):
    """A campaign of ten samples of which four slid: sample n covers the first 3 + n rows of columns along x."""
    model = model_of(text, "refined")
    shape = mpm.run.column_shape(model.scene)
    with open_store(folder, text) as store:
        for number in range(10):
            slid = number < 4
            row = {"displacement": 5.0 if slid else 0.1, "broke_off": False, "mode": "deep" if slid else ""}
            row |= dict.fromkeys(("runout", "volume", "area", "depth"), 1.0 + number if slid else 0.0)
            covered = np.arange(shape[0])[:, None] * np.ones(shape) < 3 + number
            thick = np.where(covered, 0.5 + number, 0).astype(np.float32)
            fields = {"column_deposit": thick, "column_thickness": thick, "column_speed": thick}
            fields["column_arrival"] = np.where(covered, 1.0, np.nan).astype(np.float32)
            row |= {"area_columns": float(covered.sum())} if slid else {}
            xi = np.random.default_rng(number).standard_normal(model.soil.modes)
            write_sample(store, "rough", FinishedRun(number, "SETTLED", 9, 1.0, xi, {**row, "displacement": 0.1}))
            write_sample(store, "refined", FinishedRun(number, "SETTLED", 9, 1.0, xi, row, fields if slid else {}))
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return filled(tmp_path_factory.mktemp("plain"), scene_of(None))


@pytest.fixture(scope="module")
def maps(plain):
    return hazard.hazard_maps(plain)


@pytest.fixture(scope="module")
def files(plain):
    """What is written of the scene without a projection."""
    return {path.name: path for path in export(plain, ["table", "maps"])}


@pytest.fixture(scope="module")
def site():
    """That of the scene with a projection."""
    return parse(scene_of(UTM)).site


def test_geotiff_is_read_by_rasterio(tmp_path, site, maps):
    rasterio = pytest.importorskip("rasterio", reason="the extra terrain is not installed")
    pytest.importorskip("rioxarray", reason="the extra exports is not installed")
    written = {path.name: path for path in dataset.write_geotiff(tmp_path, site, maps)}
    assert len(written) == len(maps.maps)
    with rasterio.open(written["expected_thickness.tif"]) as file:
        assert file.crs.to_epsg() == 32633
        assert file.units == ("m",) * 3
        assert file.tags()["level"] == "0.95"
        # The north-west cell comes first.
        assert (file.bounds.left, file.bounds.top) == (maps.edges[0][0] + ORIGIN[0], maps.edges[1][-1] + ORIGIN[1])
        for band, limit in enumerate(("value", "low", "high"), 1):
            expected = getattr(maps.maps["expected thickness"], limit)
            np.testing.assert_array_equal(file.read(band)[::-1].T, expected)
        x, y = 2.3, 5.1
        at = next(file.sample([(x + ORIGIN[0], y + ORIGIN[1])]))
        i, j = np.searchsorted(maps.edges[0], x) - 1, np.searchsorted(maps.edges[1], y) - 1
        assert at[0] == maps.maps["expected thickness"].value[i, j]


def test_geopackage_holds_contours_and_deposits_where_they_lie(tmp_path, site, maps):
    geopandas = pytest.importorskip("geopandas", reason="the extra region is not installed")
    pytest.importorskip("pyogrio", reason="the extra region is not installed")
    [path] = map_files.write_geopackage(tmp_path, site, maps)
    assert [each.name for each in path.parent.iterdir()] == ["hazard.gpkg"]
    deposits = geopandas.read_file(path, layer="deposits")
    assert deposits.crs.to_epsg() == 32633
    covered = maps.maps["covered at the end"].value
    for probability, area in zip(deposits.probability, deposits.area, strict=True):
        assert area == pytest.approx((covered >= probability).sum() * maps.plan.area)
    assert len(deposits) > 1
    contours = geopandas.read_file(path, layer="contours")
    assert set(contours["map"]) <= set(maps.maps)
    west, south, east, north = contours.total_bounds
    assert maps.edges[0][0] < west - ORIGIN[0] < east - ORIGIN[0] < maps.edges[0][-1]
    assert maps.edges[1][0] < south - ORIGIN[1] <= north - ORIGIN[1] < maps.edges[1][-1]
    # The plane tilts along x alone, and a contour lies where the probability passes its value.
    reached, x = contours[contours["map"] == "reached"], map_files.middle(maps.edges[0]) + ORIGIN[0]
    assert reached["value"].tolist() == [0.01, 0.02, 0.05, 0.1, 0.2]
    for line in reached.itertuples():
        along = line.geometry.geoms[0].xy[0]
        np.testing.assert_allclose(np.interp(along, x, maps.maps["reached"].value[:, 0]), line.value, atol=1e-9)


def test_tables_are_read_by_pandas(files, maps):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    table = pandas.read_csv(files["table.csv"])
    assert (table["weight"] * table["failed"]).sum() == pytest.approx(0.4)
    tidy = pandas.read_csv(files["hazard.csv"])
    reached = tidy[tidy["map"] == "reached"].pivot(index="x", columns="y", values="value")
    np.testing.assert_allclose(reached.to_numpy(), maps.maps["reached"].value)
    assert tidy[tidy["map"] == "arrival"]["value"].isna().any()
    assert set(tidy["unit"]) == {"-", "m", "s"}


def test_the_campaign_is_read_by_xarray(plain, maps):
    xarray = pytest.importorskip("xarray", reason="the extra exports is not installed")
    pytest.importorskip("h5netcdf", reason="the extra exports is not installed")
    (path,) = export(plain, ["netcdf"])
    with xarray.open_dataset(path) as data:
        assert data.attrs["probability_of_failure"] == pytest.approx(0.4)
        assert data.attrs["scene"] == read_store(plain).source.words
        failed = data.refined_displacement > 1.0
        assert float(data.refined_weight.where(failed).sum()) == pytest.approx(0.4)
        assert data.refined_mode.sel(sample=2).item() == "deep"
        assert np.isnan(data.refined_area_columns.sel(sample=7).item())
        xi = np.random.default_rng(5).standard_normal(data.sizes["term"])
        np.testing.assert_array_equal(data.coefficients.sel(sample=5), xi)
        np.testing.assert_array_equal(data.map_reached, maps.maps["reached"].value)
        assert data.map_arrival.dims == ("x", "y")
        assert data.map_expected_thickness_high.attrs["units"] == "m"
        beyond = data.runout_exceedance.sel(runout_threshold=2.5, method="ffill")
        assert beyond == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("library", "kind", "message"),
    [
        ("pyogrio", "geopackage", r"a GeoPackage needs pyogrio.*pip install pyogrio"),
        ("rioxarray", "geotiff", r"GeoTIFF needs rioxarray.*pip install rioxarray"),
        ("xarray", "netcdf", r"campaign.nc needs xarray.*pip install xarray"),
        ("h5netcdf", "netcdf", r"campaign.nc needs h5netcdf.*pip install h5netcdf"),
    ],
)
def test_what_is_not_installed_is_named_with_its_remedy(library, kind, message, plain, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ValueError, match=message):
        list(export(plain, [kind]))


def test_what_the_campaign_does_not_have_is_refused(plain, tmp_path, capsys):
    bare = scene_of(None).replace("[hazard]", "")
    with open_store(tmp_path / "bare", bare) as store:
        write_sample(store, "refined", sample_of(plain, 7))
    assert main(["export", str(tmp_path / "bare"), "--as", "geotiff"]) == 2
    assert "has no hazard maps to export: give [hazard]" in capsys.readouterr().err
    with pytest.raises(ValueError, match="'hdf5' is no kind of export: give one of table, particles, maps, geotiff"):
        list(export(plain, ["hdf5"]))
    assert main(["export", str(plain), "--as", "table", "--sample", "1"]) == 2
    assert "leave out --sample" in capsys.readouterr().err


def test_runs_of_another_field_are_left_out_of_every_file_and_named(plain, tmp_path):
    xarray = pytest.importorskip("xarray", reason="the extra exports is not installed")
    pytest.importorskip("h5netcdf", reason="the extra exports is not installed")
    text = read_store(plain).source.words
    with open_store(tmp_path / "c", text) as store:
        for number in (0, 7):
            write_sample(store, "rough", read_sample(read_store(plain), "rough", number))
            write_sample(store, "refined", sample_of(plain, number))
        write_sample(store, "refined", replace(sample_of(plain, 1), coefficients=np.zeros(3)))
    with pytest.warns(UserWarning, match=r"sample 1 of the refined grid holds 3 coefficients of a field.*left out"):
        written = {path.name: path for path in export(tmp_path / "c", ["table", "netcdf"])}
    with xarray.open_dataset(written["campaign.nc"]) as data:
        assert data.sample.values.tolist() == [0, 7]
    assert written["table.csv"].read_text().count("\nrefined,") == 2


def test_a_projection_goes_with_the_scene(tmp_path):
    campaign = parse(scene_of(UTM))
    assert (campaign.site.projection, campaign.site.origin) == (UTM, ORIGIN)
    assert parse(scene_of(None)).site.projection is None
    damaged = scene_of(UTM).replace(json.dumps(UTM), "3")
    assert damaged != scene_of(UTM)
    with pytest.raises(ValueError, match=r"is damaged \('projection 3'\)"):
        parse(damaged)
    with pytest.raises(ValueError, match=r"\[terrain\] origin = .*give x and y"):
        parse(scene_of(None).replace("origin = [0.0, 0.0]", "origin = [0.0]"))


def sample_of(folder, number):
    return read_sample(read_store(folder), "refined", number)


def test_maps_of_slides_that_had_not_come_to_rest_say_at_least(tmp_path, plain, maps):
    assert maps.moving == 0
    assert not list(map_files.write_notice(tmp_path, maps))
    moving = replace(maps, moving=3, until=20.0)
    (notice,) = map_files.write_notice(tmp_path, moving)
    text = "3 of 4 slides had not come to rest when they ended at 20 s, so the maps give least values."
    assert (notice.name, notice.read_text()) == ("AT_LEAST.txt", f"{text}\n")
    with open_store(tmp_path / "moving", read_store(plain).source) as store:
        for grid in ("rough", "refined"):
            for number in range(10):
                sample = read_sample(read_store(plain), grid, number)
                write_sample(store, grid, replace(sample, status="FINISHED" if number in (1, 2) else sample.status))
    result = hazard.hazard_maps(tmp_path / "moving")
    assert (result.moving, result.slides, result.until) == (2, 4, parse(scene_of(None)).run.t_end)


@pytest.mark.parametrize(("kind", "library"), [("maps", "csv"), ("geotiff", "rioxarray"), ("geopackage", "pyogrio")])
def test_every_kind_of_map_says_at_least(kind, library, tmp_path, maps):
    pytest.importorskip(library, reason="an extra is not installed")
    ground = SimpleNamespace(origin=(0.0, 0.0), projection=None)
    moving = replace(maps, moving=3, until=20.0)
    written = list(_export._of_maps(ground, SimpleNamespace(folder=tmp_path), moving, [kind]))
    assert written[-1].name == "AT_LEAST.txt"
