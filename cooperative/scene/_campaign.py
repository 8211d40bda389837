"""The value of a campaign: what slides where, how each sample runs, what the campaign does.

Nothing in it changes.
"""

from __future__ import annotations

import copyreg
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar

import numpy as np
import shapely
from jax import Array
from jax.typing import ArrayLike

import kl
from cooperative.estimate import Estimator, Sampling, TwoPhase
from cooperative.measure import ElementAtRisk
from cooperative.scene import tables
from cooperative.scene._fields import TAIL, CrossCorrelation, RandomField, check_cross_correlation
from cooperative.scene._run import Run
from cooperative.scene._site import Site, SiteLayer, check_seams, check_site
from cooperative.scene.tables import Budget, Measured
from cooperative.store import Source
from jaxmpm import Discretisation, Settle, ground
from jaxmpm.run import least_failing_volume
from jaxmpm.soil import AnySoil

V = TypeVar("V")
WEIGHTS = ("unit_weight", "saturated_unit_weight")
THICKNESSES = 3.0
"""Mean thicknesses of the ground that limit the size of a slope: a slide in thin soil is no deeper than the soil."""


def _read_only(values: dict[str, V]) -> MappingProxyType[str, V]:
    return MappingProxyType(values)


# Python does not pickle read-only mappings, which campaigns and layers have, nor their type.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


@dataclass(frozen=True)
class Plan:
    """What the campaign does: samples and their coefficients, lanes of the screening, what is stored.

    Args:
        samples: of the first phase.
        rough_samples: of these, how many run on the rough grid, drawn by the coarse one; None where all do.
        seed: of their coefficients.
        coefficients: (key, samples, terms) -> (samples, terms), `kl.latin_hypercube`, `monte_carlo` or `sobol`.
        lanes: samples in one program at a time; None takes 1 on CPU, where lanes gain nothing, and 64 elsewhere.
        look_ahead: refined runs under way at once, in rank order; the answer depends on neither.
        screening_stop: displacement (m) at which a rough run is decided and ends, None runs it to its end.
        calibrate: measure the factors of safety of both grids first, and bring the rough strength down (or up) by them.
        valley: a slide is progressive where the rate at which soil lets go falls between two peaks to this share of the
            lesser one.
        restart_every: seconds of wall time after which a refined run writes a restart point, and again after as many.
        fields: grids whose final displacement and plastic strain are stored, and two frames of a failure.
        modes: grids whose failures get a mode, on ground that has a toe.
        slides: how many failures slide on to their end, drawn along the ranks among all samples; the other refined runs
            end once they have failed, which is all that the probability asks. None lets all failures of the audit
            slide, 0 none.
        annual_frequency: how often a year the trigger that the scene has comes, None where that is not known.
    """

    samples: int
    rough_samples: int | None = None
    seed: int = 0
    coefficients: Callable[[Array, int, int], ArrayLike] = kl.latin_hypercube
    lanes: int | None = None
    look_ahead: int = 1
    screening_stop: float | None = None
    calibrate: bool = False
    restart_every: float = 600.0
    valley: float = 0.5
    fields: tuple[str, ...] = ("refined",)
    modes: tuple[str, ...] = ("refined",)
    slides: int | None = None
    annual_frequency: float | None = None


@dataclass(frozen=True)
class Hazard:
    """What is stored of each refined slide for maps.

    Args:
        thickness: thresholds (m) whose exceedance is mapped.
        speed: thresholds (m/s) whose exceedance is mapped.
        every: steps from one look at the columns of cells to the next.
        places: elements at risk.
    """

    thickness: tuple[float, ...]
    speed: tuple[float, ...]
    every: int
    places: tuple[ElementAtRisk, ...]


