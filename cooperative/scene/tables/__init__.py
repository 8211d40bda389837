"""The tables of a scene, each declared once: type, unit, range, default, meaning and example of every key."""

from cooperative.scene.tables._campaign import Campaign, Grid, Run
from cooperative.scene.tables._ground import Ground, Interface, Terrain, Water
from cooperative.scene.tables._hazard import Hazard
from cooperative.scene.tables._key import EXTRAS, Table, of_features
from cooperative.scene.tables._level import RandomLevel
from cooperative.scene.tables._motion import UNITS as ACCELERATIONS
from cooperative.scene.tables._motion import Motion
from cooperative.scene.tables._reading import Keyed, Schema, first_entry, parts, read, schema_of, table_in, wanted
from cooperative.scene.tables._scene import SITES, STORED, Scene
from cooperative.scene.tables._soil import OF_A_FIELD, Layer, Soil
from cooperative.scene.tables._stored import MOST_RUNS, Budget, Calibration, LimitLoad, LongerSlides, Measured
from cooperative.scene.tables._sweep import RECORDS, Scenario, Sweep, flat
from cooperative.scene.tables._varying import CORRELATIONS, MARGINALS, Varying

__all__ = [
    "ACCELERATIONS",
    "CORRELATIONS",
    "EXTRAS",
    "MARGINALS",
    "MOST_RUNS",
    "OF_A_FIELD",
    "RECORDS",
    "SITES",
    "STORED",
    "Budget",
    "Calibration",
    "Campaign",
    "Grid",
    "Ground",
    "Hazard",
    "Interface",
    "Keyed",
    "Layer",
    "LimitLoad",
    "LongerSlides",
    "Measured",
    "Motion",
    "RandomLevel",
    "Run",
    "Scenario",
    "Scene",
    "Schema",
    "Soil",
    "Sweep",
    "Table",
    "Terrain",
    "Varying",
    "Water",
    "first_entry",
    "flat",
    "of_features",
    "parts",
    "read",
    "schema_of",
    "table_in",
    "wanted",
]
