"""The probability of failure against time of a scene in whose ground water moves."""

from cooperative.tools.in_time._answer import InTime, lines, probability_in_time
from cooperative.tools.in_time._files import write_in_time

__all__ = ["InTime", "lines", "probability_in_time", "write_in_time"]