@dataclass(frozen=True)
class Given:
    """Stands for an object that a script gave, where only its words are known.

    Args:
        what: field of the campaign.
        words: of the object.

    Raises:
        ValueError: when anything is asked of it.
    """

    what: str
    words: str

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        remedy = f"give it, {self.what}=..." if self.what == "estimator" else "run that script in this folder"
        raise ValueError(f"the campaign's {self.what} is {self.words}, which a script gave: {remedy}")


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """A campaign, written in Python or read from a scene; nothing in it changes.

    Args:
        ground: where soil slides: a `jaxmpm.Slope`, `Section` or `Terrain`, a class of one's own that meets
            `jaxmpm.Ground`, or a `Site` with layers and water.
        soil: what slides, with the means of what varies, where a layer does not have its own: a `jaxmpm.Soil`,
            `FrictionalSoil`, or a frozen dataclass of one's own that meets `jaxmpm.soil.AnySoil`.
        rough: discretisation of the rough grid; single precision unless it has a `dtype`.
        refined: discretisation of the refined grid, likewise.
        coarse: discretisation of a grid coarser than the rough one, on which all samples run first, or None for none.
        plan: samples, seed, and what the campaign does.
        random: what varies, by parameter of the soil.
        cross_correlation: of what varies, None without.
        run: how each sample runs.
        estimator: which refined runs there are and what is made of them: one of `cooperative`, or a frozen dataclass
            with the methods of `cooperative.Estimator`.
        hazard: what is stored of slides for maps and elements at risk, None for neither.
        name: of the campaign, one line.
        measured: terms, factors of safety and limit load that are known; a folder adds what it has measured.
        raised: refined runs that the campaign's folder allows beyond the estimator's.
        source: what it was read from, nothing where Python wrote or changed it.

    Raises:
        ValueError: numbers out of range, or parts that do not go together.
    """

    ground: Any
    soil: Any
    rough: Discretisation
    refined: Discretisation
    plan: Plan
    random: Mapping[str, RandomField] = field(default_factory=dict)
    cross_correlation: CrossCorrelation | None = None
    run: Run = Run()
    estimator: Estimator = TwoPhase()
    hazard: Hazard | None = None
    coarse: Discretisation | None = None
    name: str = "campaign"
    measured: Measured = Measured()
    raised: Budget | None = None
    source: Source = field(default=Source(None), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Put the ground into a site, means into the soil, a limit load into the run, and check what goes together."""
        if not isinstance(self.ground, Site | Given):
            object.__setattr__(self, "ground", Site(self.ground))
        for grid, numerics in self.grids.items():
            if numerics.dtype is None:
                object.__setattr__(self, grid, replace(numerics, dtype="float32"))
        object.__setattr__(self, "random", MappingProxyType(dict(self.random)))
        if self.measured.limit_load is not None:
            object.__setattr__(self, "run", self.run.failing_at(self.measured.limit_load))
        if isinstance(self.ground, Given) or isinstance(self.site.shape, Given) or isinstance(self.soil, Given):
            return  # of a folder whose script is not here, and checked when it began
        ground.check_ground(self.site.shape)
        object.__setattr__(self, "soil", _with_means(self.soil, self.random))
        if self.plan.slides == 0 or self.site.shape.face is None:
            object.__setattr__(self, "plan", replace(self.plan, modes=()))
        check_campaign(self)

    def made_from(self, source: Source) -> Campaign:
        """The campaign, newly made, with what it was read from; `replace` leaves that out of what it makes."""
        object.__setattr__(self, "source", source)
        return self

    @property
    def site(self) -> Site:
        """The ground with its layers, its water and what holds its ends."""
        site: Site = self.ground
        return site

    def settles(self, stop_at: float | None) -> Settle | None:
        """When one of its runs has settled; None for never.

        Args:
            stop_at: displacement (m) that decides its class, None where more than the class is asked for.
        """
        return self.run.settles(stop_at, self.site.softens_linearly(self.soil))

    @property
    def grids(self) -> Mapping[str, Discretisation]:
        """Discretisation of "rough" and "refined", and of "coarse" before them where there is such a grid."""
        coarse = {} if self.coarse is None else {"coarse": self.coarse}
        return {**coarse, "rough": self.rough, "refined": self.refined}

    @property
    def dimension(self) -> int:
        """2 for a section, 3 otherwise."""
        return len(self.site.shape.corner)

    @property
    def elements_at_risk(self) -> tuple[ElementAtRisk, ...]:
        """The elements at risk; none where the campaign has no hazard."""
        return self.hazard.places if self.hazard else ()

    @cached_property
    def failing_volume(self) -> float | None:
        """Least volume of soil (m3, in a section m2) whose motion is a failure, None where that of any particle is.

        The same on all grids. Where the run does not give it, that of a slope of height h
        (`jaxmpm.run.least_failing_volume`): h is the height of the slope, or THICKNESSES mean thicknesses of the ground
        where that is less, and no edge of the square or cube is longer than the ground. At least a particle of the
        coarsest grid.
        """
        if self.run.least_volume is not None:
            return self.run.least_volume or None
        shape, plan = self.site.shape, self.site.shape.extent[:-1]
        polygon = getattr(shape, "polygon", None)
        area = math.prod(plan) if polygon is None else shapely.Polygon(polygon).area
        height = min(self.site.height, THICKNESSES * ground.volume(shape) / area)
        volume = least_failing_volume(height, 1) * math.prod(min(height, edge) for edge in plan)
        particle = max(math.prod(grid.spacing) for grid in self.grids.values())
        return float(f"{max(volume, particle):.3g}")

    @property
    def least_volume(self) -> str | None:
        """The same with its unit, in words."""
        volume, unit = self.failing_volume, "m3" if self.dimension == 3 else "m2"
        return None if volume is None else f"{volume:g} {unit}"


def _with_means(soil: AnySoil, random: Mapping[str, RandomField]) -> AnySoil:
    """The soil with the means of what varies, where it leaves them out."""
    own = {each.name for each in fields(soil)} if is_dataclass(soil) else set()
    missing = {name: varies.mean for name, varies in random.items() if name in own and getattr(soil, name) is None}
    return replace(soil, **missing) if missing else soil


def check_grids(campaign: Campaign) -> None:
    """Check all discretisations; ValueError names the grid."""
    for name, grid in campaign.grids.items():
        try:
            ground.check_discretisation(grid, campaign.dimension)
        except ValueError as error:
            raise ValueError(f"[{name}] {error}") from error


def check_samples(campaign: Campaign) -> None:
    """Check what samples of a campaign need, and a factor of safety by slices does not.

    Args:
        campaign: the campaign.

    Raises:
        ValueError: nothing varies, or a weak layer is too thin for the cells of the refined grid.
    """
    if not campaign.random:
        raise ValueError(
            "nothing in the scene is random: give at least one parameter of the soil as a table, such as "
            "[soil.cohesion] with mean, cov and length"
        )
    check_seams(campaign.site, campaign.grids["refined"].cell)


def check_campaign(campaign: Campaign) -> None:
    """Ranges that no builder looks at."""
    check_site(campaign.site, campaign.soil)
    run, plan, dimension = campaign.run, campaign.plan, campaign.dimension
    for argument, table, value in (("run", tables.Run, run), ("plan", tables.Campaign, plan)):
        numbers = {name: each for name, each in vars(value).items() if isinstance(each, int | float)}
        try:
            tables.read(table, {name: each for name, each in numbers.items() if name in table.model_fields})
        except ValueError as error:
            raise ValueError(f"Campaign({argument}={type(value).__name__}(...)): {error}") from error
    run.check(campaign.dimension, campaign.site.softens_linearly(campaign.soil))
    own_start = [name for name in campaign.random if name in ("young", "poisson", *WEIGHTS)]
    own_start += [] if campaign.site.level is None else ["water level"]
    if campaign.site.ends == "free field" and own_start:
        raise ValueError(
            f"{own_start[0]} varies beside ends = 'free field', whose columns have the mean soil and its stress at "
            "rest: give it as a number, or take rollers"
        )
    _check_weights(campaign)
    if run.slides_t_end is not None and plan.slides == 0:
        raise ValueError(
            f"slides_t_end = {run.slides_t_end:g} s has no effect beside slides = 0, which asks for no slides: leave "
            "one of them out"
        )
    volume = ground.volume(campaign.site.shape)
    if campaign.failing_volume is not None and campaign.failing_volume >= volume:
        raise ValueError(
            f"least_volume = {campaign.least_volume}: give more than 0 and less than the ground's {volume:.4g}"
        )
    for layer in campaign.site.layers:
        try:
            _check_own_fields(campaign, layer)
        except ValueError as error:
            raise ValueError(f"{layer.label}: {error}") from error
    for name, varies in campaign.random.items():
        if len(varies.length) != dimension:
            raise ValueError(f"length of {name} has {len(varies.length)} values: give {dimension}, one per axis")
    if campaign.cross_correlation is not None:
        check_cross_correlation(campaign.cross_correlation, campaign.random)
    _check_boreholes(campaign)
    check_failure(campaign)
    if (campaign.coarse is None) != (plan.rough_samples is None):
        raise ValueError(f"rough_samples = {plan.rough_samples}, coarse = {campaign.coarse}: give both, or neither")
    for (wide, large), (fine, small) in pairwise((name, grid.cell) for name, grid in campaign.grids.items()):
        if small > large or (wide == "coarse" and small == large):
            raise ValueError(
                f"the {wide} grid has cells of {large:g} m, the {fine} one of {small:g} m: give [{wide}] larger cells"
            )
    if plan.screening_stop is not None and "rough" in plan.modes:
        raise ValueError(
            f"screening_stop = {plan.screening_stop:g} m ends rough runs before their mode shows: leave it out, or ask "
            "for modes of the refined grid alone"
        )


def _check_weights(campaign: Campaign) -> None:
    """Raise ValueError for weights that vary so much that soil below water floats in some sample."""
    site = campaign.site
    if site.water is None:
        return
    every: list[tuple[str, RandomField]] = []
    for label, random in (("", campaign.random), *((f"{each.label}: ", each.random) for each in site.layers)):
        below = WEIGHTS[1] if WEIGHTS[1] in random else WEIGHTS[0]
        every += [(f"{label}{below}", random[below])] if below in random else []
    for name, varies in every:
        least = varies.extremes(site.span)[0]
        if least <= ground.WATER_WEIGHT:
            raise ValueError(
                f"{name} comes down to {least:.4g} N/m3, {TAIL:g} deviations from the middle, no more than the "
                f"{ground.WATER_WEIGHT:g} of the water in the ground, in which soil then floats: give a smaller cov, "
                "or marginal = 'truncated normal' with lower and upper"
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
    through: list[tuple[int | None, str, RandomField]] = [
        (None, name, varies) for name, varies in campaign.random.items() if campaign.site.spans(name)
    ]
    through += [(number, name, each.random[name]) for number, each in enumerate(layers) for name in each.own]
    for number, name, varies in through:
        if varies.boreholes is None or not any(name in each.own for each in layers):
            continue
        positions = np.array([row[:-1] for row in varies.boreholes], float).T
        at = campaign.site.layer_of(positions, campaign.grids["refined"])
        assert at is not None  # there are layers
        own = np.array([name in each.own for each in layers])[at]
        foreign = np.flatnonzero(np.where(own, at, -1) != (-1 if number is None else number))
        if foreign.size:
            raise ValueError(_of_other_ground(campaign, name, positions[:, foreign], at[foreign]))


MOST_ROWS = 5
"""Borehole values that a message names."""


def _of_other_ground(campaign: Campaign, name: str, positions: np.ndarray, layer: np.ndarray) -> str:
    """Where measured values lie that do not belong to their field, in words.

    positions: of these values (d, n) m. layer: the number of the layer that each is in, or is nearest to (n,).
    """
    shape = campaign.site.shape
    surface, base = shape.heights(*positions[:-1]), shape.corner[-1]
    lines = []
    for at, top, number in zip(positions.T[:MOST_ROWS], surface, layer, strict=False):
        axes = zip("xy", shape.corner, shape.extent, at[:-1], strict=False)
        ends = [(axis, low, low + edge, x) for axis, low, edge, x in axes]
        beyond = [f"{axis} from {low:g} to {high:g} m" for axis, low, high, x in ends if not low <= x <= high]
        if beyond:
            where = f"beyond the walls of the ground, {', '.join(beyond)}"
        elif at[-1] > top:
            where = f"above the ground, whose surface is at {top:.4g} m there"
        elif at[-1] < base:
            where = f"below the base of the ground at {base:g} m"
        else:
            where = f"in {campaign.site.layers[number].name}"
        lines.append(f"at {[float(f'{x:.10g}') for x in at]} m {where}")
    count = positions.shape[1]
    more = f"; and {count - MOST_ROWS} more" if count > MOST_ROWS else ""
    subject = "1 borehole value" if count == 1 else f"{count} borehole values"
    return (
        f"{subject} of {name} in ground to whose field they do not belong: {'; '.join(lines)}{more}. Leave out what is "
        "outside the ground, and give the others to the field of their layer, or to one that goes through it"
    )


def check_failure(campaign: Campaign) -> None:
    """Raise ValueError for an estimator or a screening that does not go with the failure displacement."""
    plan, run = campaign.plan, campaign.run
    if not isinstance(campaign.estimator, Given):
        campaign.estimator.check(
            Sampling(plan.samples, run.failure_displacement, plan.screening_stop, rough_samples=plan.rough_samples)
        )
    if run.failure == "limit load" and campaign.measured.limit_load is None:
        return  # not known yet
    if plan.screening_stop is not None and plan.screening_stop < run.failure_displacement:
        raise ValueError(
            f"screening_stop = {plan.screening_stop:g} m is below the failure displacement of "
            f"{run.failure_displacement:g} m: give more, or leave it out"
        )
