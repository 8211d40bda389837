"""The tables of a scene, each declared once: type, unit, range, default, meaning and example of every key."""

from cooperative.scene.tables._campaign import Grid, Plan, PlanAndEstimator
from cooperative.scene.tables._ground import Ground, Interface, Slope, Surface, Terrain, Water
from cooperative.scene.tables._hazard import Exposed, Hazard
from cooperative.scene.tables._key import EXTRAS, FromScript, Part, keys, made, table
from cooperative.scene.tables._level import RandomLevel
from cooperative.scene.tables._motion import AXES, Motion
from cooperative.scene.tables._motion import UNITS as ACCELERATIONS
from cooperative.scene.tables._reading import (
    Schema,
    first_entry,
    in_words,
    parts,
    read,
    schema_of,
    table_in,
    wanted,
)
from cooperative.scene.tables._run import Run
from cooperative.scene.tables._scene import SITES, STORED, Scene
from cooperative.scene.tables._seepage import Drawdown, HydraulicLayer, Hydraulics, Rain, Seepage
from cooperative.scene.tables._soil import Layer, Soil, is_frictional
from cooperative.scene.tables._stored import MOST_RUNS, Budget, Calibration, LimitLoad, LongerSlides, Measured
from cooperative.scene.tables._sweep import RECORDS, Scenario, Sweep
from cooperative.scene.tables._varying import (
    CONTACT,
    CORRELATIONS,
    LIMITS,
    MARGINALS,
    TAIL,
    Bedding,
    CrossCorrelation,
    RandomField,
    Span,
    check_cross_correlation,
)

__all__ = [
    "ACCELERATIONS",
    "AXES",
    "CONTACT",
    "CORRELATIONS",
    "EXTRAS",
    "LIMITS",
    "MARGINALS",
    "MOST_RUNS",
    "RECORDS",
    "SITES",
    "STORED",
    "TAIL",
    "Bedding",
    "Budget",
    "Calibration",
    "CrossCorrelation",
    "Drawdown",
    "Exposed",
    "FromScript",
    "Grid",
    "Ground",
    "Hazard",
    "HydraulicLayer",
    "Hydraulics",
    "Interface",
    "Layer",
    "LimitLoad",
    "LongerSlides",
    "Measured",
    "Motion",
    "Part",
    "Plan",
    "PlanAndEstimator",
    "Rain",
    "RandomField",
    "RandomLevel",
    "Run",
    "Scenario",
    "Scene",
    "Schema",
    "Seepage",
    "Slope",
    "Soil",
    "Span",
    "Surface",
    "Sweep",
    "Terrain",
    "Water",
    "check_cross_correlation",
    "first_entry",
    "in_words",
    "is_frictional",
    "keys",
    "made",
    "parts",
    "read",
    "schema_of",
    "table",
    "table_in",
    "wanted",
]
