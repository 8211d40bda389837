"""The probability of failure of a scene in whose ground water moves: against time, and on a chart of loads."""

from cooperative.tools.in_time._answer import InTime, lines, probability_in_time
from cooperative.tools.in_time._chart import Chart, Line, chart_lines, probability_chart, rate_at
from cooperative.tools.in_time._chart_files import write_chart
from cooperative.tools.in_time._files import write_in_time

__all__ = [
    "Chart",
    "InTime",
    "Line",
    "chart_lines",
    "lines",
    "probability_chart",
    "probability_in_time",
    "rate_at",
    "write_chart",
    "write_in_time",
]
