"""Scenes: TOML in, one checked and immutable campaign out."""

from cooperative.scene._campaign import Campaign, check_cells, check_samples
from cooperative.scene._faults import check_scene
from cooperative.scene._files import Files, to_toml, toml_value
from cooperative.scene._in_folder import (
    campaign_of,
    in_folder,
    keep,
    kept,
    read,
    settled,
    stored_measured,
    with_measured,
)
from cooperative.scene._measured import (
    doubts,
    factors_of_safety,
    failing_volume,
    limit_load_factor,
    measure,
    measure_limit_load,
)
from cooperative.scene._page import SEVERAL, TABLES, json_schema, markdown
from cooperative.scene._projection import compare_projections
from cooperative.scene._region import national_origin
from cooperative.scene._remarks import remarks
from cooperative.scene._site import Site, SiteLayer
from cooperative.scene._typed import built, parse, read_scene, rested, source_of
from cooperative.scene._variants import BASE, RANKED, Variant, campaigns_of, variants, with_measured_of_base
from cooperative.scene._varied import SCALES, SCENARIO, changed
from cooperative.scene.tables import (
    CONDUCTIVITY,
    CONTACT,
    TAIL,
    Budget,
    Calibration,
    CampaignGrid,
    CrossCorrelation,
    Drawdown,
    Exposed,
    FromScript,
    Hazard,
    HydraulicLayer,
    Hydraulics,
    InclinedStrata,
    LimitLoad,
    LongerSlides,
    Measured,
    Motion,
    Plan,
    Rain,
    RandomConductivity,
    RandomField,
    RandomLevel,
    Run,
    Water,
)
