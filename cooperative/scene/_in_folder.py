"""The campaign that a folder holds.

Its scene, what was measured since it began, and the refined runs that were allowed since, for a target that changes or
rough runs that broke off.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

from cooperative.estimate import Estimator, Sampling
from cooperative.scene import tables
from cooperative.scene._campaign import Campaign
from cooperative.scene._typed import parse, source_of
from cooperative.scene._words import in_python, is_same
from cooperative.store import (
    BUDGET,
    DATABASE,
    MEASURED,
    SLIDES_END,
    Source,
    Store,
    refuse_another,
    store_text,
    stored_source,
    stored_text,
)
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import shown

T = TypeVar("T", bound=tables.Part)


def campaign_of(store: Store, estimator: Estimator | None = None) -> Campaign:
    """The scene of a campaign's folder, with what it has measured and the refined runs that were allowed since.

    Args:
        store: the campaign's folder.
        estimator: that of the script, where one gave it.
    """
    return _grown(read(store.source, estimator), store.folder, None, None)


def read(scene: Campaign | Source | str | Path, estimator: Estimator | None = None) -> Campaign:
    """A campaign, checked.

    Args:
        scene: in TOML its text, the path of its file, or what a folder keeps of it; one that was written in Python.
        estimator: in place of one that a scene names, or the one that the script of a campaign gave.

    Raises:
        ValueError: as `parse` and `Campaign`; an estimator that is not the campaign's.
    """
    if isinstance(scene, Campaign) or (isinstance(scene, Source) and scene.text is None):
        return in_python(scene, estimator)
    return parse(scene, estimator)


def in_folder(
    scene: Campaign | Source | str | Path,
    folder: Path,
    estimator: Estimator | None,
    refined_runs: int | None,
    slides_t_end: float | None = None,
) -> tuple[Campaign, Source]:
    """A campaign that begins in a folder or goes on there, and what it was made from.

    The campaign has what its folder has measured and allows.

    Args:
        scene: as for `read`.
        folder: of the campaign, which need not be there.
        estimator: that of the script, where one gave it.
        refined_runs: allowed from now on, None for as many as before.
        slides_t_end: until when slides go on from now on (s), None for as long as before.

    Raises:
        ValueError: as `read`, for a folder of another campaign, for runs that are allowed already, and for an end of
            slides that is earlier than theirs is.
    """
    if isinstance(scene, Campaign) and scene.source.text is not None:
        of_script = scene.estimator if "estimator" in scene.source.tables else None
        if is_same(scene, parse(scene.source, of_script)):
            scene, estimator = scene.source, of_script
    campaign = read(scene if isinstance(scene, Campaign) else settled(scene, folder), estimator)
    campaign.require("estimator")
    refuse_another(folder, campaign.source)
    return _grown(campaign, folder, refined_runs, slides_t_end), campaign.source


def settled(scene: Source | str | Path, folder: Path) -> Source:
    """A scene with what its folder keeps beside it.

    Args:
        scene: its text, its file, or both.
        folder: of the campaign.

    Raises:
        ValueError: the scene is no TOML, or the folder's database cannot be trusted.
    """
    source, there = source_of(scene), stored_source(folder)
    return source if there is None else source.completed(there)


def _grown(campaign: Campaign, folder: Path, refined_runs: int | None, slides_t_end: float | None) -> Campaign:
    """The campaign with what its folder has measured, the refined runs that it is to allow and the end of its slides.

    Raises ValueError for no more than is allowed already, or an estimator without such a setting.
    """
    stored = kept(folder, tables.LongerSlides)
    if stored is not None:
        campaign = replace(campaign, run=replace(campaign.run, slides_t_end=stored.t_end))
    if slides_t_end is not None:
        last, path, value = campaign.run.last("refined"), ("slides_t_end",), f"{slides_t_end:g} s"
        if not last <= slides_t_end < float("inf"):
            raise Invalid(path, value, "", f"slides go on until {last:g} s already, give more")
        if campaign.plan.slides == 0:
            remedy = "the scene asks for no slides (slides = 0), so that none goes on: leave it out"
            raise Invalid(path, value, "", remedy)
        campaign = replace(campaign, run=replace(campaign.run, slides_t_end=float(slides_t_end)))
    budget = kept(folder, tables.Budget)
    if refined_runs is not None:
        budget = _more(campaign, budget, refined_runs)
    if budget is not None and not isinstance(campaign.estimator, tables.FromScript):
        chosen, path, value = campaign.estimator, ("refined_runs",), str(budget.refined_runs)
        assert is_dataclass(chosen)
        if budget.refined_runs <= budget.scene:
            raise Invalid(path, value, "", f"the scene allows {budget.scene} already, give more")
        if "refined_runs" not in {setting.name for setting in fields(chosen)}:
            raise Invalid(path, value, "", f"estimator {chosen.name!r} has no such setting")
        campaign = replace(campaign, estimator=replace(chosen, refined_runs=budget.refined_runs), raised=budget)
    return with_measured(campaign, folder)


def _more(campaign: Campaign, stored: tables.Budget | None, refined_runs: int) -> tables.Budget:
    """So many refined runs allowed.

    stored: those that the folder allows already.
    """
    plan = campaign.plan
    first = Sampling(
        plan.samples, campaign.run.failure_displacement, plan.screening_stop, rough_samples=plan.rough_samples
    )
    scene = campaign.estimator.budget(campaign.estimator.rough_runs(first))
    if scene is None:
        rule = f"while the rule of estimator {campaign.estimator.name!r} alone decides when to stop"
        raise Invalid(("refined_runs",), str(refined_runs), rule, "leave it out")
    allowed = scene if stored is None else stored.refined_runs
    if refined_runs <= scene or refined_runs < allowed:
        raise Invalid(("refined_runs",), str(refined_runs), "", f"the campaign allows {allowed} already, give more")
    if refined_runs > tables.MOST_RUNS:
        raise Invalid(("refined_runs",), shown(refined_runs), "", f"give at most {tables.MOST_RUNS:,}")
    return tables.Budget(refined_runs, scene)


KEPT: Mapping[type[tables.Part], str] = {
    tables.Measured: MEASURED,
    tables.Budget: BUDGET,
    tables.LongerSlides: SLIDES_END,
}
"""What a campaign's database holds beside its scene, by the name it has there."""


