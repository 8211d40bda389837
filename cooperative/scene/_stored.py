"""The campaign that a folder holds: its scene, the defaults of the time when it began, and what was measured since."""

from __future__ import annotations

import json
from pathlib import Path

from cooperative.estimate import Estimator
from cooperative.scene import tables
from cooperative.scene._budget import kept_budget, raised
from cooperative.scene._campaign import Campaign
from cooperative.scene._measured import with_measured
from cooperative.scene._text import tables_of
from cooperative.scene._typed import parse
from cooperative.store import Store, kept_scene


def campaign_of(store: Store, estimator: Estimator | None = None) -> Campaign:
    """The scene of a campaign's folder, with what it has measured and the refined runs that were allowed since.

    estimator: that of the script, where one gave it.
    """
    campaign, budget = parse(store.scene_text, estimator, begun=True), kept_budget(store.folder)
    if budget is not None and campaign.plan.estimator is not None:
        campaign = raised(campaign, budget)
    return with_measured(campaign, store.folder)


def with_defaults(text: str, kept: Path) -> str:
    """The scene with the table `[defaults]` of that in the file `kept`, or with today's where there is no such file.

    Raises ValueError for a text, or a file, that is no TOML or has another such table.
    """
    if "defaults" in tables_of(text):
        return text
    values = {
        "cfl": tables.Grid.model_fields["cfl"].default,
        "gap_memory": tables.Soil.model_fields["gap_memory"].default,
    }
    if kept.exists():
        values = dict(tables.read(tables.Defaults, tables_of(kept_scene(kept))["defaults"], "defaults"))
    return text + "\n[defaults]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
