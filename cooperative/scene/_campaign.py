"""The value of a campaign: what slides where, how each sample runs, what the campaign does.

Nothing in it changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, fields, is_dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import shapely
from pydantic import SkipValidation
from pydantic import model_validator as validates
from pydantic_core import ArgsKwargs

from cooperative.estimate import Estimator, Sampling, TwoPhase
from cooperative.measure import ElementAtRisk, front_thickness, size_of_slope
from cooperative.scene._plausible import Unusual
from cooperative.scene._site import Site, SiteLayer, check_site, has_friction
from cooperative.scene.tables import (
    CONDUCTIVITY,
    LIMITS,
    TAIL,
    Budget,
    CampaignGrid,
    CrossCorrelation,
    Drawdown,
    Exposed,
    FromScript,
    Hazard,
    Hydraulics,
    Measured,
    Motion,
    Part,
    Plan,
    Rain,
    RandomField,
    Run,
    Seepage,
    check_cross_correlation,
    table,
)
from cooperative.store import Source
from jaxmpm import BaseMotion, Discretisation, FrictionalSoil, Soil, ground
from jaxmpm.run import Rule, least_failing_volume
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Gathered, Invalid, at
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

if TYPE_CHECKING:
    from cooperative.scene._flow import CampaignFlow
    from jaxmpm.seepage import PressureInTime

WEIGHTS = ("unit_weight", "saturated_unit_weight")
APART = ("estimator", "coarse")
"""Parts of a campaign without which its samples run and its rows are read."""
BAND = 1 / 5
"""Thickness of the band to which softening refers, over the slope's height, where the soil gives none."""


