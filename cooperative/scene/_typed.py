"""A campaign's scene: TOML in, checked once, typed values out. Nothing in the file is executed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from types import MappingProxyType
from typing import Any

from cooperative.estimate import SETTINGS, Estimator, named_estimator
from cooperative.scene._campaign import Campaign, Measured, Plan, Run, check_campaign
from cooperative.scene._hazard import hazard_of
from cooperative.scene._measured import given_measured, taking
from cooperative.scene._schema import (
    DEFAULTS,
    GIVEN,
    LISTS,
    OF_GROUND,
    OPTIONAL,
    SECTIONS,
    SITES,
    UNSAID,
    in_words,
    read,
    unknown_keys,
    wrong_keys,
)
from cooperative.scene._site import Site, listed, refuse_both, site_of
from cooperative.scene._soil import CrossCorrelation, RandomField, ask, soil_of
from cooperative.scene._text import tables_of
from foundation.text import short, shown
from jaxmpm import AnySoil, Discretisation, FrictionalSoil, Scene, Settle, Soil, State, cell_independent

LONGEST_NAME = 200

MOST_WRONG = 8
"""Wrong keys that a message names; it counts the others."""


def parse(text: str, estimator: Estimator | None = None, *, begun: bool = False) -> Campaign:
    """Read and check a scene.

    estimator: takes the place of the one that the scene names. It is written into the text in words, so that a folder
    knows which estimator it belongs to. begun: whether the campaign is under way; its numbers were accepted when
    it began, and none is asked about.
    Raises ValueError for TOML that does not parse, unknown keys (naming the nearest one), missing keys, wrong
    types and values out of range. What depends on the geometry is checked when the grids are built.
    """
    tables = tables_of(text)
    hazard = hazard_of(tables)
    name = tables.pop("name", "campaign")
    if not isinstance(name, str):
        raise ValueError(f"name = {shown(name)} is {in_words(name)}: give text in quotes")
    if not name.isprintable() or len(name) > LONGEST_NAME:
        raise ValueError(
            f"name = {shown(name)}: give one line of at most {LONGEST_NAME} characters without control characters"
        )
    if "sweep" in tables:
        raise ValueError("the scene has a table [sweep], so it is many campaigns: run it as a sweep")
    _refuse_wrong_keys(tables)
    refuse_both(tables)
    if begun:
        tables["soil"]["unusual"] = True
    _settle_defaults(tables)
    given = _given(tables, estimator)
    if given is not None and "estimator" not in tables:
        text += f"\n[estimator]\ngiven = {json.dumps(given)}\n"
    said = {
        section: read(section, tables.get(section, {}), keys)
        for section, keys in SECTIONS.items()
        if section not in (*SITES, *OF_GROUND) and (section in tables or section not in OPTIONAL)
    }
    plan, run = said["campaign"], said["run"]
    if not said["soil"]["unusual"]:
        ask("[run] gravity", "gravity", run["gravity"])
    measured = given_measured(tables)
    _check_limit_load(tables, measured, run)
    settings = {key: plan.pop(key) for key in SETTINGS}
    if given is None:
        plan["estimator"] = named_estimator(plan["estimator"], {**settings, "seed": plan["seed"]})
    else:
        plan["estimator"] = estimator

    def soil_on(ground: Site) -> tuple[Soil | FrictionalSoil, Mapping[str, RandomField]]:
        strength = said.get("strength")
        return soil_of(said["soil"], tables["soil"], strength, height=ground.height, span=ground.span)

    site = site_of(tables, lambda ground: soil_on(ground)[1])
    soil, random = soil_on(site)
    _settle_modes(plan, tables["campaign"], site.shape.face is not None)
    campaign = Campaign(
        text=text,
        name=name,
        site=site,
        soil=soil,
        random=random,
        cross_correlation=CrossCorrelation(**said["cross_correlation"]) if "cross_correlation" in said else None,
        grids=MappingProxyType({grid: _grid(said[grid], soil) for grid in ("rough", "refined")}),
        run=_run(run),
        plan=Plan(**plan),
        hazard=hazard,
    )
    campaign = taking(campaign, **vars(measured))
    check_campaign(campaign)
    return campaign


def built(campaign: Campaign, grid: str, *, at_rest: bool = True) -> tuple[Scene, State]:
    """Scene and initial state of one grid, free of stress if not `at_rest`; ValueError where slope, soil and grid do
    not fit together."""
    return campaign.site.built(campaign.soil, campaign.grids[grid], campaign.run.gravity, at_rest=at_rest)


def _refuse_wrong_keys(tables: Mapping[str, Any]) -> None:
    """Raise ValueError that names every table and key that is not known, and every one that lacks."""
    added = dict.fromkeys(("calibration", "defaults", "estimator", "field_modes", "files", "limit_load", "name"))
    wrong = unknown_keys("the scene", tables, {**SECTIONS, **added})
    # A table that lacks may be there under a name that is not known.
    needed = () if wrong else [section for section in SECTIONS if section not in OPTIONAL]
    for section, keys in SECTIONS.items():
        if section in LISTS:
            for number, layer in enumerate(listed(section, tables), 1):
                wrong += wrong_keys(f"{section} {number}", layer, keys)
        elif section in tables or section in needed:
            wrong += wrong_keys(section, tables.get(section, {}), keys)
    if wrong:
        more = f"; and {len(wrong) - MOST_WRONG} more" if len(wrong) > MOST_WRONG else ""
        raise ValueError("; ".join(wrong[:MOST_WRONG]) + more)


def _settle_defaults(tables: dict[str, Any]) -> None:
    """What the scene leaves out is what it was when the campaign began. ValueError for a key that has no say."""
    cut_off = any("tension_cutoff" in table for table in (tables["soil"], *listed("layer", tables)))
    if "gap_memory" in tables["soil"] and not cut_off:
        raise ValueError(
            "[soil] gap_memory has no say in soil without tension_cutoff, which opens no gap: leave it out, or give "
            "tension_cutoff"
        )
    if "defaults" in tables:
        for key, value in read("defaults", tables["defaults"], DEFAULTS).items():
            for section in ("rough", "refined", "soil"):
                if key in SECTIONS[section]:
                    tables[section].setdefault(key, value)


def _settle_modes(plan: dict[str, Any], said: Mapping[str, Any], has_modes: bool) -> None:
    """Slides have modes where they come to their end, on a slope with a toe."""
    if plan["slides"] == 0 and "modes" in said:
        raise ValueError(
            f"[campaign] slides = 0 ends every refined run once its class is decided, and modes = "
            f"{said['modes']!r} asks for modes of its failures, which only their end shows: leave "
            "out modes, or give slides = 'all' or a number"
        )
    if not has_modes and "modes" in said:
        raise ValueError(
            f"[campaign] modes = {said['modes']!r} asks for modes, which only a slope with its toe has: leave it "
            "out, or give [ground] its toe"
        )
    if plan["slides"] == 0 or not has_modes:
        plan["modes"] = ()


def _check_limit_load(tables: Mapping[str, Any], measured: Measured, run: Mapping[str, Any]) -> None:
    """Raise ValueError for a limit load, asked for or given, that does not go with the table [run]."""
    asked = run["failure"] == "limit load"
    if asked and "failure_displacement" in tables.get("run", {}):
        raise ValueError(
            "[run] failure_displacement has no say beside failure = 'limit load', which finds it: leave it out"
        )
    given = measured.limit_load
    if given is None:
        return
    if not asked:
        raise ValueError("the scene has a table [limit_load] without [run] failure = 'limit load': leave it out")
    if run["least_volume"] not in (None, given.volume):
        raise ValueError(
            f"[run] least_volume = {run['least_volume']:g} and [limit_load] volume = {shown(given.volume)} differ: the "
            "displacement belongs to one volume, give that one in both"
        )


def _run(table: dict[str, Any]) -> Run:
    """A slide ends when its deposit rests, where runs end once they have settled and unless the scene says not."""
    said = {**table}
    settle, rest = said.pop("settle"), said.pop("rest")
    if rest is True and not settle:
        raise ValueError("[run] rest = true with settle = false: a slide that rests has settled, leave one of them out")
    limit = said["failure_displacement"] if rest is not False and said["failure_displacement"] > 0 else None
    return Run(**said, settle=Settle(slides=limit) if settle else None)


def _grid(table: dict[str, Any], soil: AnySoil) -> Discretisation:
    """Answers do not follow the cell, unless the scene says so."""
    said = {key: value for key, value in table.items() if value is not UNSAID}
    return replace(cell_independent(Discretisation(**said, dtype="float32"), soil), **said)


def _given(tables: Mapping[str, Any], estimator: Estimator | None) -> str | None:
    """How an estimator describes itself that the scene does not name; None where the scene names its own."""
    kept = read("estimator", tables["estimator"], GIVEN)["given"] if "estimator" in tables else None
    if estimator is None:
        return kept
    if not is_dataclass(estimator) or isinstance(estimator, type):
        raise ValueError(f"estimator = {estimator!r}: give an object of a frozen dataclass, whose fields tell it apart")
    if kept is not None and kept != repr(estimator):
        raise ValueError(
            f"the campaign's estimator is {short(kept, 400)}, not {estimator!r}: give that one, or another folder"
        )
    # A k_t is let be, since every scene used to have one.
    said = [key for key in ("estimator", *SETTINGS) if key in tables.get("campaign", {}) and key != "k_t"]
    if said:
        raise ValueError(f"[campaign] {said[0]} has no say beside estimator = {estimator!r}: leave it out of the scene")
    return repr(estimator)
