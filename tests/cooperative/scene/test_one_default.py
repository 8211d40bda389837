"""What a scene may leave out has the default that it has in Python."""

import dataclasses
import inspect
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cooperative
import jaxmpm as mpm
import kl
from cooperative import Campaign, CampaignGrid, Hazard, Plan, RandomField, Run, Site, TwoPhase, estimate, measure
from cooperative.scene import parse, tables
from cooperative.scene._words import source_of_value
from cooperative.scene.tables import SceneTable, SlopeTable

OF_SOLVER = [
    (tables.InterfaceTable, mpm.Interface),
    (tables.CampaignGrid, mpm.Discretisation),
    (SlopeTable, mpm.Slope),
    (tables.GroundTable, mpm.Section),
    (tables.TerrainTable, mpm.Terrain),
    (tables.LayerTable, mpm.Layer),
    (tables.Run, mpm.Settle),
    *((tables.PlanAndEstimator, kind) for kind in estimate.ESTIMATORS.values()),
]
"""Tables of a scene, and the classes below campaigns whose fields their keys fill."""
REQUIRED = object()
STATED = "a scene states its soil and its slope; in Python those of the published slope stand for them"
KIND = "the table is of several kinds, and a scene is refused that lacks the key for its kind"
ON_PURPOSE = {
    **dict.fromkeys((("Slope", key) for key in ("crest", "height", "run_per_rise", "toe", "foundation")), STATED),
    ("Published", "k_t"): KIND,
    ("Discretisation", "fbar"): "None is False, and tells a scene that states False and so wants no average at all",
    ("Discretisation", "cfl"): "a campaign's is that of its run; an elastic block with free sides needs 0.5",
}  # fmt: skip


def default_of(kind, name):
    """Of a field of a dataclass, or of a key of a table; REQUIRED where there is none."""
    if hasattr(kind, "__pydantic_fields__"):
        field = tables.keys(kind)[name]
        if field.is_required():
            return REQUIRED
        whole = {key: each.examples[0] for key, each in tables.keys(kind).items() if each.is_required()}
        return getattr(tables.read(kind, whole), name)
    field = next(field for field in dataclasses.fields(kind) if field.name == name)
    return REQUIRED if field.default is dataclasses.MISSING else field.default


def test_the_solver_and_the_estimators_have_the_defaults_of_a_scene():
    differ = {
        (kind.__name__, field.name)
        for table, kind in OF_SOLVER
        for field in dataclasses.fields(kind)
        if field.name in tables.keys(table)
        if default_of(table, field.name) != default_of(kind, field.name)
    }
    assert differ == set(ON_PURPOSE)


def test_what_a_scene_leaves_out_of_its_soil_is_left_to_the_solver():
    keys = tables.keys(tables.SoilTable)
    assert {name for name, key in keys.items() if key.is_required()} == {"unit_weight", "young", "poisson"}
    with pytest.raises(ValueError, match="lacks young: add it"):  # which soil of every law but Cam Clay has
        parse(re.sub(r"young = \S+", "", LEAST))
    assert {name for name, key in keys.items() if not key.is_required() and key.default is not None} == {"unusual"}
    for name, value in {"residual_ratio": "0.5", "gap_memory": "true", "decay": '"linear"', "dilation": "0.0"}.items():
        assert keys[name].json_schema_extra["otherwise"] == f"`{value}`"


def test_softening_refers_to_the_same_band_at_both_doors():
    clay = mpm.Soil(19e3, 2e7, 0.4, strength=30e3, softening_modulus=85e3)
    text = LEAST.replace("poisson = 0.4", "poisson = 0.4, softening_modulus = 85e3")
    for length, band in (("", 1 / 5 * 6.0), (", softening_length = 2.5", 2.5), (', softening_length = "cell"', "cell")):
        soil = clay if not length else replace(clay, softening_length=band)
        campaign = in_python(soil, "strength", Site(mpm.Slope(12.0, 6.0, 1.0, 14.0, 2.0), "fixed"))
        scene = parse(text.replace("85e3", f"85e3{length}"))
        assert source_of_value(scene).beside == source_of_value(campaign).beside
        assert scene.soil.softening_length == band
        again = replace(campaign, name="again")
        assert again.soil == campaign.soil