@by_value
@table
class Campaign(Part):
    """A campaign, written in Python or read from a scene.

    Args:
        ground: where soil slides: a `jaxmpm.Slope`, `Section` or `Terrain`, a class of one's own that meets
            `jaxmpm.Ground`, or a `Site` with layers and water.
        soil: what slides, with the means of what varies, where a layer does not have its own: a `jaxmpm.Soil`,
            `FrictionalSoil`, or a frozen dataclass of one's own that meets `jaxmpm.soil.AnySoil`.
        rough: the rough grid.
        refined: the refined grid.
        plan: samples, seed, and what the campaign does.
        random: what varies, by parameter of the soil.
        cross_correlation: of what varies, None without.
        run: how each sample runs.
        motion: record of an earthquake that shakes the base, None for none.
        rain: that soaks into the ground, None for none.
        drawdown: of a river or reservoir, None for none.
        estimator: which refined runs there are and what is made of them: one of `cooperative`, or a frozen dataclass
            with the methods of `cooperative.Estimator`.
        hazard: what is stored of slides for maps, None where there are neither maps nor elements at risk.
        exposed: elements at risk.
        coarse: what all samples pass first, so that few run on the rough grid: a grid coarser than that, or a function
            that ranks them, `rank(campaign, coefficients)`. That is given the coefficients of all samples (samples,
            modes) and gives a number for each (samples,): the larger, the likelier its slope fails. "slices" names one
            that `run` is given. None for neither.
        name: of the campaign, one line.
        measured: terms, factors of safety and limit load that are known; a folder adds what it has measured.
        raised: refined runs that the campaign's folder allows beyond the estimator's.
        source: what it was read from, nothing where Python wrote it. What is changed after that keeps it.

    Raises:
        ValueError: numbers out of range, or parts that do not go together.
    """

    ground: Any
    soil: Any
    rough: CampaignGrid
    refined: CampaignGrid
    plan: Plan
    random: Mapping[str, RandomField] = field(default_factory=dict)
    cross_correlation: CrossCorrelation | None = None
    run: Run = Run()
    motion: Motion | None = None
    rain: Rain | None = None
    drawdown: Drawdown | None = None
    estimator: SkipValidation[Estimator] = TwoPhase()
    hazard: Hazard | None = None
    exposed: tuple[Exposed, ...] = ()
    coarse: CampaignGrid | FromScript | Literal["slices"] | Callable[..., Any] | None = None
    name: str = "campaign"
    measured: Measured = Measured()
    raised: Budget | None = None
    source: SkipValidation[Source] = field(default=Source(None), repr=False, compare=False)

    @validates(mode="before")
    @classmethod
    def _completed(cls, arguments: ArgsKwargs | dict[str, Any]) -> dict[str, Any]:
        """Complete what was given: ground alone is a site, soil has the means of what varies, a run its limit load."""
        values = dict(arguments if isinstance(arguments, dict) else arguments.kwargs or {})
        site, random, measured = (values.get(name) for name in ("ground", "random", "measured"))
        if site is not None and not isinstance(site, Site | FromScript):
            values["ground"] = Site(site)
        if isinstance(measured, Measured) and measured.limit_load is not None:
            values["run"] = values.get("run", Run()).failing_at(measured.limit_load)
        if is_dataclass(values.get("soil")):
            values["soil"] = _with_means(values["soil"], random or {})
        if isinstance(site := values.get("ground"), Site) and not any(_from_script(site)):
            ground.check_ground(site.shape)
            bands = partial(_with_band, height=site.height)
            layers = (replace(part, layer=replace(part.layer, soil=bands(part.layer.soil))) for part in site.layers)
            values |= {"ground": replace(site, layers=tuple(layers)), "soil": bands(values.get("soil"))}
        if values.get("exposed") and values.get("hazard") is None:
            values["hazard"] = Hazard()
        return values

    @validates(mode="after")
    def _together(self) -> Self:
        """Check what goes together, but for a folder whose script is not here, and which was checked when it began."""
        if all(missing.what in APART for missing in self.missing):
            check_campaign(self)
        return self

    @cached_property
    def missing(self) -> tuple[FromScript, ...]:
        """Objects that a script gave and that are not here: its folder knows their words."""
        return tuple(_from_script({part.name: getattr(self, part.name) for part in fields(self)}))

    def require(self, *parts: str) -> None:
        """Check that objects which a script gave are here.

        Args:
            *parts: of the campaign, none for all but the estimator and what ranks the samples.

        Raises:
            ValueError: one is not.
        """
        for missing in self.missing:
            if missing.what in parts or (not parts and missing.what not in APART):
                remedy = "give it, estimator=..." if missing.what == "estimator" else "run that script in this folder"
                rule = f"the campaign's {missing.what} is {missing.words}, which a script gave"
                raise Invalid((), None, rule, remedy)

    @property
    def site(self) -> Site:
        """The ground with its layers, its water and what holds its ends."""
        site: Site = self.ground
        return site

    @property
    def varies(self) -> bool:
        """Whether anything in it is random: soil, contact, conductivity or water level."""
        return bool(self.random) or bool(self.conductivities) or self.site.level is not None

    def check_sample(self, number: int | None) -> None:
        """Check the number of a sample.

        Args:
            number: of the sample, None for median soil.

        Raises:
            Invalid: it has no such sample.
        """
        if number is None:
            return
        if not self.varies:
            raise Invalid(("sample",), str(number), "is given, and nothing in the scene is random", "leave it out")
        if not 0 <= number < self.plan.samples:
            raise Invalid(("sample",), str(number), "", f"the scene has samples 0 to {self.plan.samples - 1}")

    @property
    def hydraulics(self) -> tuple[tuple[Hydraulics, ...], ...]:
        """The tables of the flow from which each layer, or all of the ground, has its numbers; none without water."""
        table = self.seepage
        if table is None:
            return ()
        layers = tuple(table.hydraulics(layer.name, rock=layer.rock) for layer in self.site.layers)
        return layers or (table.hydraulics(),)

    @cached_property
    def conductivities(self) -> Mapping[int | None, RandomField]:
        """Conductivity that varies, by the layer at which its field stops, None where it goes through all."""
        table, random = self.seepage, dict[int | None, RandomField]()
        for number, tables in enumerate(self.hydraulics):
            source = next((table for table in tables if table.conductivity is not None), None)
            if source is not None and isinstance(source.conductivity, RandomField):
                whole = table is not None and source is table.soil
                random[None if whole else number] = source.conductivity
        return random

    @property
    def varying(self) -> Mapping[str, RandomField]:
        """What varies by a field that may go through all layers, by parameter of the soil or the flow."""
        through = self.conductivities.get(None)
        return self.random if through is None else {**self.random, CONDUCTIVITY: through}

    def varying_in(self, number: int) -> Mapping[str, RandomField]:
        """What varies by a field that stops at a layer of this number, by parameter of the soil or the flow."""
        layer, flows = self.site.layers[number], self.conductivities.get(number)
        stopping = {name: field for name, field in layer.random.items() if name in layer.stopping}
        return stopping if flows is None else {**stopping, CONDUCTIVITY: flows}

    def drained(self) -> Campaign:
        """The campaign whose soil keeps its pore pressure, as until it fails; itself where no soil has a B-value.

        Raises:
            Invalid: B-values that are random.
        """
        site, random = self.site, (self.random, *(layer.random for layer in self.site.layers))
        if any("b_value" in fields for fields in random):
            raise Invalid(
                ("b_value",), None, "is random, and whether a slope stands is asked of drained soil",
                "give it as a number",
            )  # fmt: skip
        if not any(getattr(layer.soil, "b_value", None) for layer in site.soils(self.soil)):
            return self
        layers = (replace(part, layer=replace(part.layer, soil=_drained(part.layer.soil))) for part in site.layers)
        return replace(self, soil=_drained(self.soil), ground=replace(site, layers=tuple(layers)))

    @property
    def rank(self) -> Callable[..., Any] | FromScript | str | None:
        """What ranks the samples in place of a coarse grid, or its name; None without."""
        return None if isinstance(self.coarse, CampaignGrid) else self.coarse

    @property
    def modes(self) -> tuple[str, ...]:
        """Grids whose failures get a mode: none where no slide comes to its end, or the ground has no toe."""
        return () if self.plan.slides == 0 or self.site.shape.face is None else self.plan.modes

    @cached_property
    def shaking(self) -> BaseMotion | None:
        """The motion of the base along the axes of the ground (m/s2), None for none."""
        return None if self.motion is None else self.motion.of_base(self.dimension)

    @property
    def seepage(self) -> Seepage | None:
        """Water that moves, None where none does."""
        return self.rain if self.drawdown is None else self.drawdown

    def resting_at(self, time: float | str) -> Campaign:
        """The campaign whose samples rest under the pore pressure of another time.

        Args:
            time: s, or a text such as "12 h".

        Raises:
            Invalid: no water moves in it, or the time is after the last one.
        """
        at: Any = time  # the table reads texts
        if self.drawdown is not None:
            return replace(self, drawdown=replace(self.drawdown, at=at))
        if self.rain is None:
            raise Invalid(("time",), shown(time), "is for a scene with [rain] or [drawdown]", "leave it out")
        return replace(self, rain=replace(self.rain, at=at))

    @cached_property
    def flowing(self) -> CampaignFlow:
        """The flow of its water, to be solved with one conductivity or another."""
        from cooperative.scene._flow import CampaignFlow

        solver = None if self.site.pressure is None else self.site.pressure.flowing
        return CampaignFlow.of(self) if solver is None else solver

    @cached_property
    def flow(self) -> PressureInTime:
        """Pore pressure in time of the water that moves, solved when first asked for unless ground rests in it."""
        from cooperative.scene._flow import flow_of

        return flow_of(self) if self.site.pressure is None else self.site.pressure.flow

    @property
    def loads(self) -> dict[str, Any]:
        """What loads the ground, as `jaxmpm.ground.build_ground` takes it; None for what is absent."""
        run = self.run
        return {"gravity": run.gravity, "k_h": run.k_h or None, "k_v": run.k_v or None, "motion": self.shaking}

    def rules(self, limit: float | None = None) -> tuple[Rule, ...]:
        """What ends one of its runs before its end time.

        Args:
            limit: displacement (m) that decides its class, None where more than the class is asked for.
        """
        shaken, softens = self.motion is not None, self.site.softens_linearly(self.soil)
        return self.run.rules(limit, self.failing_volume, softens=softens, shaken=shaken)

    def decided_at(self, grid: str, *, slides: bool = False) -> float | None:
        """Displacement (m) at which runs of a grid end, None where more is asked of them than a rank or a class.

        Args:
            grid: "coarse", "rough" or "refined".
            slides: whether they go on to the end of their slides.
        """
        fails, plan = self.run.failure_displacement, self.plan
        refined = None if slides or plan.slides is None else fails
        return {"coarse": fails, "rough": plan.screening_stop, "refined": refined}[grid]

    @cached_property
    def grids(self) -> Mapping[str, Discretisation]:
        """Discretisation of "rough" and "refined", and of "coarse" before them where there is such a grid."""
        named = {"coarse": self.coarse, "rough": self.rough, "refined": self.refined}
        endless = self.site.ends in ("tied", "free field")
        return {
            name: grid.discretisation(self.run.cfl, self.soil, endless=endless)
            for name, grid in named.items()
            if isinstance(grid, CampaignGrid)
        }

    @property
    def dimension(self) -> int:
        """2 for a section, 3 otherwise."""
        return len(self.site.shape.corner)

    @property
    def elements_at_risk(self) -> tuple[ElementAtRisk, ...]:
        """The elements at risk; none where the campaign has none."""
        return tuple(exposed.element for exposed in self.exposed)

    @cached_property
    def failing_volume(self) -> float | None:
        """Least volume of soil (m3, in a section m2) whose motion is a failure, None where that of any particle is.

        The same on all grids. Where the run does not give it, that of a slope of height h
        (`jaxmpm.run.least_failing_volume`): h is its size (`cooperative.measure.size_of_slope`), and no edge of the
        square or cube is longer than the ground. At least a particle of the coarsest grid.
        """
        if self.run.least_volume is not None:
            return self.run.least_volume or None
        size, plan = self._size, self.site.shape.extent[:-1]
        volume = least_failing_volume(size, 1) * math.prod(min(size, edge) for edge in plan)
        particle = max(math.prod(grid.spacing) for grid in self.grids.values())
        return float(f"{max(volume, particle):.3g}")

    @cached_property
    def _size(self) -> float:
        """Size of the slope (m), see `cooperative.measure.size_of_slope`."""
        shape = self.site.shape
        polygon = getattr(shape, "polygon", None)
        area = math.prod(shape.extent[:-1]) if polygon is None else shapely.Polygon(polygon).area
        return size_of_slope(self.site.height, ground.volume(shape) / area)

    @property
    def runout_thickness(self) -> float:
        """Thickness of the deposit (m) at the front of the run-out, the same on all grids; 0 for the foremost soil."""
        thickness = self.run.runout_thickness
        return front_thickness(self._size) if thickness is None else thickness

    @property
    def least_volume(self) -> str | None:
        """`failing_volume` with its unit, in words."""
        volume, unit = self.failing_volume, "m3" if self.dimension == 3 else "m2"
        return None if volume is None else f"{volume:g} {unit}"


