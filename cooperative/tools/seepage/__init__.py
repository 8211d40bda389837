"""Water that moves in the ground of a scene: pressure at its times, factor of safety against time."""

from cooperative.tools.seepage._answer import Moment, Wetted, in_hours, lines, wetted
from cooperative.tools.seepage._pictures import write_wetted

__all__ = ["Moment", "Wetted", "in_hours", "lines", "wetted", "write_wetted"]
