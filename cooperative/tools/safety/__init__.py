"""The factor of safety of a campaign's slope at once: limit equilibrium beside the solver's limit load."""

from cooperative.tools.safety._factor import Safety, factor_of_safety, of_own_flow, sample_strength, slices_at_rest
from cooperative.tools.safety._pictures import draw_safety, write_safety
from cooperative.tools.safety._rank import RANKS, rank_by_slices
from cooperative.tools.safety._search import Critical, critical_surface
from cooperative.tools.safety._slices import Circle, Conditions, Method, Slices, Slip, zones
from cooperative.tools.safety._words import lines_of_equilibrium, lines_of_solver, progress_line

__all__ = [
    "RANKS",
    "Circle",
    "Conditions",
    "Critical",
    "Method",
    "Safety",
    "Slices",
    "Slip",
    "critical_surface",
    "draw_safety",
    "factor_of_safety",
    "lines_of_equilibrium",
    "lines_of_solver",
    "of_own_flow",
    "progress_line",
    "rank_by_slices",
    "sample_strength",
    "slices_at_rest",
    "write_safety",
    "zones",
]
