"""The estimators that a scene knows by name, each one class as `Estimator` describes it.

A class puts its two phases together: the first is the scene's own samples (`SceneSamples`) or its own, the second an
audit (`Audited`), the first samples in order (`InOrder`), or its own. The statistics are in the modules beside this
folder: two-phase sampling and its audit, subset simulation, n/N, control variate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from cooperative.estimate._protocol import Estimator
from cooperative.estimate.estimators._control_variate import ControlVariate
from cooperative.estimate.estimators._monte_carlo import MonteCarlo
from cooperative.estimate.estimators._published import Published
from cooperative.estimate.estimators._scene_samples import SceneSamples
from cooperative.estimate.estimators._subset import Subset
from cooperative.estimate.estimators._two_phase import TwoPhase

__all__ = [
    "ESTIMATORS",
    "SETTINGS",
    "ControlVariate",
    "MonteCarlo",
    "Published",
    "SceneSamples",
    "Subset",
    "TwoPhase",
    "named_estimator",
]

ESTIMATORS = {kind.name: kind for kind in (TwoPhase, Published, ControlVariate, MonteCarlo, Subset)}
"""By the name in a scene."""

SETTINGS = ("k_t", "refined_runs", "target_cov", "levels", "replicates")
"""Keys of a scene that are settings of one estimator or another."""


def named_estimator(name: str, said: Mapping[str, Any]) -> Estimator:
    """The estimator of this name with the settings that a scene gives. said: by key, None for what it does not say.

    A k_t that the estimator has no use for is let be, since every scene used to have one. Raises ValueError for other
    settings that are not the estimator's, and for one that it cannot do without.
    """
    kind = ESTIMATORS[name]
    known = {key: value for key, value in said.items() if value is not None}
    takes = {setting.name: setting for setting in fields(kind)}
    for key, value in known.items():
        if key in SETTINGS and key not in takes and key != "k_t":
            others = [repr(n) for n, other in ESTIMATORS.items() if key in {f.name for f in fields(other)}]
            raise ValueError(
                f"[campaign] {key} = {value} is for estimator = {' or '.join(others)}, not {name!r}: leave it out"
            )
    for key, setting in takes.items():
        if setting.default is MISSING and key not in known:
            raise ValueError(f"[campaign] lacks {key}: add it, estimator = {name!r} needs it")
    made: Estimator = kind(**{key: value for key, value in known.items() if key in takes})
    return made
