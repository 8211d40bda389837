"""What a slide did: consequences, onsets, failure modes, what came over elements at risk."""

from cooperative.measure._consequences import (
    EDGE,
    MEASURES,
    Consequences,
    OpenGround,
    consequences,
    exceeded,
    front_thickness,
    size_of_slope,
    walls_reached,
)
from cooperative.measure._elements import ColumnPlan, ElementAtRisk, quantity
from cooperative.measure._modes import SEVERITY, FailureMode, ModeRules, failure_mode
from cooperative.measure._onsets import ReleaseHistory, second_release
from cooperative.measure._track import Track
from cooperative.measure._vulnerability import PUBLISHED, Intensity, Vulnerability

__all__ = [
    "EDGE",
    "MEASURES",
    "PUBLISHED",
    "SEVERITY",
    "ColumnPlan",
    "Consequences",
    "ElementAtRisk",
    "FailureMode",
    "Intensity",
    "ModeRules",
    "OpenGround",
    "ReleaseHistory",
    "Track",
    "Vulnerability",
    "consequences",
    "exceeded",
    "failure_mode",
    "front_thickness",
    "quantity",
    "second_release",
    "size_of_slope",
    "walls_reached",
]
