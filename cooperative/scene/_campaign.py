"""The value of a campaign: what slides where, how each sample runs, what the campaign does. Nothing in it changes."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jax import Array
from jax.typing import ArrayLike

from cooperative.estimate import Estimator, Sampling
from cooperative.scene._hazard import Hazard
from cooperative.scene._site import Site, SiteLayer, check_site
from cooperative.scene._soil import CrossCorrelation, RandomField, check_cross_correlation
from jaxmpm import Discretisation, Settle, ground


@dataclass(frozen=True)
class Run:
    """How each sample runs: gravity (m/s2), t_end (s), up to when slides of the refined grid go on (s; None: up to
    t_end), what is failure, from what displacement (m) and of how much soil (m3, in a section m2), None for any
    particle, when a lane has settled."""

    gravity: float
    t_end: float
    slides_t_end: float | None
    failure: Literal["displacement", "limit load"]
    failure_displacement: float
    least_volume: float | None
    settle: Settle | None

    def last(self, grid: str) -> float:
        """Time (s) at which a run of a grid ends at the latest."""
        return self.t_end if grid == "rough" or self.slides_t_end is None else self.slides_t_end


@dataclass(frozen=True)
class Calibration:
    """Factors of safety of the slope of median soil on both grids; the rough strength is multiplied by `factor`."""

    rough: float
    refined: float

    @property
    def factor(self) -> float:
        """Refined over rough factor of safety."""
        return self.refined / self.rough

    def check(self) -> None:
        """Raise ValueError for numbers that no slope has."""
        _above_zero("calibration", vars(self))


@dataclass(frozen=True)
class LimitLoad:
    """Of the refined slope of median soil: its factor of safety, and the failure displacement (m) that goes with it.
    volume: that exceeds it where a slope fails (m3, in a section m2); None in folders of before, where any particle
    did."""

    factor: float
    displacement: float
    volume: float | None = None

    def check(self) -> None:
        """Raise ValueError for numbers that no slope has."""
        _above_zero("limit_load", {name: value for name, value in vars(self).items() if value is not None})


@dataclass(frozen=True)
class Measured:
    """What a campaign measures before its first run, None where it is not known.

    terms: number of terms of each expansion of the random soil, in the order of `runs.RandomSoil.groups`. calibration:
    factors of safety of both grids. limit_load: where failure counts from it.
    """

    terms: tuple[int, ...] | None = None
    calibration: Calibration | None = None
    limit_load: LimitLoad | None = None

    def check(self) -> None:
        """Raise ValueError for numbers that no expansion and no slope has."""
        if self.terms is not None and (not self.terms or min(self.terms) < 1):
            raise ValueError(f"[field_modes] counts = {list(self.terms)}: give 1 or more for each expansion")
        for found in (self.calibration, self.limit_load):
            if found is not None:
                found.check()


def _above_zero(table: str, numbers: Mapping[str, float]) -> None:
    for name, value in numbers.items():
        if not 0 < value < float("inf"):
            raise ValueError(f"[{table}] {name} = {value:g}: give a finite value above 0")


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
    slides: how many failures slide on to their end, drawn along the ranks among all samples; the other refined runs end
    once they have failed, which is all that the probability asks. None lets all failures of the audit slide, 0 none.
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

    text: the TOML that it came from. name: of the campaign. site: where soil slides. soil: what slides, with the means
    of what varies, where a layer of the site does not say otherwise. random: what varies, by parameter of the soil.
    cross_correlation: of what varies, None without. grids: discretisation of "rough" and "refined". run: how each
    sample runs. plan: what the campaign does. measured: what the scene gives, or the folder has measured, of it.
    raised: refined runs that the campaign's folder allows beyond the scene. hazard: what is kept of slides for maps and
    exposed places, None where the scene asks for neither.
    """

    text: str
    name: str
    site: Site
    soil: Any  # a `jaxmpm.AnySoil`, and what a soil of the user's own adds
    random: Mapping[str, RandomField]
    cross_correlation: CrossCorrelation | None
    grids: Mapping[str, Discretisation]
    run: Run
    plan: Plan
    measured: Measured = Measured()
    raised: Budget | None = None
    hazard: Hazard | None = None

    @property
    def dimension(self) -> int:
        """2 for a section, 3 otherwise."""
        return len(self.site.shape.corner)

    @property
    def least_volume(self) -> str | None:
        """Least volume of soil that counts as a failure, with its unit; None where any particle does."""
        volume, unit = self.run.least_volume, "m3" if self.dimension == 3 else "m2"
        return None if volume is None else f"{volume:g} {unit}"

    @property
    def estimator(self) -> Estimator:
        """The campaign's estimator. ValueError where a script gave one that is not here."""
        if self.plan.estimator is None:
            given = tomllib.loads(self.text)["estimator"]["given"]
            raise ValueError(f"the campaign's estimator is {given}, which a script gave: give it, estimator={given}")
        return self.plan.estimator


