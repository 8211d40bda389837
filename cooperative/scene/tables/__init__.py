"""The tables of a scene, each declared once: type, unit, range, default, meaning and example of every key."""

from cooperative.scene.tables._campaign import CampaignGrid, Plan, PlanAndEstimator
from cooperative.scene.tables._ground import GroundTable, InterfaceTable, SlopeTable, Surface, TerrainTable, Water
from cooperative.scene.tables._hazard import Exposed, Hazard
from cooperative.scene.tables._key import EXTRAS, FromScript, Part, keys, made, table
from cooperative.scene.tables._level import RandomLevel
from cooperative.scene.tables._motion import AXES, Motion
from cooperative.scene.tables._motion import UNITS as ACCELERATIONS
from cooperative.scene.tables._reading import (
    Schema,
    allowed_values,
    first_entry,
    naming_keys,
    parts,
    read,
    schema_of,
    table_in,
)
from cooperative.scene.tables._run import Run
from cooperative.scene.tables._scene import SITES, SceneTable
from cooperative.scene.tables._seepage import Drawdown, HydraulicLayer, Hydraulics, Rain, RandomConductivity, Seepage
from cooperative.scene.tables._soil import LayerTable, SoilTable, has_strength, kind_of
from cooperative.scene.tables._stored import MOST_RUNS, Budget, Calibration, LimitLoad, LongerSlides, Measured
from cooperative.scene.tables._sweep import RECORDS, Scenario, Sweep
from cooperative.scene.tables._varying import (
    CONDUCTIVITY,
    CONTACT,
    CORRELATIONS,
    LIMITS,
    MARGINALS,
    TAIL,
    CrossCorrelation,
    InclinedStrata,
    RandomField,
    Span,
    check_cross_correlation,
)
