"""A campaign in numbers, from its rows alone: probability, modes, consequences, cost."""

from cooperative.summary._notes import EARLY_TESTED, EARLY_TESTED_3D
from cooperative.summary._summarise import slides_of, summarise
from cooperative.summary._values import (
    CampaignCost,
    Convergence,
    CutOff,
    Element,
    ElementLoss,
    FailureConsequences,
    FailureModes,
    FailureProbability,
    Loss,
    ModeShare,
    MoreRuns,
    OtherEstimate,
    Reached,
    Risk,
    Spread,
    StandsFor,
    Summary,
)

__all__ = [
    "EARLY_TESTED",
    "EARLY_TESTED_3D",
    "CampaignCost",
    "Convergence",
    "CutOff",
    "Element",
    "ElementLoss",
    "FailureConsequences",
    "FailureModes",
    "FailureProbability",
    "Loss",
    "ModeShare",
    "MoreRuns",
    "OtherEstimate",
    "Reached",
    "Risk",
    "Spread",
    "StandsFor",
    "Summary",
    "slides_of",
    "summarise",
]
