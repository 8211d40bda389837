"""The tables of a scene, each declared once: type, unit, range, default, meaning and example of every key."""

from cooperative.scene.tables._campaign import Campaign, Grid, Run, Sweep
from cooperative.scene.tables._ground import Ground, Terrain
from cooperative.scene.tables._hazard import Hazard
from cooperative.scene.tables._key import EXTRAS, Table
from cooperative.scene.tables._motion import UNITS as ACCELERATIONS
from cooperative.scene.tables._motion import Motion
from cooperative.scene.tables._reading import Schema, first_entry, parts, read, schema_of, table_in, wanted
from cooperative.scene.tables._scene import STORED, Scene
from cooperative.scene.tables._soil import OF_A_FIELD, Layer, Soil, Varying
from cooperative.scene.tables._stored import MOST_RUNS, Budget, Calibration, FieldModes, LimitLoad, Measured

__all__ = [
    "ACCELERATIONS",
    "EXTRAS",
    "MOST_RUNS",
    "OF_A_FIELD",
    "STORED",
    "Budget",
    "Calibration",
    "Campaign",
    "FieldModes",
    "Grid",
    "Ground",
    "Hazard",
    "Layer",
    "LimitLoad",
    "Measured",
    "Motion",
    "Run",
    "Scene",
    "Schema",
    "Soil",
    "Sweep",
    "Table",
    "Terrain",
    "Varying",
    "first_entry",
    "parts",
    "read",
    "schema_of",
    "table_in",
    "wanted",
]
