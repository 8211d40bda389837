"""A campaign's scene: TOML in, checked once, typed values out. Nothing in the file is executed."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

from jax import Array
from jax.typing import ArrayLike

import kl
from cooperative.estimate import SETTINGS, Estimator, Sampling, named_estimator
from cooperative.scene._schema import CALIBRATION, DEFAULTS, GIVEN, SECTIONS, UNSAID, in_words, read, refuse_unknown
from cooperative.scene._text import tables_of
from foundation.text import short, shown
from jaxmpm import Discretisation, Scene, Settle, Slope, Soil, State, cell_independent, slope

LONGEST_NAME = 200

BAND = 1 / 5
"""Thickness of the band to which softening refers, over the slope's height, where a scene does not say."""


@dataclass(frozen=True)
class Strength:
    """The random field of undrained strength: mean (Pa), cov, and per axis a correlation length (m).

    sampled_at: "particles", or "cells" for one value per cell of the background grid, that at its centre: then the grid
    of the field is the background grid, and all particles that start in a cell are equally strong.
    """

    mean: float
    cov: float
    marginal: type
    correlation: type
    length: tuple[float, ...]
    energy: float
    sampled_at: Literal["particles", "cells"]


@dataclass(frozen=True)
class Run:
    """How each sample runs: gravity (m/s2), t_end (s), what displacement is failure (m), when a lane has settled."""

    gravity: float
    t_end: float
    failure_displacement: float
    settle: Settle | None


@dataclass(frozen=True)
class Calibration:
    """Factors of safety of the homogeneous slope on both grids; the rough strength is multiplied by `factor`."""

    rough: float
    refined: float

    @property
    def factor(self) -> float:
        """Refined over rough factor of safety."""
        return self.refined / self.rough


@dataclass(frozen=True)
class Plan:
    """What the campaign does: samples and their coefficients, the estimator, lanes of the screening.

    lanes: samples in one program at a time; None takes 1 on CPU, where lanes gain nothing, and 64 elsewhere.
    look_ahead: refined runs under way at once, in rank order; the answer depends on neither.
    estimator: which refined runs there are and what is made of them, with its settings; see `cooperative.estimate`.
    None where a script gave it and the scene is read without the script.
    screening_stop: displacement (m) at which a rough run is decided and ends, None runs it to its end.
    calibrate: measure the factors of safety of both grids first, and bring the rough strength down (or up) by them.
    restart_every: seconds of wall time after which a refined run writes a restart point, and again after as many.
    fields: grids whose final displacement and plastic strain are kept, and two frames of a failure. modes: grids whose
    failures get a mode.
    slides: how many of the refined failures slide on to their end, a probability sample; the others end once they have
    failed, which is all that the probability asks. None lets all slide, 0 none.
    """

    samples: int
    seed: int
    coefficients: Callable[[Array, int, int], ArrayLike]
    estimator: Estimator | None
    lanes: int | None
    look_ahead: int
    screening_stop: float | None
    calibrate: bool
    restart_every: float
    fields: tuple[str, ...]
    modes: tuple[str, ...]
    slides: int | None


@dataclass(frozen=True)
class Budget:
    """Refined runs that a campaign's folder allows, and those that its scene did."""

    refined_runs: int
    scene: int


@dataclass(frozen=True)
class Campaign:
    """A checked scene; nothing in it changes.

    text: the TOML that it came from. name: of the campaign. slope, soil, strength: what slides. y_ends: what holds the
    slope's ends along y. grids: discretisation of "rough" and "refined". run: how each sample runs. plan: what the
    campaign does. calibration: factors of safety of both grids, where they are known. raised: refined runs that the
    campaign's folder allows beyond the scene.
    """

    text: str
    name: str
    slope: Slope
    y_ends: Literal["fixed", "roller"]
    soil: Soil
    strength: Strength
    grids: Mapping[str, Discretisation]
    run: Run
    plan: Plan
    calibration: Calibration | None = None
    raised: Budget | None = None

    @property
    def estimator(self) -> Estimator:
        """The campaign's estimator. ValueError where a script gave one that is not here."""
        if self.plan.estimator is None:
            given = tomllib.loads(self.text)["estimator"]["given"]
            raise ValueError(f"the campaign's estimator is {given}, which a script gave: give it, estimator={given}")
        return self.plan.estimator


