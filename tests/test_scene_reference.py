"""docs/scenes.md and the JSON schema say what the checks do: every key, its example, its default, its range."""

import tomllib
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from benchmarks.invented import LAYERED, TERRAIN
from cooperative import reference, sweep
from cooperative.estimate import MonteCarlo, Sampling, Subset, TwoPhase
from cooperative.reference import KEYS as TABLES
from cooperative.reference import MEANINGS, SEVERAL, json_schema, markdown
from cooperative.scene import LISTS, REQUIRED, SECTIONS, UNSAID, built, examples, parse
from cooperative.scene._soil import OF_FRICTION
from cooperative.sweep import to_toml
from tests.test_campaign import TINY

ROOT = Path(__file__).resolve().parent.parent
KEYS = [(section, name) for section, keys in TABLES.items() for name in keys]
BOUNDED = [(s, n) for s, n in KEYS if s in SECTIONS and MEANINGS[s][n].range()]


def in_toml(tables):
    return to_toml(tables)


def properties(section):
    """The schema of a table's keys."""
    table = schema().schema["properties"][section]
    return (table["items"] if section in SEVERAL else table)["properties"]


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
    if section in LISTS:
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


def outside(meaning):
    """Values just outside the range."""
    found = [end for end in (meaning.above, meaning.below) if end is not None]
    found += [meaning.least - 1] if meaning.least is not None else []
    return found + ([meaning.most + 1] if meaning.most is not None else [])


@cache
def schema():
    """The schema of a scene, itself found sound once."""
    jsonschema.Draft202012Validator.check_schema(json_schema())
    return jsonschema.Draft202012Validator(json_schema())


def test_the_files_are_those_that_the_checks_make(tmp_path):
    for folder in ("docs", "cooperative"):
        (tmp_path / folder).mkdir()
    reference.write(tmp_path)
    for name in ("docs/scenes.md", "cooperative/scene.schema.json"):
        assert (ROOT / name).read_text() == (tmp_path / name).read_text(), "run python -m cooperative.reference"


def test_every_key_is_explained_and_no_other():
    assert {section: set(keys) for section, keys in TABLES.items()} == {s: set(m) for s, m in MEANINGS.items()}
    assert all(f"| `{name}` |" in markdown() for _, name in KEYS)


def test_no_cell_of_the_page_is_empty():
    rows = [line for line in markdown().splitlines() if line.startswith("| `")]
    assert len(rows) > 100
    for row in rows:
        assert [cell.strip() for cell in row.strip("|").split("|")].count("") == 0, row
        assert row.count("|") == 7


def test_defaults_in_words_stand_where_there_is_no_value_and_the_rest_of_a_scene_decides():
    for section, name in KEYS:
        default, words = TABLES[section][name].default, MEANINGS[section][name].default
        assert (default in (UNSAID, None)) or not words or section == "layer", f"[{section}] {name}"
        assert words or default is not UNSAID, f"[{section}] {name}"


def test_defaults_in_words_are_those_of_the_code():
    told = {name: meaning.default for name, meaning in MEANINGS["campaign"].items()}
    plan = Subset().plan(Sampling(800, 1.0))
    assert (told["levels"], told["replicates"]) == (f"`{plan.levels}`", f"`{plan.replicates}`")
    assert [TwoPhase().budget(samples) for samples in (50, 1000)] == [20, 200]
    assert TwoPhase(target_cov=0.1).budget(1000) == MonteCarlo().budget(1000) == 1000
    assert all(part in told["refined_runs"] for part in ("a fifth", "at least 20", "`target_cov`", '`"monte carlo"`'))
    plain = tomllib.loads(TINY)
    assert "softening_length" not in plain["soil"]
    campaign = parse(TINY)
    assert campaign.soil.softening_length == pytest.approx(plain["slope"]["height"] / 5)
    finest = {**plain, "rough": {**plain["rough"], "cell": 0.25, "spacing": [0.125, 0.125]}}
    averaged = parse(in_toml(finest)).grids["rough"].internal_length
    assert averaged == pytest.approx(0.4 * campaign.soil.softening_length, rel=0.01)
    assert campaign.plan.slides is None
    assert campaign.grids["rough"].fbar
    assert not parse(in_toml(tiny_with("soil", "dilation", 0.0))).grids["rough"].fbar


@pytest.mark.parametrize(("section", "name"), KEYS)
def test_examples_and_defaults_are_of_the_schema(section, name):
    known = properties(section)[name]
    values = [tomllib.loads(f"x = {MEANINGS[section][name].example}")["x"]]
    if TABLES[section][name].default not in (REQUIRED, UNSAID, None):
        values.append(TABLES[section][name].default)
    assert [value for value in values if not jsonschema.Draft202012Validator(known).is_valid(value)] == []


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
    key = SECTIONS[section][name]
    for value in outside(MEANINGS[section][name]):
        number = [value] * 2 if key.kind is tuple else key.kind(value)
        tables = tiny_with(section, name, number)
        with pytest.raises(jsonschema.ValidationError):
            schema().validate(tables)
        with pytest.raises(ValueError, match=name.replace("_", ".").split(".")[0]):
            built(parse(in_toml(tables)), "refined" if section == "refined" else "rough")


SWEPT = {"lx": [20, 0], "ly": [4.0, -1.0], "lz": [2, -4], "cov": [0.3, -0.1], "k_t": [1, 0]}


def test_keys_of_a_sweep_are_those_that_it_takes():
    assert set(TABLES["sweep"]) == set(sweep.LABELS) == set(SWEPT)


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
    assert [parse(part.text) for part in sweep.variants(in_toml(tables | {"sweep": {name: [good]}}))]
    for values in others:
        swept = tables | {"sweep": {name: values}}
        assert not schema().is_valid(swept)
        with pytest.raises(ValueError, match=r"\[sweep\]|length of axis|cov"):
            [parse(part.text) for part in sweep.variants(in_toml(swept))]


def test_an_empty_sweep_is_refused():
    assert not schema().is_valid(tomllib.loads(TINY) | {"sweep": {}})
    with pytest.raises(ValueError, match="no table"):
        sweep.variants(TINY + "[sweep]\n")