def keep(store: Store, part: tables.Part) -> None:
    """Keep what a campaign has measured, or what its folder allows, in its database.

    Args:
        store: the campaign's folder.
        part: one of `KEPT`.

    Raises:
        OSError: the disk refuses.
    """
    numbers = {name: value for name, value in asdict(cast(Any, part)).items() if value is not None}
    store_text(store, KEPT[type(part)], json.dumps(numbers))


def stored_measured(folder: Path) -> tables.Measured:
    """What a campaign's folder has measured, nothing where no campaign has begun.

    Args:
        folder: of the campaign.

    Raises:
        ValueError: the database cannot be trusted.
    """
    return kept(folder, tables.Measured) or tables.Measured()


def with_measured(campaign: Campaign, folder: Path) -> Campaign:
    """The campaign with what its folder has measured; what it gives itself comes first.

    Args:
        campaign: the campaign.
        folder: of the campaign.

    Raises:
        ValueError: the database cannot be trusted, or the failure displacement does not go with the campaign.
    """
    needed = {
        "terms": True,
        "shared": True,
        "calibration": campaign.plan.calibrate,
        "limit_load": campaign.run.failure == "limit load",
    }
    missing = [name for name, wants in needed.items() if wants and getattr(campaign.measured, name) is None]
    stored = stored_measured(folder)
    measured = {name: getattr(stored, name) for name in missing}
    return replace(campaign, measured=replace(campaign.measured, **measured)) if measured else campaign


def kept(folder: Path, part: type[T]) -> T | None:
    """What a campaign's folder keeps of this kind, None where there is nothing.

    Args:
        folder: of the campaign.
        part: one of `KEPT`.

    Raises:
        ValueError: the database cannot be trusted.
    """
    name = KEPT[part]
    text = stored_text(folder, name)
    if text is None:
        return None
    try:
        return tables.read(part, json.loads(text), name)
    except (ValueError, RecursionError) as error:
        path = folder / DATABASE
        remedy = f"`sqlite3 {path} \"delete from campaign where name = '{name}'\"`"
        raise Invalid((), str(path), f"holds no {name} that this version reads ({error})", remedy) from error