def _from_script(value: object) -> Iterator[FromScript]:
    """What stands in a value, and in what it holds, for objects of a script."""
    if isinstance(value, FromScript):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from _from_script(part)
    elif isinstance(value, tuple):
        for part in value:
            yield from _from_script(part)
    elif is_dataclass(value) and not isinstance(value, type):
        for field_of_it in fields(value):
            yield from _from_script(getattr(value, field_of_it.name, None))


def _drained(soil: AnySoil) -> AnySoil:
    """The soil with a B-value of 0, itself without one."""
    changed: Any = soil
    return replace(changed, b_value=0.0) if getattr(soil, "b_value", None) else soil


def _with_means(soil: AnySoil, random: Mapping[str, RandomField]) -> AnySoil:
    """The soil with the means of what varies, where it leaves them out."""
    names = {part.name for part in fields(soil)} if is_dataclass(soil) else set()
    missing = {name: varies.mean for name, varies in random.items() if name in names and getattr(soil, name) is None}
    return replace(soil, **missing) if missing else soil


def _with_band(soil: Any, height: float) -> Any:
    """Soil of the packages whose softening refers to a band of known thickness, also where it leaves that out."""
    if isinstance(soil, Soil | FrictionalSoil) and soil.softens and soil.softening_length is None and height > 0:
        return replace(soil, softening_length=BAND * height)
    return soil


