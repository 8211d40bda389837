"""What `cooperative.reporting` offers, and where each name stands."""

from ._charts import panels, tiled
from ._composition import draw_slides, report
from ._cost import words_of_cost
from ._ground import draw
from ._interactive import Drawn, any_interactive, figures, installed, script
from ._page import HOW, appearance, document, heading, headline, paragraph, risks, table
from ._plots import draw_particles, quantity, save
from ._progress import GridProgress, Progress, controller_of, progress_of, watched, words
from ._sentences import Cell, limits, units_of_campaign

__all__ = [
    "HOW",
    "Cell",
    "Drawn",
    "GridProgress",
    "Progress",
    "any_interactive",
    "appearance",
    "controller_of",
    "document",
    "draw",
    "draw_particles",
    "draw_slides",
    "figures",
    "heading",
    "headline",
    "installed",
    "limits",
    "panels",
    "paragraph",
    "progress_of",
    "quantity",
    "report",
    "risks",
    "save",
    "script",
    "table",
    "tiled",
    "units_of_campaign",
    "watched",
    "words",
    "words_of_cost",
]