BUILDERS = (mpm.slope, mpm.Slope.build, mpm.section, mpm.terrain, mpm.column, mpm.scene_of)


@pytest.mark.parametrize(
    ("builder", "argument", "table", "key"),
    [
        *((builder, "gravity", Run, "gravity") for builder in BUILDERS),
        (mpm.slope, "y_ends", SlopeTable, "y_ends"),
        (mpm.Slope.build, "ends", SlopeTable, "y_ends"),
        (mpm.section, "ends", tables.GroundTable, "ends"),
        (mpm.terrain, "ends", tables.TerrainTable, "ends"),
    ],
)
def test_builders_have_the_defaults_of_a_scene(builder, argument, table, key):
    assert inspect.signature(builder).parameters[argument].default == tables.keys(table)[key].default


OTHER_FACTS = {
    ("factor_of_safety", "failure_displacement"): "None is 1 m, and none by the limit load",
    ("factor_of_safety", "settle"): "None is the rule with its defaults",
    ("report", "slides"): "how many the report draws",
    ("replay", "every"): "a step that gradients go back to",
    ("solve", "every"): "time between snapshots (s)",
    ("solve_each", "every"): "time between snapshots (s)",
    ("block", "gravity"): "a block on a table is drawn without it, None",
    ("expand", "modes"): "how many terms an expansion has",
    ("monte_carlo", "samples"): "those that could run, without end in Python",
    ("Loads", "gravity"): "what a scene of the solver is built of: builders give it",
}
"""Arguments that are called as a key of a run or a campaign, and are something else."""
NO_PARTS = (Campaign, Site, mpm.Discretisation)
"""Their fields are compared above, or hold other objects than the keys of their names."""


def arguments():
    """Arguments with a default of all public functions and classes of the packages, but for tables of a scene."""
    seen = set()
    for module in (cooperative, measure, mpm, mpm.run, mpm.ground, mpm.setup, kl):
        for made in (getattr(module, name) for name in module.__all__):
            if not callable(made) or made in seen or made in NO_PARTS or hasattr(made, "__pydantic_fields__"):
                continue
            seen.add(made)
            try:
                signature = inspect.signature(made)
            except ValueError:  # of the C library
                continue
            for name, argument in signature.parameters.items():
                if argument.default is not inspect.Parameter.empty:
                    yield made.__name__, name, argument.default


def test_an_argument_that_is_called_as_a_key_has_its_default():
    keys = {name: default_of(table, name) for table in (Plan, Hazard, Run) for name in tables.keys(table)}
    differ = {(of, name) for of, name, default in arguments() if name in keys and default != keys[name]}
    assert differ == OTHER_FACTS.keys()


@given(
    height=st.integers(4, 12), steep=st.sampled_from([0.5, 1.0, 2.0]), foundation=st.integers(1, 8), far=st.floats(1, 9)
)
def test_the_front_of_a_run_out_is_as_thick_in_python_as_in_a_campaign(height, steep, foundation, far):
    clay = mpm.Soil(19e3, 2e7, 0.4, strength=30e3)
    slope = mpm.Slope(12.0, float(height), steep, 14.0, float(foundation))
    campaign = in_python(clay, "strength", Site(slope, "fixed"))
    x, z = (np.ravel(part) for part in np.meshgrid(np.arange(0.25, slope.length, 0.5), np.arange(0.25, 25, 0.5)))
    position = np.stack([x, z])[:, z < slope.heights(x)]
    # Soil at the toe moves the farther the higher it lies, so that the front is a wedge.
    moved = np.stack([far * np.maximum(position[1] - slope.foundation, 0.0), 0 * position[0]])
    run = position, moved, np.full(position.shape[1], 0.25), slope.face
    half = np.full(2, 0.25)
    of_campaign = measure.consequences(*run, half_size=half, runout_thickness=campaign.runout_thickness)
    assert measure.consequences(*run, half_size=half).runout == of_campaign.runout