def check_grids(campaign: Campaign) -> None:
    """Check all discretisations; the grid of each fault is named."""
    gathered = Gathered()
    for name, grid in campaign.grids.items():
        with gathered.of(), at(name):
            ground.check_discretisation(grid, campaign.dimension)
    gathered.raise_all()


def check_samples(campaign: Campaign) -> None:
    """Check that samples of a campaign differ.

    Args:
        campaign: the campaign.

    Raises:
        ValueError: nothing varies.
    """
    if not campaign.varies:
        raise Invalid(
            (), None, "nothing in the scene is random, so all samples are alike",
            "`jaxmpm slide` runs this one slope, and `jaxmpm fos` gives its factor of safety; for a probability give "
            "at least one parameter of the soil as a table, such as [soil.cohesion] with mean, cov and length",
        )  # fmt: skip


def check_cells(campaign: Campaign, grid: str = "refined") -> None:
    """Check what the solver's grids need, and a factor of safety by slices does not.

    Args:
        campaign: the campaign.
        grid: by name.

    Raises:
        Invalid: a weak layer is too thin for the cells of the grid.
    """
    for layer, thickness in zip(campaign.site.layers, campaign.site.thicknesses, strict=True):
        thin = thickness.too_thin(campaign.grids[grid].cell)
        if thin is not None and not getattr(layer.layer.soil, "unusual", False):
            raise Unusual((layer.label,), None, f"{thin} If that is intended, give its soil unusual = true", "")


