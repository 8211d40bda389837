"""The tables of a scene, each declared once: type, unit, range, default, meaning and example of every key."""

from cooperative.scene.tables._campaign import Grid, Plan, PlanAndEstimator
from cooperative.scene.tables._ground import Ground, Interface, Terrain, Water
from cooperative.scene.tables._hazard import Exposed, Hazard
from cooperative.scene.tables._key import EXTRAS, FromScript, Part, Table, keys, table
from cooperative.scene.tables._level import RandomLevel
from cooperative.scene.tables._motion import AXES, Motion
from cooperative.scene.tables._motion import UNITS as ACCELERATIONS
from cooperative.scene.tables._reading import Keyed, Schema, first_entry, parts, read, schema_of, table_in, wanted
from cooperative.scene.tables._run import CFL, Run
from cooperative.scene.tables._scene import SITES, STORED, Scene
from cooperative.scene.tables._seepage import Drawdown, HydraulicLayer, Hydraulics, Rain, Seepage
from cooperative.scene.tables._soil import OF_A_FIELD, Layer, Soil
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
    "CFL",
    "CONTACT",
    "CORRELATIONS",
    "EXTRAS",
    "LIMITS",
    "MARGINALS",
    "MOST_RUNS",
    "OF_A_FIELD",
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
    "Keyed",
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
    "Soil",
    "Span",
    "Sweep",
    "Table",
    "Terrain",
    "Water",
    "check_cross_correlation",
    "first_entry",
    "keys",
    "parts",
    "read",
    "schema_of",
    "table",
    "table_in",
    "wanted",
]
