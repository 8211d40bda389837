"""One sounding in every format, with the voids, units, positions and parts that files of the trade have."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cooperative.tools.soundings import corrected_cone, read_files

RD = "EPSG:28992"


@dataclass
class Log:
    """What a made-up sounding measured: depths and lengths in m, stresses in MPa, None where nothing was."""

    length: list
    depth: list
    cone: list
    sleeve: list
    pore: list
    ratio: float | None = 0.8
    water: float | None = None
    predrilled: float | None = None
    inclination: list | None = None


def log(count=20, **kinds):
    own = Log(
        [round(0.2 * k, 3) for k in range(1, count + 1)], [round(0.2 * k, 3) for k in range(1, count + 1)],
        [0.5 + 0.01 * k for k in range(count)], [0.01] * count, [0.05 + 0.002 * k for k in range(count)],
    )  # fmt: skip
    return replace(own, **kinds)


def _cell(value, void):
    return void if value is None else f"{value:.5f}"


def as_gef(path, own, *, void="-9999", x=155020.0, y=463030.0, top="2.0", code="31000"):
    """A GEF file; a column is left out where it has no value."""
    columns = {
        1: ("m", own.length), 2: ("MPa", own.cone), 3: ("MPa", own.sleeve), 6: ("MPa", own.pore), 11: ("m", own.depth),
        8: ("deg", own.inclination),
    }  # fmt: skip
    used = {number: each for number, each in columns.items() if each[1] and set(each[1]) != {None}}
    head = ["#GEFID= 1, 1, 0", f"#TESTID= {path.stem}", "#REPORTCODE= GEF-CPT-Report, 1, 1, 2, -"]
    head += ["#COLUMNSEPARATOR= ;", "#RECORDSEPARATOR= !", f"#XYID= {code}, {x}, {y}", f"#ZID= 31000, {top}"]
    for at, (number, (unit, _)) in enumerate(used.items(), 1):
        head += [f"#COLUMNINFO= {at}, {unit}, column {number}, {number}", f"#COLUMNVOID= {at}, {void}"]
    for number, value in ((3, own.ratio), (13, own.predrilled), (14, own.water)):
        head += [] if value is None else [f"#MEASUREMENTVAR= {number}, {value}, -, -"]
    rows = [
        ";".join(_cell(each, void) for each in row) + ";!" for row in zip(*(e for _, e in used.values()), strict=True)
    ]
    path.write_text("\n".join([*head, "#EOH=", *rows, ""]))
    return path


NAMES = {
    "penetrationLength": "length", "depth": "depth", "coneResistance": "cone", "localFriction": "sleeve",
    "porePressureU2": "pore", "inclinationResultant": "inclination",
}  # fmt: skip


def as_test(own, name, *, x=155020.0, y=463030.0, top=2.0, srs="urn:ogc:def:crs:EPSG::28992", prefix="c"):
    """The element of one sounding in BRO XML, with its name spaces by any prefix."""
    flags = "".join(
        f"<{prefix}:{tag}>{'nee' if getattr(own, key) is None else 'ja'}</{prefix}:{tag}>" for tag, key in NAMES.items()
    )
    lists = [getattr(own, key) or [None] * len(own.cone) for key in NAMES.values()]
    values = ";".join(",".join(_cell(each, "-999999") for each in row) for row in zip(*lists, strict=True))
    numbers = {"coneSurfaceQuotient": own.ratio, "groundwaterLevel": own.water, "predrilledDepth": own.predrilled}
    extra = "".join(f"<{prefix}:{tag}>{v}</{prefix}:{tag}>" for tag, v in numbers.items() if v is not None)
    return (
        f"<CPT_O><{prefix}:broId>{name}</{prefix}:broId>"
        f'<deliveredLocation><{prefix}:location srsName="{srs}"><g:pos>{x} {y}</g:pos></{prefix}:location>'
        f"</deliveredLocation><deliveredVerticalPosition><{prefix}:offset uom='m'>{top}</{prefix}:offset>"
        f"<{prefix}:verticalDatum>NAP</{prefix}:verticalDatum></deliveredVerticalPosition>"
        f"<conePenetrometerSurvey>{extra}<{prefix}:conePenetrationTest><{prefix}:cptResult>"
        f"<{prefix}:values>{values};</{prefix}:values></{prefix}:cptResult></{prefix}:conePenetrationTest>"
        f"<{prefix}:parameters>{flags}</{prefix}:parameters></conePenetrometerSurvey></CPT_O>"
    )


def as_xml(path, *tests, prefix="c", space="http://www.broservices.nl/xsd"):
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>'
        f'<dispatchDataResponse xmlns="{space}/dscpt" xmlns:{prefix}="{space}/cpt" '
        f'xmlns:g="http://www.opengis.net/gml/3.2"><dispatchDocument>{"".join(tests)}</dispatchDocument>'
        "</dispatchDataResponse>"
    )
    return path


def as_ags(path, own, *, push=None, carried=None, gl=("m", "2.00"), x="155020.0", y="463030.0", strengths=""):
    """An AGS4 file; push: number of each reading's push, carried: area ratio of each push."""
    push = push or ["1"] * len(own.cone)
    carried = carried or {"1": own.ratio}
    rows = [
        f'"DATA","A","{at}",' + ",".join(f'"{_cell(each, "")}"' for each in row)
        for at, *row in zip(push, own.depth, own.cone, own.sleeve, own.pore, strict=True)
    ]
    path.write_text(
        '"GROUP","LOCA"\n"HEADING","LOCA_ID","LOCA_NATE","LOCA_NATN","LOCA_GL","LOCA_GREF","LOCA_DATM"\n'
        f'"UNIT","","m","m","{gl[0]}","",""\n"TYPE","ID","2DP","2DP","2DP","X","X"\n'
        f'"DATA","A","{x}","{y}","{gl[1]}","{RD}","NAP"\n\n'
        '"GROUP","SCPG"\n"HEADING","LOCA_ID","SCPG_TESN","SCPG_CAR","SCPG_WAT"\n"UNIT","","","","m"\n'
        '"TYPE","ID","X","2DP","2DP"\n'
        + "".join(
            f'"DATA","A","{at}","{"" if ratio is None else ratio}","{"" if own.water is None else own.water}"\n'
            for at, ratio in carried.items()
        )
        + '\n"GROUP","SCPT"\n"HEADING","LOCA_ID","SCPG_TESN","SCPT_DPTH","SCPT_RES","SCPT_FRES","SCPT_PWP2"\n'
        '"UNIT","","","m","MPa","MPa","MPa"\n"TYPE","ID","X","2DP","3DP","3DP","3DP"\n'
        + "\n".join(rows) + f"\n{strengths}"
    )  # fmt: skip
    return path


