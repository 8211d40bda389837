"""A site from its files: soundings and laboratory values to layers, estimates with intervals, and a part of a scene."""

from cooperative.tools.site._arguments import answer
from cooperative.tools.site._assumed import Assumed
from cooperative.tools.site._estimate import SiteEstimate, SiteLayerFit, estimate_site
from cooperative.tools.site._write import words, write_site

__all__ = [
    "Assumed",
    "SiteEstimate",
    "SiteLayerFit",
    "answer",
    "estimate_site",
    "words",
    "write_site",
]
