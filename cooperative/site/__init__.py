"""A site from its files: soundings and laboratory values to layers, estimates with intervals, and a part of a scene."""

from cooperative.site._arguments import add_arguments, assumed_of, units_of
from cooperative.site._estimate import Assumed, SiteEstimate, SiteLayerFit, cone_factor, estimate_site
from cooperative.site._write import words, write_site

__all__ = [
    "Assumed",
    "SiteEstimate",
    "SiteLayerFit",
    "add_arguments",
    "assumed_of",
    "cone_factor",
    "estimate_site",
    "units_of",
    "words",
    "write_site",
]