UNITS = {"m": 1.0, "ft": 0.3048, "MPa": 1.0, "kPa": 1e-3, "tsf": 0.095760518, "kg/cm2": 0.0980665}


def as_csv(path, own, *, length="m", stress="MPa", delimiter=",", decimal=".", encoding="utf-8", end="\n", void=""):
    """A CSV as some program writes it."""
    header = [f"x [{length}]", f"y [{length}]", f"top [{length}]", f"depth [{length}]"]
    header += [f"{name} [{stress}]" for name in ("qc", "fs", "u2")] + ["area ratio", "water [m]", "crs", "datum"]
    scale, size = UNITS[length], UNITS[stress]
    ends = ["" if own.ratio is None else f"{own.ratio}", "" if own.water is None else f"{own.water}", RD, "NAP"]
    lines = []
    for row in zip(own.depth, own.cone, own.sleeve, own.pore, strict=True):
        read = [None if each is None else each / s for each, s in zip(row, (scale, size, size, size), strict=True)]
        cells = [155020.0 / scale, 463030.0 / scale, 2.0 / scale, *read]
        lines.append([void if each is None else f"{each:.9f}" for each in cells] + ends)
    text = [delimiter.join(header), *(delimiter.join(cell.replace(".", decimal) for cell in line) for line in lines)]
    path.write_bytes(end.join(text).encode(encoding))
    return path


