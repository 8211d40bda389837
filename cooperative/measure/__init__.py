"""What a slide did: consequences, onsets, failure modes."""

from cooperative.measure._consequences import Consequences, SlopeGeometry, consequences
from cooperative.measure._modes import SEVERITY, FailureMode, ModeRules, failure_mode
from cooperative.measure._onsets import Motion

__all__ = [
    "SEVERITY",
    "Consequences",
    "FailureMode",
    "ModeRules",
    "Motion",
    "SlopeGeometry",
    "consequences",
    "failure_mode",
]
