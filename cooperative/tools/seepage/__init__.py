"""Water that moves in the ground of a scene: pressure at its times, factor of safety against time."""

from cooperative.tools.seepage._answer import HOUR, Moment, Wetted, clock, in_hours, lines, wetted
from cooperative.tools.seepage._pictures import (
    MM_PER_HOUR,
    csv_text,
    draw_load,
    write_animation,
    write_texts,
    write_wetted,
)

__all__ = [
    "HOUR",
    "MM_PER_HOUR",
    "Moment",
    "Wetted",
    "clock",
    "csv_text",
    "draw_load",
    "in_hours",
    "lines",
    "wetted",
    "write_animation",
    "write_texts",
    "write_wetted",
]