def alike(one, other):
    """Two soundings are the same but for name, file and what an absent area ratio leaves out."""
    for each in fields(one):
        if each.name in ("name", "file"):
            continue
        first, second = getattr(one, each.name), getattr(other, each.name)
        if isinstance(first, (np.ndarray, float)):
            np.testing.assert_allclose(first, second, rtol=1e-5, atol=1e-6, err_msg=each.name)
        else:
            assert first == second, each.name


gaps = st.lists(st.sampled_from([True] * 9 + [False]), min_size=20, max_size=20)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1), cone=gaps, pore=gaps, water=st.sampled_from([None, 1.5]),
    ratio=st.sampled_from([None, 0.6, 0.8]), void=st.sampled_from(["-9999", "-999.25", "-999999", "-1234"]),
    text=st.sampled_from([(",", ".", "utf-8", "\n"), (";", ",", "cp1252", "\r\n"), ("\t", ",", "utf-16", "\r")]),
    length=st.sampled_from(["m", "ft"]), stress=st.sampled_from(["MPa", "kPa", "tsf", "kg/cm2"]),
)  # fmt: skip
def test_a_sounding_is_one_in_every_format(tmp_path, seed, cone, pore, water, ratio, void, text, length, stress):
    pytest.importorskip("python_ags4")
    random = np.random.default_rng(seed)
    own = log(
        cone=[float(v) if known else None for v, known in zip(random.uniform(0.1, 5, 20).round(4), cone, strict=True)],
        pore=[float(v) if known else None for v, known in zip(random.uniform(0.1, 1, 20).round(4), pore, strict=True)],
        water=water, ratio=ratio,
    )  # fmt: skip
    own.cone[0] = 1.0
    delimiter, decimal, encoding, end = text
    paths = [
        as_gef(tmp_path / "a.gef", own, void=void),
        as_xml(tmp_path / "a.xml", as_test(own, "A")),
        as_ags(tmp_path / "a.ags", own),
        as_csv(
            tmp_path / "a.csv", own, length=length, stress=stress, delimiter=delimiter, decimal=decimal,
            encoding=encoding, end=end,
        ),
    ]  # fmt: skip
    first, *others = [read_files([path])[0][0] for path in paths]
    for other in others:
        alike(first, other)
    assert (first.projection, first.datum, first.water) == (RD, "NAP", water)


def test_inclination_takes_depth_and_its_voids_nothing(tmp_path):
    """A void inclination once was an angle: cos(-9999 degrees) made 12 m of sounding 1.89 m deep."""
    upright = log(depth=[None] * 20)
    leaning = replace(upright, inclination=[30.0] * 20)
    part = replace(upright, inclination=[0.0] * 5 + [None] * 10 + [0.0] * 5)
    void = replace(upright, inclination=[-9999.0] * 20)
    read = {
        name: read_files([as_gef(tmp_path / f"{name}.gef", own)])[0][0]
        for name, own in {"upright": upright, "leaning": leaning, "part": part, "void": void}.items()
    }
    alike(read["upright"], read["part"])
    alike(read["upright"], read["void"])
    np.testing.assert_allclose(read["leaning"].depth, np.cos(np.pi / 6) * read["upright"].depth, atol=1e-9)
    with pytest.raises(ValueError, match="leans by 80 degrees, the limit is 45"):
        read_files([as_gef(tmp_path / "fallen.gef", replace(upright, inclination=[80.0] * 20))])


def test_readings_without_a_corrected_depth_follow_their_length(tmp_path):
    whole = log(inclination=[10.0] * 20)
    whole.depth = [round(0.98481 * each, 5) for each in whole.length]
    part = replace(whole, depth=whole.depth[:12] + [None] * 8)
    (one,), _ = read_files([as_xml(tmp_path / "whole.xml", as_test(whole, "A"))])
    with pytest.warns(UserWarning, match="8 readings have no corrected depth and are placed by their length"):
        (other,), _ = read_files([as_xml(tmp_path / "part.xml", as_test(part, "A"))])
    assert other.depth.size == 20
    np.testing.assert_allclose(one.depth, other.depth, atol=1e-3)


