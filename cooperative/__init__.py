"""Campaigns: screen samples on a rough grid, refine the ranked ones, estimate how likely the slope runs out.

from cooperative import report, run

run(open("scene.toml", encoding="utf-8").read(), "out", workers=2)
print(report("out"))

Names are loaded when first asked for: those listed in `__init__.pyi`.
"""

import warnings
from importlib import import_module

import lazy_loader

from foundation import __version__

RELOCATED = {
    "estimate": "AuditPlan Chances Correlation Fit Fits Screened Severity Slides SubsetPlan after_more_runs "
    "all_samples chance_of correlation exceedance fit_distributions mean_of next_audit next_refined sample_weights "
    "severity_ranking shares stopping_rank",
    "measure": "ModeRules Motion",
    "reporting": "consolidate write_table",
    "scene": "campaign_of parse",
    "store": "Store open_store sample_path scene_digest write_sample",
    "summary": "summarise",
}
"""By room: names that its `__all__` has and this package will have no longer; for one version they are here, too."""

_public, __dir__, _offered = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_offered, "__version__"]


def __getattr__(name: str) -> object:
    room = next((room for room, names in RELOCATED.items() if name in names.split()), None)
    if room is None:
        return _public(name)
    warnings.warn(f"cooperative.{name} is cooperative.{room}.{name}", DeprecationWarning, stacklevel=2)
    return getattr(import_module(f"cooperative.{room}"), name)
