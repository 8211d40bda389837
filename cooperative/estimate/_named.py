"""The estimators that a scene can name, and their settings as its keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from cooperative.estimate._audited import Subset, TwoPhase
from cooperative.estimate._plain import ControlVariate, MonteCarlo, Published
from cooperative.estimate._protocol import Estimator

ESTIMATORS = {kind.name: kind for kind in (TwoPhase, Published, ControlVariate, MonteCarlo, Subset)}
"""By the name in a scene."""

SETTINGS = tuple(
    dict.fromkeys(setting.name for kind in ESTIMATORS.values() for setting in fields(kind) if setting.name != "seed")
)
"""Keys of a scene that are settings of one estimator or another; the seed is that of the plan."""


def named_estimator(name: str, by_key: Mapping[str, Any]) -> Estimator:
    """The estimator of this name with the settings that a scene gives.

    Args:
        name: of the estimator in a scene.
        by_key: settings by key, None for one that is not given.

    Raises:
        ValueError: other settings that are not the estimator's, and for one that it cannot do without.
    """
    kind = ESTIMATORS[name]
    settings = {key: value for key, value in by_key.items() if value is not None}
    takes = {setting.name: setting for setting in fields(kind)}
    for key, value in settings.items():
        if key in SETTINGS and key not in takes:
            others = [repr(n) for n, other in ESTIMATORS.items() if key in {f.name for f in fields(other)}]
            raise ValueError(f"{key} = {value} is for estimator = {' or '.join(others)}, not {name!r}: leave it out")
    for key, setting in takes.items():
        if setting.default is MISSING and key not in settings:
            raise ValueError(f"lacks {key}: add it, estimator = {name!r} needs it")
    made: Estimator = kind(**{key: value for key, value in settings.items() if key in takes})
    return made