def check_campaign(campaign: Campaign) -> None:
    """Ranges that no builder looks at."""
    gathered, run = Gathered(), campaign.run
    with gathered.of():
        check_site(campaign.site, campaign.soil, moves=campaign.seepage is not None)
    with gathered.of():
        check_moving(campaign)
    with gathered.of():
        run.check_early(softens=campaign.site.softens_linearly(campaign.soil), shaken=campaign.motion is not None)
    with gathered.of():
        _check_elements(campaign.elements_at_risk)
    for check in (_check_run, _check_weights, _check_fields, check_failure, _check_sizes_of_cells):
        with gathered.of():
            check(campaign)
    gathered.raise_all()


def _check_run(campaign: Campaign) -> None:
    """Raise ValueError for what runs do that does not go with the ground and what varies in it."""
    run, plan = campaign.run, campaign.plan
    weakens = [loss for part in campaign.site.soils(campaign.soil) if (loss := getattr(part.soil, "loss_time", None))]
    if weakens and run.failure == "limit load":
        rule = f"beside loss_time = {weakens[0]:g} s, over which strength falls, so that no load is its limit"
        raise Invalid(("failure",), "'limit load'", rule, "take a displacement")
    if campaign.shaking is not None and (duration := float(campaign.shaking.duration)) > run.t_end * (1 + 1e-6):
        rule = f"lasts {duration:g} s, beyond t_end = {run.t_end:g} s at which runs end"
        remedy = f"give t_end = {duration:g} or more, or cut the record"
        raise Invalid(("the motion of the base",), None, rule, remedy, beside=("t_end",))
    starts = [name for name in campaign.random if name in ("young", "poisson", *WEIGHTS)]
    starts += [] if campaign.site.level is None else ["water level"]
    if campaign.site.ends == "free field" and starts:
        rule = "varies beside ends = 'free field', whose columns have the mean soil and its stress at rest"
        raise Invalid((starts[0],), None, rule, "give it as a number, or take rollers")
    if run.slides_t_end is not None and plan.slides == 0:
        rule = "has no effect beside slides = 0, which asks for no slides"
        raise Invalid(("slides_t_end",), f"{run.slides_t_end:g} s", rule, "leave one of them out")
    volume = ground.volume(campaign.site.shape)
    if campaign.failing_volume is not None and campaign.failing_volume >= volume:
        remedy = f"give more than 0 and less than the ground's {volume:.4g}"
        raise Invalid(("least_volume",), campaign.least_volume, "", remedy)
    if plan.screening_stop is not None and "rough" in campaign.modes:
        remedy = "leave it out, or ask for modes of the refined grid alone"
        raise Invalid(
            ("screening_stop",), f"{plan.screening_stop:g} m", "ends rough runs before their mode shows", remedy
        )