def check_campaign(campaign: Campaign) -> None:
    """Ranges that no builder looks at."""
    ground.check_ground(campaign.site.shape)
    check_site(campaign.site, campaign.soil, campaign.grids["refined"].cell)
    run, plan, dimension = campaign.run, campaign.plan, campaign.dimension
    _above_zero("run", {name: getattr(run, name) for name in ("t_end", "gravity", "failure_displacement")})
    if run.slides_t_end is not None and not run.t_end <= run.slides_t_end < float("inf"):
        raise ValueError(
            f"[run] slides_t_end = {run.slides_t_end:g} s is before t_end = {run.t_end:g} s, up to which all runs go: "
            "give at least that, or leave it out"
        )
    if run.slides_t_end is not None and plan.slides == 0:
        raise ValueError(
            f"[run] slides_t_end = {run.slides_t_end:g} s has no say beside [campaign] slides = 0, which asks for no "
            "slides: leave one of them out"
        )
    _above_zero("campaign", {"restart_every": plan.restart_every})
    if run.least_volume is not None and not 0 < run.least_volume < ground.volume(campaign.site.shape):
        raise ValueError(
            f"[run] least_volume = {campaign.least_volume}: give more than 0 and less than the ground's "
            f"{ground.volume(campaign.site.shape):.4g}"
        )
    campaign.measured.check()
    for name, field in campaign.random.items():
        if len(field.length) != dimension:
            raise ValueError(f"[{name}] length has {len(field.length)} values: give {dimension}, one per axis")
    if campaign.cross_correlation is not None:
        check_cross_correlation(campaign.cross_correlation, campaign.random)
    for layer in campaign.site.layers:
        try:
            _check_own_fields(campaign, layer)
        except ValueError as error:
            raise ValueError(f"[{layer.name}]: {error}") from error
    _check_boreholes(campaign)
    for name, value in (
        ("samples", plan.samples),
        ("lanes", 1 if plan.lanes is None else plan.lanes),
        ("look_ahead", plan.look_ahead),
    ):
        if value < 1:
            raise ValueError(f"[campaign] {name} = {value}: give 1 or more")
    if plan.slides is not None and plan.slides < 0:
        raise ValueError(f"[campaign] slides = {plan.slides}: give 0 or more, or 'all'")
    if not 0 <= plan.seed < 2**63:
        raise ValueError(f"[campaign] seed = {plan.seed}: give 0 to 2^63 - 1")
    check_failure(campaign)
    if plan.screening_stop is not None and "rough" in plan.modes:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m ends rough runs before their mode shows: "
            "leave it out, or modes = 'both'"
        )


def _check_own_fields(campaign: Campaign, layer: SiteLayer) -> None:
    """Raise ValueError for fields that stop at a layer and have not its axes, or correlate with others that do not."""
    for name in layer.own:
        if len(layer.random[name].length) != campaign.dimension:
            raise ValueError(
                f"{name} length has {len(layer.random[name].length)} values: give {campaign.dimension}, one per axis"
            )
    if campaign.cross_correlation is None:
        return
    together = campaign.cross_correlation.parameters
    through = [name for name in together if name not in layer.own]
    if len(through) == len(together):
        return
    if through:
        raise ValueError(
            f"{', '.join(through)} has no field of its own here, and {', '.join(layer.own)}, with which it correlates, "
            "has: give a length to all of them, or to none"
        )
    check_cross_correlation(campaign.cross_correlation, layer.random)


def _check_boreholes(campaign: Campaign) -> None:
    """Raise ValueError for measured values that lie in a layer to which their field does not reach."""
    layers = campaign.site.layers
    fields: list[tuple[int | None, str, RandomField]] = [
        (None, name, field) for name, field in campaign.random.items() if campaign.site.spans(name)
    ]
    fields += [(number, name, each.random[name]) for number, each in enumerate(layers) for name in each.own]
    for number, name, field in fields:
        if field.boreholes is None or not any(name in each.own for each in layers):
            continue
        places = np.array([row[:-1] for row in field.boreholes]).T
        found = campaign.site.layer_of(places, campaign.grids["refined"])
        for row, layer in zip(field.boreholes, [] if found is None else found, strict=True):
            if (int(layer) if name in layers[layer].own else None) != number:
                raise ValueError(
                    f"a borehole value of {name} at {list(row[:-1])} m lies in {layers[layer].name}, to whose field it "
                    "does not belong: give it in the table of that layer, or in that of [soil] for a field that goes "
                    "through it"
                )


def check_failure(campaign: Campaign) -> None:
    """Raise ValueError for an estimator or a screening that does not go with the failure displacement."""
    plan, run = campaign.plan, campaign.run
    if plan.estimator is not None:
        plan.estimator.check(Sampling(plan.samples, run.failure_displacement, plan.screening_stop))
    if run.failure == "limit load" and campaign.measured.limit_load is None:
        return  # not known yet
    if plan.screening_stop is not None and plan.screening_stop < run.failure_displacement:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m is below the failure displacement of "
            f"{run.failure_displacement:g} m: give more, or leave it out"
        )