def test_parts_of_a_campaign_are_the_tables_of_a_scene():
    for name, kind in {
        "run": Run,
        "rough": CampaignGrid,
        "coarse": CampaignGrid,
        "hazard": Hazard,
        "strength": RandomField,
    }.items():
        assert tables.table_in(tables.keys(SceneTable)[name]) is kind
    assert issubclass(tables.table_in(tables.keys(SceneTable)["campaign"]), Plan)
    assert (
        tables.PlanAndEstimator(20).chosen == TwoPhase() == inspect.signature(Campaign).parameters["estimator"].default
    )


PARTS = {
    Run: {},
    Hazard: {},
    Plan: {"samples": 20},
    tables.InclinedStrata: {"dip": 15.0},
    CampaignGrid: {"cell": 2.0, "spacing": (1.0, 1.0)},
    RandomField: {"mean": 30e3, "cov": 0.2, "length": (20.0, 4.0)},
    tables.CrossCorrelation: {"parameters": ("a", "b"), "matrix": ((1.0, 0.2), (0.2, 1.0))},
}
NAMES = [(kind, name) for kind in PARTS for name in tables.keys(kind)]
VALUES = st.one_of(
    st.text(), st.booleans(), st.none(), st.floats(), st.integers(), st.lists(st.floats()), st.just({"dip": "steep"})
)


@given(st.sampled_from(NAMES), VALUES)
def test_a_value_is_taken_or_refused_in_the_same_words_at_both_doors(name_of, value):
    kind, name = name_of

    def outcome(make):
        try:
            return make()
        except ValueError as error:
            return str(error)

    values = PARTS[kind] | {name: value}
    assert outcome(lambda: kind(**values)) == outcome(lambda: tables.read(kind, values))


LEAST = """
slope = { crest = 12, height = 6, run_per_rise = 1, toe = 14, foundation = 2 }
soil = { unit_weight = 19e3, young = 2e7, poisson = 0.4 }
strength = { mean = 30e3, cov = 0.2, length = [20.0, 4.0] }
rough = { cell = 2.0, spacing = [1.0, 1.0] }
refined = { cell = 1.0, spacing = [0.5, 0.5] }
campaign = { samples = 20 }
"""
DRAWN = """
ground = { surface = [[0, 8], [12, 8], [18, 2], [32, 2]], toe = 18.0, interface = { friction = 20.0 } }
rough = { cell = 2.0, spacing = [1.0, 1.0] }
refined = { cell = 1.0, spacing = [0.5, 0.5] }
campaign = { samples = 20 }
[hazard]
[soil]
unit_weight = 19e3
young = 2e7
poisson = 0.4
friction = 30.0
cohesion = { mean = 5e3, cov = 0.2, length = [20.0, 4.0] }
"""


def in_python(soil, name, ground, **more):
    random = {name: RandomField(getattr(soil, name), 0.2, (20.0, 4.0))}
    rough, refined = (CampaignGrid(cell, (cell / 2, cell / 2)) for cell in (2.0, 1.0))
    return Campaign(ground=ground, soil=soil, random=random, rough=rough, refined=refined, plan=Plan(20), **more)


def test_a_scene_of_required_keys_alone_is_the_campaign_of_required_arguments_alone():
    clay = mpm.Soil(19e3, 2e7, 0.4, strength=30e3)
    sand = mpm.FrictionalSoil(5e3, 30.0, unit_weight=19e3, young=2e7, poisson=0.4)
    drawn = mpm.Section(((0.0, 8.0), (12.0, 8.0), (18.0, 2.0), (32.0, 2.0)), toe=18.0, interface=mpm.Interface(20.0))
    for text, campaign in (
        (LEAST, in_python(clay, "strength", Site(mpm.Slope(12.0, 6.0, 1.0, 14.0, 2.0), "fixed"))),
        (DRAWN, in_python(sand, "cohesion", Site(drawn, "roller"), hazard=Hazard())),
    ):
        assert source_of_value(parse(text)).beside == source_of_value(campaign).beside
        assert {grid.cfl for grid in campaign.grids.values()} == {0.9}
