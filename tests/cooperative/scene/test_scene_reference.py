"""docs/scenes.md and the JSON schema say what the checks do: every key, its example, its default, its range."""

import json
import tomllib
from functools import cache

import jsonschema
import pytest
from pydantic import TypeAdapter, ValidationError

from benchmarks.robustness.invented import LAYERED, TERRAIN
from cooperative.estimate import MonteCarlo, Sampling, Subset, TwoPhase
from cooperative.example_scenes import examples
from cooperative.scene import SEVERAL, TABLES, built, json_schema, markdown, parse, to_toml
from cooperative.scene._page import write
from cooperative.scene.tables import schema_of
from cooperative.scene.tables._soil import KEYS as OF_KIND
from cooperative.tools import sweep
from jaxmpm import FrictionalSoil, Soil
from jaxmpm.soil import soil_limits
from tests import ROOT
from tests.cooperative.campaign.test_campaign import TINY

OF_FRICTION = {*OF_KIND[FrictionalSoil]} - {*OF_KIND[Soil]}
KEYS = [(section, name) for section, table in TABLES.items() for name in schema_of(table)["properties"]]


def declared(section, name):
    """What a table declares of a key, as JSON schema and in the words of the page."""
    return schema_of(TABLES[section])["properties"][name]


def number(known):
    """The schema of the number that a key holds, or each of several; empty where it holds none."""
    known = known.get("items", (known.get("anyOf") or known.get("oneOf") or [known])[0])
    return known if known.get("type") in ("number", "integer") else {}


ENDS = ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum")
BOUNDED = [
    (section, name)
    for section, name in KEYS
    if section not in ("exposed", "sweep") and any(end in number(declared(section, name)) for end in ENDS)
]


def in_toml(tables):
    return to_toml(tables)


def properties(section):
    """The schema of a table's keys."""
    whole = schema().schema
    entry = whole["properties"][section]
    entry = (
        entry["items"]
        if section in SEVERAL
        else next((part for part in entry.get("oneOf", ()) if "$ref" in part), entry)
    )
    name = entry["$ref"].rpartition("/")[2]
    return whole["$defs"][name]["properties"]


def tiny_with(section, name, value):
    """The tiny scene with one key changed, and with what must be there for that key to have a say."""
    drawn = {"ground": LAYERED, "layer": LAYERED, "water": LAYERED, "terrain": TERRAIN}
    tables = tomllib.loads(drawn.get(section, TINY))
    if name in ("levels", "replicates"):
        tables["campaign"] |= {"estimator": "subset", "samples": 160}
        tables["campaign"].pop("k_t")
    if name in ("refined_runs", "target_cov"):
        tables["campaign"] |= {"estimator": "two-phase", "samples": 20}
        tables["campaign"].pop("k_t")
    if name in ("strain_95", "softening_modulus"):
        tables["soil"].pop("softening_modulus")
    if name == "reference_rate":
        tables["soil"]["rate_coefficient"] = 0.1
    if section == "layer":
        frictional = name in (*OF_FRICTION, "residual_cohesion")
        if frictional:
            del tables["strength"], tables["soil"]["softening_modulus"], tables["soil"]["residual_ratio"]
            tables["soil"] |= {"cohesion": {"mean": 5e3, "cov": 0.3, "length": [20.0, 4.0]}, "friction": 30.0}
        tables[section] = [{"depth": 1.0}, {}]
        for other in {"depth", "thickness"} if name in ("depth", "thickness") else ():
            tables[section][0].pop(other, None)
        tables[section][0][name] = value
        return tables
    if section == "soil" and name in OF_FRICTION:
        del tables["strength"], tables["soil"]["softening_modulus"], tables["soil"]["residual_ratio"]
        field = {"mean": 5e3, "cov": 0.3, "length": [20.0, 4.0]}
        tables["soil"] |= {"cohesion": field, "friction": 30.0, "softening_strain": 0.2}
    if (section, name) == ("soil", "strength"):
        del tables["strength"]
    tables.setdefault(section, {})[name] = value
    return tables


def outside(known):
    """Values just outside the range."""
    known = number(known)
    limits = [known[end] for end in ("exclusiveMinimum", "exclusiveMaximum") if end in known]
    return limits + [known[end] + step for end, step in (("minimum", -1), ("maximum", 1)) if end in known]


@cache
def schema():
    """The schema of a scene, itself checked once."""
    jsonschema.Draft202012Validator.check_schema(json_schema())
    return jsonschema.Draft202012Validator(json_schema())


def test_the_files_are_those_that_the_checks_make(tmp_path):
    for folder in ("docs", "cooperative"):
        (tmp_path / folder).mkdir()
    write(tmp_path)
    page, editors = "docs/scenes.md", "cooperative/scene.schema.json"
    assert (ROOT / page).read_text() == (tmp_path / page).read_text(), "run python -m cooperative.scene"
    # Versions of pydantic write 0 and 0.0.
    stored, made = (json.loads((folder / editors).read_text()) for folder in (ROOT, tmp_path))
    assert stored == made, "run python -m cooperative.scene"


def test_every_key_is_explained():
    assert all(declared(section, name)["description"] for section, name in KEYS)
    assert all(f"| `{name}` |" in markdown() for _, name in KEYS)


def test_limits_of_the_soil_are_those_that_its_parameters_declare():
    for table in ("soil", "layer"):
        for name, limit in soil_limits().items():
            known = number(declared(table, name))
            assert [known.get(end) for end in ENDS] == [limit.above, limit.least, limit.below, limit.most]
            assert known.get("unit", "") == limit.unit


