"""The probability of failure of a scene in whose ground water moves: against time, and on a chart of loads."""

from cooperative.tools.in_time._annual import Annual, annual_in_time, check_classes, lines_of_year
from cooperative.tools.in_time._answer import InTime, probability_in_time
from cooperative.tools.in_time._chart import Chart, Line, chart_lines, probability_chart, rate_at
from cooperative.tools.in_time._chart_files import write_chart
from cooperative.tools.in_time._files import lines, write_in_time
from cooperative.tools.in_time._slides import SlidesInTime, slides_in_time

__all__ = [
    "Annual",
    "Chart",
    "InTime",
    "Line",
    "SlidesInTime",
    "annual_in_time",
    "chart_lines",
    "check_classes",
    "lines",
    "lines_of_year",
    "probability_chart",
    "probability_in_time",
    "rate_at",
    "slides_in_time",
    "write_chart",
    "write_in_time",
]