def _check_fields(campaign: Campaign) -> None:
    """Raise ValueError for fields that do not go with the ground, its layers or each other."""
    gathered, dimension = Gathered(), campaign.dimension
    for number, layer in enumerate(campaign.site.layers):
        with gathered.of():
            _check_fields_of(campaign, number, layer)
    for name, varies in campaign.varying.items():
        if len(varies.length) != dimension:
            rule = f"has a length of {len(varies.length)} values"
            remedy = f"give {dimension}, one per axis"
            gathered.faults.append(Invalid((name,), None, rule, remedy, beside=("length",)))
    gathered.raise_all()
    if campaign.cross_correlation is not None:
        with gathered.of():
            check_cross_correlation(campaign.cross_correlation, campaign.varying)
    _check_boreholes(campaign, gathered)
    gathered.raise_all()


def _check_sizes_of_cells(campaign: Campaign) -> None:
    """Raise ValueError for grids of which a finer one has larger cells, and for a coarse one without its samples."""
    plan = campaign.plan
    if (campaign.coarse is None) != (plan.rough_samples is None):
        has, lacks = ("a coarse grid", "rough_samples")[:: 1 if campaign.coarse else -1]
        beside = ("coarse", "rough_samples")
        raise Invalid(("the campaign",), None, f"has {has} without {lacks}", "give both, or neither", beside=beside)
    if campaign.rank == "slices" and campaign.dimension == 3:
        raise Invalid(("coarse",), "'slices'", "is for sections, not for ground in 3D", "give a coarse grid")
    for (wide, large), (fine, small) in pairwise((name, grid.cell) for name, grid in campaign.grids.items()):
        if small > large or (wide == "coarse" and small == large):
            rule = f"has cells of {large:g} m, the {fine} one of {small:g} m"
            raise Invalid((f"the {wide} grid",), None, rule, f"give [{wide}] larger cells", beside=("cell",))


