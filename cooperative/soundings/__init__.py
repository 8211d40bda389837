"""Soundings and laboratory values of a site: read, checked, and made into parameters of soil."""

from cooperative.soundings._files import read_files, read_rows
from cooperative.soundings._interpretation import (
    FRICTION,
    STRENGTH,
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
)
from cooperative.soundings._sounding import Measured, SiteError, Sounding, Values

__all__ = [
    "FRICTION",
    "STRENGTH",
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
]