def parse(text: str, estimator: Estimator | None = None) -> Campaign:
    """Read and check a scene.

    estimator: takes the place of the one that the scene names. It is written into the text in words, so that a folder
    knows which estimator it belongs to.
    Raises ValueError for TOML that does not parse, unknown keys (naming the nearest one), missing keys, wrong
    types and values out of range. What depends on the geometry is checked when the grids are built.
    """
    tables = tables_of(text)
    name = tables.pop("name", "campaign")
    if not isinstance(name, str):
        raise ValueError(f"name = {shown(name)} is {in_words(name)}: give text in quotes")
    if not name.isprintable() or len(name) > LONGEST_NAME:
        raise ValueError(
            f"name = {shown(name)}: give one line of at most {LONGEST_NAME} characters without control characters"
        )
    if "sweep" in tables:
        raise ValueError("the scene has a table [sweep], so it is many campaigns: run it as a sweep")
    added = dict.fromkeys(("calibration", "defaults", "estimator", "name"))
    refuse_unknown("the scene", tables, {**SECTIONS, **added})
    given = _given(tables, estimator)
    if given is not None and "estimator" not in tables:
        text += f"\n[estimator]\ngiven = {json.dumps(given)}\n"
    said = {section: read(section, tables.get(section, {}), keys) for section, keys in SECTIONS.items()}
    if "defaults" in tables:
        unsaid = read("defaults", tables["defaults"], DEFAULTS)
        for grid in ("rough", "refined"):
            said[grid] |= {key: value for key, value in unsaid.items() if key not in tables[grid]}
    shape, y_ends = said["slope"], said["slope"].pop("y_ends")
    plan, run, strength = said["campaign"], said["run"], said["strength"]
    if plan["slides"] == 0:
        if "modes" in tables.get("campaign", {}):
            raise ValueError(
                f"[campaign] slides = 0 ends every refined run once its class is decided, and modes = "
                f"{tables['campaign']['modes']!r} asks for modes of its failures, which only their end shows: leave "
                "out modes, or give slides = 'all' or a number"
            )
        plan["modes"] = ()
    settings = {key: plan.pop(key) for key in SETTINGS}
    if given is None:
        plan["estimator"] = named_estimator(plan["estimator"], {**settings, "seed": plan["seed"]})
    else:
        plan["estimator"] = estimator
    soil = _soil({**said["soil"], "strength": strength["mean"]}, shape["height"])
    campaign = Campaign(
        text=text,
        name=name,
        slope=Slope(**shape),
        y_ends=y_ends,
        soil=soil,
        strength=Strength(**strength),
        grids=MappingProxyType({grid: _grid(said[grid], soil) for grid in ("rough", "refined")}),
        run=_run(run),
        plan=Plan(**plan),
        calibration=(
            Calibration(**read("calibration", tables["calibration"], CALIBRATION)) if "calibration" in tables else None
        ),
    )
    _check(campaign)
    return campaign


def built(campaign: Campaign, grid: str, *, at_rest: bool = True) -> tuple[Scene, State]:
    """Scene and initial state of one grid, free of stress if not `at_rest`; ValueError where slope, soil and grid do
    not fit together."""
    return slope(
        campaign.slope, campaign.soil, campaign.grids[grid],
        gravity=campaign.run.gravity, y_ends=campaign.y_ends, at_rest=at_rest,
    )  # fmt: skip


def _run(table: dict[str, Any]) -> Run:
    """A slide ends when its deposit rests, where runs end once they have settled and unless the scene says not."""
    said = {**table}
    settle, rest = said.pop("settle"), said.pop("rest")
    if rest is True and not settle:
        raise ValueError("[run] rest = true with settle = false: a slide that rests has settled, leave one of them out")
    limit = said["failure_displacement"] if rest is not False and said["failure_displacement"] > 0 else None
    return Run(**said, settle=Settle(slides=limit) if settle else None)


def _soil(table: dict[str, Any], height: float) -> Soil:
    """Softening refers to a band of known thickness, unless the scene has it follow the cell."""
    if table["softening_length"] is not UNSAID:
        return Soil(**table)
    soil = Soil(**{**table, "softening_length": None})
    return replace(soil, softening_length=BAND * height) if soil.softens else soil


def _grid(table: dict[str, Any], soil: Soil) -> Discretisation:
    """Answers do not follow the cell, unless the scene says so."""
    said = {key: value for key, value in table.items() if value is not UNSAID}
    return replace(cell_independent(Discretisation(**said, dtype="float32"), soil), **said)


def _check(campaign: Campaign) -> None:
    """Ranges that no builder looks at."""
    campaign.slope.check()
    strength, run, plan, dimension = campaign.strength, campaign.run, campaign.plan, campaign.slope.dimension
    calibration = campaign.calibration or Calibration(1, 1)
    for name, value in (
        ("[strength] mean", strength.mean),
        ("[run] t_end", run.t_end),
        ("[run] gravity", run.gravity),
        ("[run] failure_displacement", run.failure_displacement),
        ("[campaign] restart_every", plan.restart_every),
        *((f"[calibration] {grid}", factor) for grid, factor in vars(calibration).items()),
        *((f"[strength] length of axis {axis}", length) for axis, length in enumerate(strength.length)),
    ):
        if not 0 < value < float("inf"):
            raise ValueError(f"{name} = {value:g}: give a finite value above 0")
    if len(strength.length) != dimension:
        raise ValueError(f"[strength] length has {len(strength.length)} values: give {dimension}, one per axis")
    if not 0 <= strength.cov < float("inf"):
        raise ValueError(f"[strength] cov = {strength.cov:g}: give a coefficient of variation of 0 or more")
    kl.check_marginal(strength.marginal(strength.mean, strength.cov))
    if not 0 < strength.energy <= 1:
        raise ValueError(f"[strength] energy = {strength.energy:g}: give a share of the variance above 0, up to 1")
    for name, value in (
        ("samples", plan.samples),
        ("lanes", 1 if plan.lanes is None else plan.lanes),
        ("look_ahead", plan.look_ahead),
    ):
        if value < 1:
            raise ValueError(f"[campaign] {name} = {value}: give 1 or more")
    if plan.slides is not None and plan.slides < 0:
        raise ValueError(f"[campaign] slides = {plan.slides}: give 0 or more, or 'all'")
    if plan.estimator is not None:
        plan.estimator.check(Sampling(plan.samples, run.failure_displacement, plan.screening_stop))
    if not 0 <= plan.seed < 2**63:
        raise ValueError(f"[campaign] seed = {plan.seed}: give 0 to 2^63 - 1")
    if plan.screening_stop is not None and plan.screening_stop < run.failure_displacement:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m is below the failure displacement of "
            f"{run.failure_displacement:g} m: give more, or leave it out"
        )
    if plan.screening_stop is not None and "rough" in plan.modes:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m ends rough runs before their mode shows: "
            "leave it out, or modes = 'both'"
        )


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