def check_moving(campaign: Campaign) -> None:
    """Check that water which moves goes with the rest of a campaign.

    Args:
        campaign: the campaign.

    Raises:
        Invalid: what its pressure does not act on, or what gives another pressure.
    """
    table, site = campaign.seepage, campaign.site
    if table is None:
        return
    name = "rain" if campaign.drawdown is None else "drawdown"
    table.check_complete()
    if campaign.rain is not None and campaign.drawdown is not None:
        raise Invalid(("drawdown",), None, "is given beside rain, and each has rate and level", "leave one out")
    if table.water_tables is not None and campaign.dimension == 2:
        rule = "are rasters in plan, and the ground is a section"
        raise Invalid((name, "water_tables"), None, rule, "give pressure, rows of x, z, t and head")
    if site.r_u is not None:
        rule = f"beside {name}, whose flow gives the pore pressure"
        raise Invalid(("r_u",), f"{site.r_u:g}", rule, "leave one out")
    if site.level is not None:
        rule = f"is random beside {name}, whose flow begins with one level"
        raise Invalid(("the water level",), None, rule, "give its mean")
    if site.ends == "free field":
        rule = f"beside {name}, whose pressure the columns do not have"
        raise Invalid(("ends",), "'free field'", rule, "take rollers")
    soils = site.soils(campaign.soil)
    if not any(has_friction(layer.soil) for layer in soils):
        rule = "acts on undrained soil, whose strength does not depend on pore pressure"
        raise Invalid((name,), None, rule, "give cohesion and friction")
    if site.by_stress(campaign.soil) is not None:
        rule = f"is given beside {name}, whose pressure is not that of consolidation"
        raise Invalid(("strength_ratio",), None, rule, "give strength")
    parameters = [name for random in (campaign.random, *(layer.random for layer in site.layers)) for name in random]
    if weights := [parameter for parameter in parameters if parameter in WEIGHTS]:
        rule = f"varies beside {name}, in which weight follows the water"
        raise Invalid((weights[0],), None, rule, "give it as a number")
    names = [layer.name for layer in site.layers]
    for position, layer in enumerate(table.layer):
        if layer.name not in names:
            remedy = f"give one of {', '.join(map(shown, names))}" if names else "it has none, give soil instead"
            path = (name, "layer", position, "name")
            raise Invalid(path, shown(layer.name), "is no [[layer]] of the ground", remedy)
    for where, conducts in campaign.conductivities.items():
        with at(*((name, "soil") if where is None else (name, "layer", site.layers[where].name)), CONDUCTIVITY):
            if (source := table.given_by) is not None:
                rule = f"varies beside {source}, in which another program's flow has one answer for all samples"
                raise Invalid((), None, rule, "give it as a number")
            conducts.check(LIMITS[CONDUCTIVITY], site.span)


def _check_elements(elements: tuple[ElementAtRisk, ...]) -> None:
    """Raise ValueError for elements at risk that rows cannot tell apart."""
    keys = [element.key for element in elements]
    for element in elements:
        if not element.key or keys.count(element.key) > 1:
            rule = f"is there {keys.count(element.key)} times as {element.key!r}"
            raise Invalid(("exposed", "name"), repr(element.name), rule, "name each otherwise, with letters or digits")


def _check_weights(campaign: Campaign) -> None:
    """Raise ValueError for weights that vary so much that soil below water floats in some sample."""
    site = campaign.site
    if site.water_table is None:
        return
    every: list[tuple[str, RandomField]] = []
    for label, random in (("", campaign.random), *((f"{layer.label}: ", layer.random) for layer in site.layers)):
        below = WEIGHTS[1] if WEIGHTS[1] in random else WEIGHTS[0]
        every += [(f"{label}{below}", random[below])] if below in random else []
    for name, varies in every:
        least = varies.extremes(site.span)[0]
        if least <= ground.WATER_WEIGHT:
            raise Invalid(
                (name,), None,
                f"comes down to {least:.4g} N/m3, {TAIL:g} deviations from the middle, no more than the "
                f"{ground.WATER_WEIGHT:g} of the water in the ground, in which soil then floats",
                "give a smaller cov, or marginal = 'truncated normal' with lower and upper",
            )  # fmt: skip


def _check_fields_of(campaign: Campaign, number: int, layer: SiteLayer) -> None:
    """Raise ValueError for fields that stop at a layer and have not its axes, or correlate with others that do not."""
    varying = campaign.varying_in(number)
    for name, varies in varying.items():
        if len(varies.length) != campaign.dimension:
            rule = f"has a length of {len(varies.length)} values"
            remedy = f"give {campaign.dimension}, one per axis"
            raise Invalid((f"{layer.label}: {name}",), None, rule, remedy, beside=("length",))
    if campaign.cross_correlation is None:
        return
    together = campaign.cross_correlation.parameters
    through = [name for name in together if name not in varying]
    if len(through) == len(together):
        return
    if through:
        rule = f"has a field of {', '.join(varying)} alone, and not of {', '.join(through)}, with which it correlates"
        raise Invalid((layer.label,), None, rule, "give a length to all of them, or to none")
    with at(layer.label):
        check_cross_correlation(campaign.cross_correlation, varying)