def test_a_water_table_that_is_no_measurement_leaves_water_to_the_user(tmp_path):
    for name, water, message in (("zero", 0.0, "where none was measured"), ("above", -1.5, "above the surface")):
        with pytest.warns(UserWarning, match=rf"water table at a depth of .* {message}.* that of --water is used"):
            (read,), _ = read_files([as_gef(tmp_path / f"{name}.gef", log(water=water))])
        assert read.water is None
    (read,), _ = read_files([as_gef(tmp_path / "void.gef", log(water=-9999.0))])
    assert read.water is None


def test_every_sounding_of_an_xml_is_read_whatever_its_name_spaces(tmp_path):
    one, two = as_test(log(), "CPT1"), as_test(log(), "CPT2", x=155050.0)
    both, _ = read_files([as_xml(tmp_path / "both.xml", one, two)])
    apart, _ = read_files([as_xml(tmp_path / "1.xml", one), as_xml(tmp_path / "2.xml", two)])
    assert [each.name for each in both] == ["CPT1", "CPT2"]
    for mine, other in zip(both, apart, strict=True):
        alike(mine, other)
    old = as_xml(
        tmp_path / "old.xml", as_test(log(), "CPT1", prefix="ns14"), prefix="ns14", space="urn:an:older:version"
    )
    alike(read_files([old])[0][0], both[0])
    gone = as_xml(tmp_path / "gone.xml", "<c:BRO_DO><c:deregistered>ja</c:deregistered></c:BRO_DO>")
    with pytest.raises(ValueError, match=r"no cone penetration test of the BRO \(CPT_O\): it holds BRO_DO"):
        read_files([gone])
    bomb = tmp_path / "bomb.xml"
    bomb.write_text('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    with pytest.raises(ValueError, match="declares a document type or entities"):
        read_files([bomb])


def test_positions_that_are_none_are_refused(tmp_path):
    degrees = as_test(log(), "A", x=52.1, y=5.3, srs="urn:ogc:def:crs:EPSG::4258")
    with pytest.raises(ValueError, match=r"its position in degrees \(EPSG:4258\)"):
        read_files([as_xml(tmp_path / "a.xml", degrees)])
    here = as_gef(tmp_path / "here.gef", log())
    for name, kinds, message in (
        ("unset", {"x": 0.0, "y": 0.0}, "the position 0, 0, which was never set"),
        ("own", {"x": 0.0, "y": 0.0, "code": "0"}, "the position 0, 0, which was never set"),
        ("void", {"x": -9999, "y": -9999}, None),
        ("utm", {"x": 640000.0, "y": 5780000.0, "code": "31001"}, "positions in EPSG:28992 and .* in GEF 31001"),
        ("far", {"x": 200000.0}, "22.5 km from the middle of the site, the limit is 20 km"),
        ("degrees", {"x": 5.3, "y": 52.1, "code": "1"}, "position in degrees"),
    ):
        path = as_gef(tmp_path / f"{name}.gef", log(), **kinds)
        if message is None:
            assert np.isnan(read_files([path])[0][0].x)
            continue
        with pytest.raises(ValueError, match=message):
            read_files([here, path])
    lat = tmp_path / "lat.csv"
    lat.write_text("lat,lon,depth [m],qc [MPa]\n52,5,1,1\n")
    with pytest.raises(ValueError, match="the column 'lat' has degrees"):
        read_files([lat])
    with pytest.warns(UserWarning, match="begins at 102 m and 'here', 30 m from it, at 2 m"):
        read_files([here, as_gef(tmp_path / "high.gef", log(), x=155050.0, top="102")])


def test_each_push_of_an_ags_file_has_its_own_cone(tmp_path):
    pytest.importorskip("python_ags4")
    push = ["1"] * 10 + ["2"] * 10
    (read,), _ = read_files([as_ags(tmp_path / "a.ags", log(), push=push, carried={"1": 0.8, "2": 0.6})])
    ratio = np.array([0.8] * 10 + [0.6] * 10)
    np.testing.assert_allclose(read.corrected, read.cone + (1 - ratio) * read.pore)
    assert read.area_ratio is None


LABORATORY = """"GROUP","TRIT"
"HEADING","LOCA_ID","SAMP_TOP","SPEC_DPTH","TRIT_CU"
"UNIT","","m","m","kPa"
"TYPE","ID","2DP","2DP","0DP"
"DATA","A","1.00","1.10","30"
"DATA","A","2.00","","32"
"DATA","A","","","34"
"""


def test_laboratory_values_of_ags_have_a_depth_an_elevation_and_a_place(tmp_path):
    pytest.importorskip("python_ags4")
    with pytest.warns(UserWarning, match="'A' have no depth, so that values of TRIT_CU there are left out"):
        _, (lab,) = read_files([as_ags(tmp_path / "a.ags", log(), strengths=LABORATORY)])
    np.testing.assert_allclose(lab.z, [0.9, 0.0])
    with pytest.warns(UserWarning, match="no depth"):
        _, (feet,) = read_files([as_ags(tmp_path / "ft.ags", log(), gl=("ft", "39.37"), strengths=LABORATORY)])
    np.testing.assert_allclose(feet.z, [10.9, 10.0], atol=1e-3)
    with pytest.raises(ValueError, match=r"'A' have no elevation of the ground \(LOCA_GL\)"):
        read_files([as_ags(tmp_path / "no.ags", log(), gl=("m", ""), strengths=LABORATORY)])
    for encoding in ("cp1252", "utf-8-sig", "utf-16"):
        text = (tmp_path / "a.ags").read_text().replace('"m","m","kPa"', '"m","m","kN/m²"')
        (tmp_path / "units.ags").write_bytes(text.encode(encoding))
        with pytest.warns(UserWarning, match="no depth"):
            _, (squared,) = read_files([tmp_path / "units.ags"])
        np.testing.assert_allclose(squared.value, lab.value)
    nameless = tmp_path / "nameless.ags"
    nameless.write_text((tmp_path / "a.ags").read_text().replace("LOCA_ID", "HOLE"))
    with pytest.raises(ValueError, match="has no heading LOCA_ID"):
        read_files([nameless])
    third = tmp_path / "third.ags"
    third.write_text('"**PROJ"\n"*PROJ_ID"\n"P1"\n')
    with pytest.raises(ValueError, match="this is AGS3"):
        read_files([third])


def _csv(path, header, rows):
    path.write_text("\n".join([header, *rows]))
    return path


def test_corrected_resistance_and_friction_ratio_are_read_where_they_stand_alone(tmp_path):
    def read(name, columns, cells):
        rows = [f"5,0,{0.2 * k:.1f},{cells}" for k in range(1, 21)]
        (own,), _ = read_files([_csv(tmp_path / f"{name}.csv", f"x [m],top [m],depth [m],{columns}", rows)])
        return own

    every = "qc [MPa],fs [kPa],u2 [kPa],qt [MPa],area ratio [-],Rf [%]"
    whole = read("whole", every, "0.5,20,100,0.54,0.6,4")
    by_pore = read("pore", "qc [MPa],fs [kPa],u2 [kPa],area ratio [-]", "0.5,20,100,0.6")
    alone = read("alone", "qt [MPa],Rf [%]", "0.54,3.7037")
    ratio = read("ratio", "qc [MPa],Rf [%]", "0.5,4")
    for each in (whole, by_pore, alone):
        np.testing.assert_allclose(corrected_cone(each), 0.54e6)
    for each in (whole, by_pore, alone, ratio):
        np.testing.assert_allclose(each.sleeve, 20e3, rtol=1e-4)
    with pytest.warns(UserWarning, match=r"q_t differs from q_c \+ \(1 - a\) u_2 by 6%"):
        read("wrong", every, "0.5,20,100,0.54,0.9,4")


def test_sleeves_of_0_are_none_and_pre_drilled_readings_are_counted(tmp_path):
    (read,), _ = read_files([as_gef(tmp_path / "a.gef", log(sleeve=[0.0] * 20))])
    assert np.isnan(read.sleeve).all()
    with pytest.warns(UserWarning, match="4 readings above the pre-drilled depth of 1 m are left out"):
        (read,), _ = read_files([as_gef(tmp_path / "b.gef", log(predrilled=1.0))])
    assert read.depth[0] == pytest.approx(1.0)


def test_units_of_other_countries_are_converted(tmp_path):
    known = (("psf", "900", 43092.2), ("ksf", "0.9", 43092.2), ("t/m2", "3", 29420.0), ("kg/cm2", "0.3", 29420.0))
    for unit, cell, value in known:
        path = _csv(tmp_path / "lab.csv", f"x [ft],z [US survey ft],su [{unit}],gamma [pcf]", [f"10,100,{cell},115"])
        _, (strength, weight) = read_files([path])
        np.testing.assert_allclose(
            [strength.value[0], strength.x[0], weight.value[0]], [value, 3.048, 18065], rtol=1e-4
        )
        assert strength.z[0] == pytest.approx(30.48006)
    with pytest.raises(
        ValueError, match=r"in 'parsec', which is no unit of stress known here: give one of pa, kpa, mpa"
    ):
        read_files([_csv(tmp_path / "bad.csv", "x [m],z [m],su [parsec]", ["1,1,1"])])
    sheet = tmp_path / "site.xlsx"
    sheet.write_bytes(b"PK\x03\x04")
    with pytest.raises(ValueError, match=r"ends in '.xlsx'.*save each sheet as CSV"):
        read_files([sheet])


def test_names_of_soundings_are_one_printable_line(tmp_path):
    path = as_gef(tmp_path / "a.gef", log())
    path.write_text(path.read_text().replace("#TESTID= a", "#TESTID= \x1b[31mCPT\u202e1\x07"))
    (read,), _ = read_files([path])
    assert read.name == "?[31mCPT?1?"


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), kind=st.sampled_from(["gef", "xml", "csv", "ags"]))
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_damaged_files_are_read_or_refused_by_name(tmp_path, data, kind):
    """Bytes that are lost, doubled or changed come to a sounding or to an error that names the file."""
    path = tmp_path / f"damaged.{kind}"
    own = log(10, inclination=[1.0] * 10)
    {"gef": as_gef, "csv": as_csv, "ags": as_ags, "xml": lambda at, each: as_xml(at, as_test(each, "A"))}[kind](
        path, own
    )
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content) - 2))
        cut = data.draw(
            st.sampled_from([b"", b"\n", b",", b";", b"!", b"-9999", b"nan", b"1e999", b'"', b"<", b"\xff"])
        )
        content[at : at + data.draw(st.integers(0, 40))] = cut
    path.write_bytes(bytes(content))
    soundings, refused = [], None
    try:
        soundings, _ = read_files([path])
    except ValueError as error:
        refused = str(error)
    assert refused is None or "damaged" in refused
    for each in soundings:
        assert np.isfinite(each.depth).all()
        assert (np.diff(each.depth) > 0).all()
        assert (np.nan_to_num(each.cone) >= 0).all()


