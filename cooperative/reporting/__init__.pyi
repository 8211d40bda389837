"""What `cooperative.reporting` offers, and where each name stands."""

from ._charts import panels, tiled
from ._composition import report
from ._cost import words_of_cost
from ._ground import draw
from ._interactive import Drawn, figures, installed
from ._page import document, heading, headline, paragraph, table
from ._plots import draw_particles, quantity, save
from ._progress import progress_of, watched, words
from ._sentences import Cell, limits, units_of

__all__ = [
    "Cell",
    "Drawn",
    "document",
    "draw",
    "draw_particles",
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
    "save",
    "table",
    "tiled",
    "units_of",
    "watched",
    "words",
    "words_of_cost",
]
