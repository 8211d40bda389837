"""Soundings and laboratory values of a site: read, checked, and made into parameters of soil."""

from cooperative.laboratory import PointValues, Values
from cooperative.tools.soundings._files import read_files
from cooperative.tools.soundings._interpretation import (
    FEWEST,
    FRICTION,
    STRENGTH,
    TYPES,
    ProposedLayer,
    Stresses,
    behaviour_index,
    corrected_cone,
    extent_of,
    friction_of,
    kind_between,
    proposed_layers,
    require_elevations,
    strength_of,
    thinned,
    types_of,
)
from cooperative.tools.soundings._sounding import Sounding

__all__ = [
    "FEWEST",
    "FRICTION",
    "STRENGTH",
    "TYPES",
    "PointValues",
    "ProposedLayer",
    "Sounding",
    "Stresses",
    "Values",
    "behaviour_index",
    "corrected_cone",
    "extent_of",
    "friction_of",
    "kind_between",
    "proposed_layers",
    "read_files",
    "require_elevations",
    "strength_of",
    "thinned",
    "types_of",
]