def test_one_coordinate_system_may_have_several_names(tmp_path):
    pytest.importorskip("pyproj")
    coded = as_gef(tmp_path / "coded.gef", log())
    (first,), _ = read_files([coded])
    table = "projection,name,x [m],y [m],top [m],depth [m],qc [MPa]\n{0},B,{1},{2},2,1,1\n{0},B,{1},{2},2,2,1\n"
    named = tmp_path / "named.csv"
    for name in ("RD", "RD New", "Amersfoort / RD New"):
        named.write_text(table.format(name, first.x + 30, first.y))
        assert [sounding.projection for sounding in read_files([coded, named])[0]] == [RD, name]
    for name in ("EPSG:32631", "OSGB", "WGS 84 / UTM zone 31N", "the pond's corner"):
        named.write_text(table.format(name, first.x + 30, first.y))
        with pytest.raises(ValueError, match=f"positions in EPSG:28992 and .* in {name}: convert them to one"):
            read_files([coded, named])


@pytest.mark.parametrize(
    ("variable", "water"),
    [
        ("14, 1.5, m, water", 1.5), ("14, 150, cm, water", 1.5), ("14, 1.5, m-mv, water", 1.5),
        ("14, 0.5, m NAP, level", 1.5), ("14, 50, cm+NAP, level", 1.5), ("14, -9999, m NAP, level", None),
    ],
)  # fmt: skip
def test_numbers_in_the_head_of_a_gef_have_the_unit_that_it_states(tmp_path, variable, water):
    path = as_gef(tmp_path / "a.gef", log(), top="2.0")
    path.write_text(
        path.read_text().replace("#EOH=", f"#MEASUREMENTVAR= {variable}\n#MEASUREMENTVAR= 13, 100, cm\n#EOH=")
    )
    with pytest.warns(UserWarning, match="4 readings above the pre-drilled depth of 1 m"):
        (sounding,), _ = read_files([path])
    assert (sounding.water is None) if water is None else np.isclose(sounding.water, water)
    assert sounding.depth[0] >= 1.0 - 1e-9


