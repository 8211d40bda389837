"""The probability of failure of a scene in whose ground water moves: against time, and on a chart of loads."""

from cooperative.tools.in_time._annual import Annual, annual_in_time, check_classes, lines_of_year
from cooperative.tools.in_time._answer import InTime, probability_in_time
from cooperative.tools.in_time._chart import Chart, Line, chart_lines, probability_chart, rate_at
from cooperative.tools.in_time._chart_files import write_chart
from cooperative.tools.in_time._files import lines, write_in_time
from cooperative.tools.in_time._folder import kept_in, progress_in_time, read_chart, read_in_time
from cooperative.tools.in_time._kept import Kept
from cooperative.tools.in_time._slides import SlidesInTime, slides_in_time

__all__ = [
    "Annual",
    "Chart",
    "InTime",
    "Kept",
    "Line",
    "SlidesInTime",
    "annual_in_time",
    "chart_lines",
    "check_classes",
    "kept_in",
    "lines",
    "lines_of_year",
    "probability_chart",
    "probability_in_time",
    "progress_in_time",
    "rate_at",
    "read_chart",
    "read_in_time",
    "slides_in_time",
    "write_chart",
    "write_in_time",
]
