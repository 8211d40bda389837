"""Soundings and laboratory values of a site: read, checked, and made into parameters of soil."""

from cooperative.soundings._files import read_files, read_rows
from cooperative.soundings._interpretation import (
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
from cooperative.soundings._sounding import Measured, SiteError, Sounding, Values

__all__ = [
    "FEWEST",
    "FRICTION",
    "STRENGTH",
    "TYPES",
    "Measured",
    "ProposedLayer",
    "SiteError",
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
    "read_rows",
    "require_elevations",
    "strength_of",
    "thinned",
    "types_of",
]
