"""What people see of a campaign: words, charts, pictures, one page, progress."""

from cooperative.reporting._charts import panels, tiled
from cooperative.reporting._composition import report
from cooperative.reporting._cost import words_of_cost
from cooperative.reporting._ground import draw
from cooperative.reporting._interactive import Drawn
from cooperative.reporting._interactive import figures as interactive_figures
from cooperative.reporting._interactive import installed as interactive
from cooperative.reporting._page import document, heading, headline, paragraph
from cooperative.reporting._page import table as html_table
from cooperative.reporting._plots import draw_particles, quantity, save
from cooperative.reporting._progress import progress_of, watched, words
from cooperative.reporting._sentences import Cell, limits, units_of

__all__ = [
    "Cell",
    "Drawn",
    "document",
    "draw",
    "draw_particles",
    "heading",
    "headline",
    "html_table",
    "interactive",
    "interactive_figures",
    "limits",
    "panels",
    "paragraph",
    "progress_of",
    "quantity",
    "report",
    "save",
    "tiled",
    "units_of",
    "watched",
    "words",
    "words_of_cost",
]
