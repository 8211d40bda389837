"""Scenes: TOML in, one checked and immutable campaign out."""

from cooperative.scene._budget import allowing, kept_budget, raised, write_budget
from cooperative.scene._calibration import calibrated, campaign_of, kept, measured
from cooperative.scene._campaign import Budget, Campaign, Plan
from cooperative.scene._defaults import with_defaults
from cooperative.scene._examples import NAMED, SCHEMA, begin, example, examples, starters, write_example
from cooperative.scene._field_modes import keep_field_modes, with_kept_field_modes
from cooperative.scene._hazard import EXPOSED, HAZARD, Hazard
from cooperative.scene._limit_load import at_limit_load, measured_limit_load
from cooperative.scene._schema import (
    LINE,
    LISTS,
    NAMES,
    OPTIONAL,
    RASTER,
    REQUIRED,
    ROWS,
    SECTIONS,
    SITES,
    UNSAID,
    Key,
    Table,
)
from cooperative.scene._site import Site, SiteLayer
from cooperative.scene._soil import PARAMETERS, TAIL, CrossCorrelation, RandomField, gaussian_root, steepest
from cooperative.scene._text import read_scene, tables_of
from cooperative.scene._typed import built, parse

__all__ = [
    "EXPOSED",
    "HAZARD",
    "LINE",
    "LISTS",
    "NAMED",
    "NAMES",
    "OPTIONAL",
    "PARAMETERS",
    "RASTER",
    "REQUIRED",
    "ROWS",
    "SCHEMA",
    "SECTIONS",
    "SITES",
    "TAIL",
    "UNSAID",
    "Budget",
    "Campaign",
    "CrossCorrelation",
    "Hazard",
    "Key",
    "Plan",
    "RandomField",
    "Site",
    "SiteLayer",
    "Table",
    "allowing",
    "at_limit_load",
    "begin",
    "built",
    "calibrated",
    "campaign_of",
    "example",
    "examples",
    "gaussian_root",
    "keep_field_modes",
    "kept",
    "kept_budget",
    "measured",
    "measured_limit_load",
    "parse",
    "raised",
    "read_scene",
    "starters",
    "steepest",
    "tables_of",
    "with_defaults",
    "with_kept_field_modes",
    "write_budget",
    "write_example",
]