def _check_boreholes(campaign: Campaign, gathered: Gathered) -> None:
    """Gather measured values that lie in a layer to which their field does not reach."""
    layers = campaign.site.layers
    through: list[tuple[int | None, str, RandomField]] = [
        (None, name, varies) for name, varies in campaign.varying.items() if campaign.site.spans(name)
    ]
    of_layers = [campaign.varying_in(number) for number in range(len(layers))]
    through += [(number, name, varies) for number, varying in enumerate(of_layers) for name, varies in varying.items()]
    for number, name, varies in through:
        if varies.boreholes is None or not any(name in varying for varying in of_layers):
            continue
        positions = np.array([row[:-1] for row in varies.boreholes], float).T
        of_layer = campaign.site.layer_of(positions, campaign.grids["refined"])
        assert of_layer is not None  # there are layers
        stops = np.array([name in varying for varying in of_layers])[of_layer]
        foreign = np.flatnonzero(np.where(stops, of_layer, -1) != (-1 if number is None else number))
        if foreign.size:
            gathered.faults.append(_of_other_ground(campaign, name, positions[:, foreign], of_layer[foreign]))


MOST_ROWS = 5
"""Borehole values that a message names."""


def _of_other_ground(campaign: Campaign, name: str, positions: np.ndarray, layer: np.ndarray) -> Invalid:
    """Measured values that do not belong to their field, and where they lie.

    positions: of these values (d, n) m. layer: the number of the layer that each is in, or is nearest to (n,).
    """
    shape = campaign.site.shape
    surface, base = shape.heights(*positions[:-1]), shape.corner[-1]
    lines = []
    for point, top, number in zip(positions.T[:MOST_ROWS], surface, layer, strict=False):
        axes = zip("xy", shape.corner, shape.extent, point[:-1], strict=False)
        ends = [(axis, low, low + edge, x) for axis, low, edge, x in axes]
        beyond = [f"{axis} from {low:g} to {high:g} m" for axis, low, high, x in ends if not low <= x <= high]
        if beyond:
            where = f"beyond the walls of the ground, {', '.join(beyond)}"
        elif point[-1] > top:
            where = f"above the ground, whose surface is at {top:.4g} m there"
        elif point[-1] < base:
            where = f"below the base of the ground at {base:g} m"
        else:
            where = f"in {campaign.site.layers[number].name}"
        lines.append(f"at {[float(f'{x:.10g}') for x in point]} m {where}")
    count = positions.shape[1]
    more = f"; and {count - MOST_ROWS} more" if count > MOST_ROWS else ""
    subject = "1 borehole value" if count == 1 else f"{count} borehole values"
    return Invalid(
        (name,), None,
        f"has {subject} in ground to whose field they do not belong, {'; '.join(lines)}{more}",
        "leave out what is outside the ground, and give the others to the field of their layer, or to one that goes "
        "through it",
    )  # fmt: skip


def check_failure(campaign: Campaign) -> None:
    """Raise ValueError for an estimator or a screening that does not go with the failure displacement."""
    plan, run = campaign.plan, campaign.run
    if not isinstance(campaign.estimator, FromScript):
        with at("campaign"):
            campaign.estimator.check(
                Sampling(plan.samples, run.failure_displacement, plan.screening_stop, rough_samples=plan.rough_samples)
            )
    if run.failure == "limit load" and campaign.measured.limit_load is None:
        return  # not known yet
    if plan.screening_stop is not None and plan.screening_stop < run.failure_displacement:
        rule = f"is below the failure displacement of {run.failure_displacement:g} m"
        value, remedy = f"{plan.screening_stop:g} m", "give more, or leave it out"
        raise Invalid(("screening_stop",), value, rule, remedy, beside=("failure_displacement",))
