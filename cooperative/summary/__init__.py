"""A campaign in numbers, from its rows alone: probability, modes, consequences, cost."""

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
