"""Runs: chunks of steps on the device with checks between them on the host; many samples; derivatives."""

from jaxmpm.run import objectives
from jaxmpm.run._advance import advance, advance_lanes, repeat
from jaxmpm.run._batch import Chunk, Hooks, Midway
from jaxmpm.run._checkpointed import Checkpoints, checkpoints, replay
from jaxmpm.run._columns import Passing, column_shape, passing, with_columns
from jaxmpm.run._devices import devices_of
from jaxmpm.run._early import Early
from jaxmpm.run._integrate import Result, solve
from jaxmpm.run._lanes import lanes
from jaxmpm.run._limit_load import least_failing_volume, limit_load_scene
from jaxmpm.run._many import solve_each
from jaxmpm.run._sensitivity import sensitivity
from jaxmpm.run._stopping import Exceeds, Reading, Rule, Settle, SlidesEnd
from jaxmpm.run._strength_reduction import FactorOfSafety, factor_of_safety, reduced

__all__ = [
    "Checkpoints",
    "Chunk",
    "Early",
    "Exceeds",
    "FactorOfSafety",
    "Hooks",
    "Midway",
    "Passing",
    "Reading",
    "Result",
    "Rule",
    "Settle",
    "SlidesEnd",
    "advance",
    "advance_lanes",
    "checkpoints",
    "column_shape",
    "devices_of",
    "factor_of_safety",
    "lanes",
    "least_failing_volume",
    "limit_load_scene",
    "objectives",
    "passing",
    "reduced",
    "repeat",
    "replay",
    "sensitivity",
    "solve",
    "solve_each",
    "with_columns",
]
