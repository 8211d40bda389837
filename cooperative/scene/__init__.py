"""Scenes: TOML in, one checked and immutable campaign out."""

from cooperative.scene._campaign import Campaign, Given, Hazard, Plan, check_samples
from cooperative.scene._examples import NAMED, SCHEMA, begin, example, examples, starters, write_example
from cooperative.scene._fields import CONTACT, CrossCorrelation, RandomField, TAIL
from cooperative.scene._files import Files, to_toml, toml_value
from cooperative.scene._measured import (
    doubts,
    factors_of_safety,
    failing_volume,
    limit_load_factor,
    measure,
    measure_limit_load,
    write_measured,
)
from cooperative.scene._page import SEVERAL, TABLES, json_schema, markdown
from cooperative.scene._projection import compare_projections
from cooperative.scene._region import national_origin
from cooperative.scene._remarks import remarks
from cooperative.scene._site import Site, SiteLayer, check_seams
from cooperative.scene._stored import (
    campaign_of,
    in_folder,
    read,
    settled,
    stored_budget,
    stored_measured,
    with_measured,
    write_budget,
    write_slides_end,
)
from cooperative.scene._typed import built, parse, read_scene
from cooperative.scene._variants import BASE, RANKED, Variant, campaigns_of, variants, with_measured_of_base
from cooperative.scene._varied import SCALES, SCENARIO, changed
from cooperative.scene.tables import (
    CONTACT,
    TAIL,
    Bedding,
    Budget,
    Calibration,
    CrossCorrelation,
    Exposed,
    Grid,
    Hazard,
    LimitLoad,
    Measured,
    Motion,
    Plan,
    RandomField,
    Run,
)

__all__ = [
    "BASE",
    "CONTACT",
    "RANKED",
    "SCALES",
    "SCENARIO",
    "SEVERAL",
    "TABLES",
    "TAIL",
    "Bedding",
    "Budget",
    "Calibration",
    "Campaign",
    "CrossCorrelation",
    "Exposed",
    "Files",
    "Given",
    "Grid",
    "Hazard",
    "LimitLoad",
    "Measured",
    "Motion",
    "Plan",
    "RandomField",
    "Run",
    "Site",
    "SiteLayer",
    "Variant",
    "built",
    "campaign_of",
    "campaigns_of",
    "changed",
    "check_samples",
    "check_seams",
    "compare_projections",
    "doubts",
    "factors_of_safety",
    "failing_volume",
    "in_folder",
    "json_schema",
    "limit_load_factor",
    "markdown",
    "measure",
    "measure_limit_load",
    "national_origin",
    "parse",
    "read",
    "read_scene",
    "remarks",
    "settled",
    "stored_budget",
    "stored_measured",
    "to_toml",
    "toml_value",
    "variants",
    "with_measured",
    "with_measured_of_base",
    "write_budget",
    "write_measured",
    "write_slides_end",
]
