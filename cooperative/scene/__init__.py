"""Scenes: TOML in, one checked and immutable campaign out."""

from cooperative.scene._budget import allowing, kept_budget, raised, write_budget
from cooperative.scene._calibration import calibrated, campaign_of, kept, measured
from cooperative.scene._defaults import with_defaults
from cooperative.scene._examples import example, examples
from cooperative.scene._schema import REQUIRED, SECTIONS, UNSAID, Key
from cooperative.scene._text import read_scene, tables_of
from cooperative.scene._typed import Budget, Campaign, Plan, Strength, built, parse

__all__ = [
    "REQUIRED",
    "SECTIONS",
    "UNSAID",
    "Budget",
    "Campaign",
    "Key",
    "Plan",
    "Strength",
    "allowing",
    "built",
    "calibrated",
    "campaign_of",
    "example",
    "examples",
    "kept",
    "kept_budget",
    "measured",
    "parse",
    "raised",
    "read_scene",
    "tables_of",
    "with_defaults",
    "write_budget",
]
