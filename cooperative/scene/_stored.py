"""The campaign that a folder holds: its scene, the defaults of the time when it began, and what was measured since."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cooperative.estimate import Estimator
from cooperative.scene import tables
from cooperative.scene._budget import allowing, kept_budget, raised
from cooperative.scene._campaign import Campaign, Given
from cooperative.scene._files import source_of
from cooperative.scene._measured import with_measured
from cooperative.scene._typed import parse
from cooperative.scene._words import campaign_of_words, in_words, source_of_value
from cooperative.store import SCENE, Source, Store, completed, refuse_another, stored_source


def campaign_of(store: Store, estimator: Estimator | None = None) -> Campaign:
    """The scene of a campaign's folder, with what it has measured and the refined runs that were allowed since.

    estimator: that of the script, where one gave it.
    """
    campaign, budget = read(store.source, estimator, begun=True), kept_budget(store.folder)
    if budget is not None and not isinstance(campaign.estimator, Given):
        campaign = raised(campaign, budget)
    return with_measured(campaign, store.folder)


def read(scene: Campaign | Source | str | Path, estimator: Estimator | None = None, *, begun: bool = False) -> Campaign:
    """A campaign, checked.

    Args:
        scene: in TOML its text, the path of its file, or what a folder keeps of it; one that was written in Python.
        estimator: in place of one that a scene names, or the one that the script of a campaign gave.
        begun: whether the campaign is under way; its numbers were accepted when it began, and none is asked about.

    Raises:
        ValueError: as `parse` and `Campaign`; an estimator that is not the campaign's.
    """
    if isinstance(scene, Campaign):
        campaign = replace(scene, source=source_of_value(scene))
    elif isinstance(scene, Source) and scene.text is None:
        campaign = campaign_of_words(scene)
    else:
        return parse(scene, estimator, begun=begun)
    if estimator is None:
        return campaign
    words, there = in_words(estimator), campaign.source.beside["campaign"].get("estimator")
    if words != there:
        raise ValueError(f"the campaign's estimator is {there}, not {words}: give that one, or another folder")
    return replace(campaign, estimator=estimator)


def in_folder(
    scene: Campaign | Source | str | Path, folder: Path, estimator: Estimator | None, refined_runs: int | None
) -> Campaign:
    """A campaign that begins in a folder or goes on there, with what that has measured and allows.

    Args:
        scene: as for `read`.
        folder: of the campaign, which need not be there.
        estimator: that of the script, where one gave it.
        refined_runs: allowed from now on, None for as many as before.

    Raises:
        ValueError: as `read`, for a folder of another campaign, and for runs that are allowed already.
    """
    if isinstance(scene, Campaign) and (text := _unchanged(scene)) is not None:
        estimator = scene.estimator if "estimator" in text.tables else None
        scene = text
    scene = scene if isinstance(scene, Campaign) else settled(scene, folder)
    campaign = read(scene, estimator, begun=stored_source(folder) is not None)
    refuse_another(folder, campaign.source)
    return with_measured(allowing(campaign, folder, refined_runs), folder)


def _unchanged(campaign: Campaign) -> Source | None:
    """The scene that a campaign was read from, where it still is what that says; None for one that Python made or
    changed."""
    source = campaign.source
    if source.text is None:
        return None
    estimator = campaign.estimator if "estimator" in source.tables else None
    again = parse(source, estimator, begun=getattr(campaign.soil, "unusual", False))
    same = again.measured == campaign.measured and source_of_value(again) == source_of_value(campaign)
    return source if same else None


def settled(scene: Source | str | Path, folder: Path, name: str = SCENE) -> Source:
    """A scene with what its folder keeps beside it and, where none has begun there, with the defaults of today.

    Args:
        scene: its text, its file, or both.
        folder: of the campaign, or of a sweep.
        name: of the file with the scene, in that folder.

    Raises:
        ValueError: the scene, or what the folder holds, is no TOML.
    """
    source, there = source_of(scene), stored_source(folder, name)
    if there is not None:
        return completed(source, there)
    if "defaults" in source.tables:
        return source
    today = {
        "cfl": tables.Grid.model_fields["cfl"].default,
        "gap_memory": tables.Soil.model_fields["gap_memory"].default,
    }
    return Source(source.text, {**source.beside, "defaults": today})