def test_a_gef_with_an_unknown_unit_of_its_water_is_refused_by_it(tmp_path):
    path = as_gef(tmp_path / "a.gef", log())
    path.write_text(path.read_text().replace("#EOH=", "#MEASUREMENTVAR= 14, 1.5, fathoms, water\n#EOH="))
    with pytest.raises(ValueError, match="water table is in 'fathoms'"):
        read_files([path])


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(d, p) for d in (";", "|", " ", "\t", ",") for p in (".", ",") if d != p]
)
@pytest.mark.parametrize("end", ["!", "", ";"])
def test_columns_of_a_gef_are_parted_by_what_parts_them(tmp_path, delimiter, decimal, end):
    path = as_gef(tmp_path / "a.gef", log())
    ((whole,), _), (head, body) = read_files([path]), path.read_text().split("#EOH=")
    head = "\n".join(line for line in head.splitlines() if "SEPARATOR" not in line)
    rows = [row.rstrip(";!").replace(";", delimiter).replace(".", decimal) + end for row in body.split("\n") if row]
    path.write_text("\n".join([head, "#EOH=", *rows, ""]))
    (sounding,), _ = read_files([path])
    alike(sounding, whole)


def test_a_gef_may_name_its_grid_as_the_epsg_does(tmp_path):
    paths = [
        as_gef(tmp_path / "a.gef", log(), code="31000"),
        as_gef(tmp_path / "b.gef", log(), x=155080.0, code="28992"),
    ]
    assert [sounding.projection for sounding in read_files(paths)[0]] == [RD, RD]


@pytest.mark.parametrize(("column", "scale"), [("sleeve", 1e3), ("sleeve", 1e-3), ("pore", 1e3)])
def test_sleeve_and_pore_pressure_in_another_unit_are_refused(tmp_path, column, scale):
    own = log()
    path = as_gef(tmp_path / "a.gef", replace(own, **{column: [scale * each for each in getattr(own, column)]}))
    with pytest.raises(ValueError, match=rf"has a {column} \w+ of .* times its cone resistance"):
        read_files([path])


def test_an_ags_file_that_lacks_units_or_a_location_is_refused_by_that(tmp_path, capsys):
    path = as_ags(tmp_path / "a.ags", log())
    text = path.read_text()
    path.write_text(text.replace('"UNIT"', '"UNITS"'))
    with pytest.raises(ValueError, match="has no row UNIT"):
        read_files([path])
    path.write_text(text.replace('"DATA","A","155020.0"', '"DATA","B","155020.0"'))
    with pytest.raises(ValueError, match="SCPT has readings at 'A', which LOCA lacks"):
        read_files([path])
    path.write_text(text[:-40])
    with pytest.raises(ValueError, match="is no AGS4 that python-AGS4 reads"):
        read_files([path])
    assert capsys.readouterr().out == ""