def test_no_cell_of_the_page_is_empty():
    rows = [line for line in markdown().splitlines() if line.startswith("| `")]
    assert len(rows) > 100
    for row in rows:
        assert [cell.strip() for cell in row.strip("|").split("|")].count("") == 0, row
        assert row.count("|") == 7


def test_defaults_in_words_stand_where_there_is_no_value():
    for section, name in KEYS:
        known = declared(section, name)
        assert not ("otherwise" in known and "default" in known), f"[{section}] {name}"


def test_defaults_in_words_are_those_of_the_code():
    defaults = {name: known.get("otherwise", "") for name, known in schema_of(TABLES["campaign"])["properties"].items()}
    plan = Subset().plan(Sampling(800, 1.0))
    assert (defaults["levels"], defaults["replicates"]) == (f"`{plan.levels}`", f"`{plan.replicates}`")
    assert [TwoPhase().budget(samples) for samples in (50, 1000)] == [20, 200]
    assert TwoPhase(target_cov=0.1).budget(1000) == MonteCarlo().budget(1000) == 1000
    parts = ("a fifth", "at least 20", "`target_cov`", '`"monte carlo"`')
    assert all(part in defaults["refined_runs"] for part in parts)
    plain = tomllib.loads(TINY)
    assert "softening_length" not in plain["soil"]
    campaign = parse(TINY)
    assert campaign.soil.softening_length == pytest.approx(plain["slope"]["height"] / 5)
    finest = plain | {grid: plain[grid] | {"cell": 0.25, "spacing": [0.125, 0.125]} for grid in ("rough", "refined")}
    averaged = parse(in_toml(finest)).grids["rough"].internal_length
    assert averaged == pytest.approx(0.4 * campaign.soil.softening_length, rel=0.01)
    assert campaign.plan.slides is None
    assert campaign.grids["rough"].cell_average


@pytest.mark.parametrize(("section", "name"), KEYS)
def test_examples_and_defaults_are_of_the_schema(section, name):
    known, others = properties(section)[name], {"$defs": schema().schema["$defs"]}
    values = [*known["examples"], *([known["default"]] if "default" in known else [])]
    assert [value for value in values if not jsonschema.Draft202012Validator(known | others).is_valid(value)] == []


@pytest.mark.parametrize(("section", "name"), [key for key in KEYS if key[0] not in ("exposed", "sweep")])
def test_examples_are_read(section, name):
    """An example may not go with the rest of a scene, but its own table takes it."""
    value = tomllib.loads(to_toml({"x": declared(section, name)["examples"][0]}))["x"]
    faults = []
    try:
        TypeAdapter(TABLES[section]).validate_python({name: value})
    except ValidationError as error:
        faults = [each for each in error.errors() if each["type"] != "missing"]
    assert faults == []


@pytest.mark.parametrize("name", examples())
def test_scenes_that_ship_follow_the_schema(name):
    scene = tomllib.loads(examples()[name].read_text())
    assert [error.message for error in schema().iter_errors(scene)] == []


def test_the_schema_refuses_what_the_checks_refuse():
    for tables in ({}, tiny_with("soil", "yuong", 1e8), tiny_with("soil", "young", "stiff")):
        with pytest.raises(jsonschema.ValidationError):
            schema().validate(tables)
        with pytest.raises(ValueError, match=r"lacks|unknown key|is text"):
            parse(in_toml(tables))


@pytest.mark.parametrize(("section", "name"), BOUNDED)
def test_ranges_are_those_of_the_checks(section, name):
    known = declared(section, name)
    for value in outside(known):
        each = int(value) if number(known)["type"] == "integer" else float(value)
        tables = tiny_with(section, name, [each] * 2 if known.get("type") == "array" else each)
        with pytest.raises(jsonschema.ValidationError):
            schema().validate(tables)
        with pytest.raises(ValueError, match=name.replace("_", ".").split(".")[0]):
            built(parse(in_toml(tables)), "refined" if section == "refined" else "rough")


SWEPT = {"lx": [20, 0], "ly": [4.0, -1.0], "lz": [2, -4], "cov": [0.3, -0.1], "k_t": [1, 0]}


def test_keys_of_a_sweep_are_those_that_it_takes():
    assert set(schema_of(TABLES["sweep"])["properties"]) == set(sweep.LABELS) == set(SWEPT)


@pytest.mark.parametrize("name", SWEPT)
def test_ranges_of_a_sweep_are_those_of_the_checks(name):
    tables = tomllib.loads(TINY)
    if name == "ly":
        tables["slope"]["width"] = 8.0
        tables["strength"]["length"] = [20.0, 20.0, 4.0]
        for grid in ("rough", "refined"):
            tables[grid]["spacing"] *= 2
            tables[grid]["spacing"] = tables[grid]["spacing"][:3]
    good, bad = SWEPT[name]
    others = [[good, bad], [good, good], [], good]
    assert schema().is_valid(tables | {"sweep": {name: [good]}})
    assert [parse(part.source) for part in sweep.variants(in_toml(tables | {"sweep": {name: [good]}}))]
    for values in others:
        swept = tables | {"sweep": {name: values}}
        assert not schema().is_valid(swept)
        with pytest.raises(ValueError, match=r"\[sweep\]|length of axis|cov"):
            [parse(part.source) for part in sweep.variants(in_toml(swept))]


def test_an_empty_sweep_is_refused():
    assert not schema().is_valid(tomllib.loads(TINY) | {"sweep": {}})
    with pytest.raises(ValueError, match="no table"):
        sweep.variants(TINY + "[sweep]\n")
