"""What people see of a campaign: words, charts, pictures, one page, exports, progress."""

from cooperative.reporting._charts import panels
from cooperative.reporting._composition import report
from cooperative.reporting._cost import words_of_cost
from cooperative.reporting._exports import export, export_sample
from cooperative.reporting._ground import draw
from cooperative.reporting._plots import draw_particles, quantity, save
from cooperative.reporting._progress import progress_of, watched, words
from cooperative.reporting._tables import write_table

__all__ = [
    "draw",
    "draw_particles",
    "export",
    "export_sample",
    "panels",
    "progress_of",
    "quantity",
    "report",
    "save",
    "watched",
    "words",
    "words_of_cost",
    "write_table",
]
