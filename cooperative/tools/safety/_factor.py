"""The factor of safety of a campaign's slope, by limit equilibrium and by the solver's limit load."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

import jaxmpm
from cooperative.measure import walls_reached
from cooperative.runs import GridModel, RandomSoil, build, coefficients_of, random_soil, under_own_flow
from cooperative.scene import (
    Campaign,
    RandomField,
    Site,
    check_cells,
    doubts,
    failing_volume,
    limit_load_factor,
    rested,
)
from cooperative.tools.safety._moving import MovingWater
from cooperative.tools.safety._search import Critical, critical_surface
from cooperative.tools.safety._slices import Slices, Strength
from jaxmpm import Layer, Raster, Scene, Section, State, diagnostics
from jaxmpm.ground import as_section
from jaxmpm.laws import WaterTable, declared
from jaxmpm.run import FactorOfSafety
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check
from jaxmpm.support.values import by_value

APART = 0.02
"""Share by which two factors of safety differ before reasons are given."""
STRETCHED = 0.03
"""Share of a slip surface in tension from which on a crack changes the factor."""
BESIDE = 0.02
"""How far above the factor of the limit load the slope is drawn, over that factor."""
CELLS_DEEP = 8
"""Cells over the depth of what slides from which on their size changes a factor of safety little."""
UNIFORM = 1e-6
"""Share by which strength of a layer that does not vary differs by rounding."""
NEIGHBOURS = 4
"""Particles from which strength between them is interpolated."""

STRENGTHS = (0, 1)
"""Places of cohesion and friction in what a `Strength` gives."""
UNUSED = ("young", "poisson", "softening_modulus", "residual_ratio", "strain_95", "dilation", "tension_cutoff",
          "residual_cohesion", "residual_friction", "softening_strain", "loss_time", "k0", "b_value")  # fmt: skip
"""Parameters whose variation limit equilibrium has no use for."""

Water = float | Sequence[Sequence[float]] | None
"""Level or points of a water table (m), None without."""
Progress = Callable[[Sequence[float], Sequence[float]], None]


@by_value
@dataclass(frozen=True)
class Safety:
    """Factors of safety of a slope.

    Args:
        soil: whose it is, in words.
        loads: beside its weight, and the change of the water, in words.
        grid: of the solver, in words.
        shape: outline of the section, None where limit equilibrium does not apply.
        layers: of the section.
        water: points (n, 2) m of the water table of the section, None without.
        equilibrium: by limit equilibrium.
        frictional: whether soil of the section has friction; in clay alone Bishop's moments are exact on circles.
        seconds: that limit equilibrium took.
        solver: by the limit load.
        failing: scene and state of the slope, just beyond its limit load.
        notes: why one of them is missing.
        reasons: why they differ.
        doubts: why the solver's is not the whole answer.
        unit: of volumes.
    """

    soil: str
    loads: tuple[str, ...]
    grid: str
    shape: Section | None = None
    layers: tuple[Layer, ...] = ()
    water: np.ndarray | None = None
    equilibrium: Critical | None = None
    frictional: bool = True
    seconds: float = 0.0
    solver: FactorOfSafety | None = None
    failing: tuple[Scene, State] | None = None
    notes: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    unit: str = "m2"

    @property
    def difference(self) -> float | None:
        """By how much the solver's factor exceeds that of limit equilibrium, as a share of it."""
        if self.equilibrium is None or self.solver is None or self.solver.kink is None:
            return None
        return self.solver.kink / self.equilibrium.slip.factor - 1


def factor_of_safety(
    campaign: Campaign,
    *,
    k_h: float | None = None,
    water: float = 0.0,
    sample: int | None = None,
    grid: str = "refined",
    solver: bool = True,
    progress: Progress | None = None,
    announce: Callable[[Safety], None] | None = None,
) -> Safety:
    """The factor of safety of a campaign's slope by slices and by the solver's limit load.

    Both have the same soil, water and earthquake. Limit equilibrium applies to sections.

    Args:
        campaign: the campaign.
        k_h: pseudo-static horizontal acceleration over gravity, as `jaxmpm.section`, below 0 the other way; None for
            the scene's own.
        water: by how much the water level is raised (m).
        sample: number of the sample whose soil it is, None for median soil.
        grid: "rough" or "refined", of the solver, and of the field at slip surfaces.
        solver: whether the limit load is computed, which takes minutes.
        progress: as for `jaxmpm.factor_of_safety`.
        announce: called with the result of limit equilibrium before the solver begins.

    Returns:
        Both factors, with the reasons why they differ.

    Raises:
        ValueError: an argument does not go with the campaign, or there is no factor at all.
    """
    check.finite("water", water, "m")
    if k_h is not None:
        check.between("k_h", k_h, -1.0, 1.0)
        campaign = replace(campaign, run=replace(campaign.run, k_h=k_h))
    run = campaign.run
    loads = [f"{name} = {value:g}" for name, value in (("k_h", run.k_h), ("k_v", run.k_v)) if value]
    loads += [f"water {water:+g} m"] * (water != 0) + ["without its motion"] * (campaign.motion is not None)
    if water:
        campaign = replace(campaign, ground=_raised(campaign, water))
    if campaign.seepage is not None:
        loads.append(f"water at {campaign.seepage.moment / 3600:g} h")
        campaign = rested(campaign)
    campaign = of_own_flow(campaign, sample)
    size = f"{grid} grid, cells of {campaign.grids[grid].cell:g} m"
    unit = "m3" if campaign.dimension == 3 else "m2"
    result = Safety("median soil" if sample is None else f"soil of sample {sample}", tuple(loads), size, unit=unit)
    model, coefficients = None, None
    median = _median(campaign) if sample is None else None
    if median is None:
        model, coefficients = _built(campaign, grid, sample)
        median = _of_particles(model, coefficients)
    result = _by_slices(result, campaign, *median)
    if not solver and result.equilibrium is None:
        raise ValueError(result.notes[0])
    if announce is not None:
        announce(result)
    if not solver:
        return result
    try:
        check_cells(campaign, grid)
        if model is None:
            model, coefficients = _built(campaign, grid, sample)
    except ValueError as error:
        if result.equilibrium is None:
            raise
        return replace(result, notes=(*result.notes, f"the solver gives no factor of safety: {error}"))
    return _by_solver(result, model, coefficients, progress)


def of_own_flow(campaign: Campaign, sample: int | None) -> Campaign:
    """The campaign whose ground rests under the pressure of a sample's flow; itself where all have the same.

    Args:
        campaign: the campaign.
        sample: its number, None for median soil.

    Raises:
        ValueError: the campaign has no such sample.
    """
    campaign.check_sample(sample)
    if not campaign.conductivities:
        return campaign
    return under_own_flow(campaign, *_drawn(campaign, sample))


def _drawn(campaign: Campaign, sample: int | None) -> tuple[RandomSoil, np.ndarray | None]:
    """What is random, and the coefficients of a sample, None for median soil."""
    soil = random_soil(campaign)
    return soil, None if sample is None else coefficients_of(campaign, soil)[sample]


def _built(campaign: Campaign, grid: str, sample: int | None) -> tuple[GridModel, np.ndarray | None]:
    """A grid, and the coefficients of a sample on it, None for median soil."""
    soil, coefficients = _drawn(campaign, sample)
    return build(campaign, grid, soil, at_rest=False), coefficients


def _raised(campaign: Campaign, by: float) -> Site:
    """The site of a campaign with its water by so much higher (m); ValueError without any."""
    site = campaign.site
    if site.water is None or site.water_table is None:
        water = "no [water]" if campaign.site.r_u is None else f"r_u = {campaign.site.r_u:g}, which has no level"
        remedy = "draw a [slope] as [ground], and give [water] a level, a table or a depth"
        raise ValueError(f"water {by:+g} m: the scene has {water}, so none can be raised: {remedy}")
    return replace(site, water=site.water.raised(by, site.shape))


def _section(campaign: Campaign) -> Section:
    """The ground of a campaign as a section; ValueError for ground that is none."""
    shape = as_section(campaign.site.shape)
    if shape is not None:
        return shape
    kind = "ground in 3D" if campaign.dimension == 3 else f"a {campaign.site.shape.__class__.__name__} of one's own"
    raise ValueError(f"limit equilibrium is for sections, not for {kind}: the solver's limit load stands alone")


def _by_slices(
    result: Safety, campaign: Campaign, layers: Sequence[Layer], water: Water, strength: Strength | None
) -> Safety:
    """The result with the factor by limit equilibrium, or a note why there is none.

    layers: with the weight of the soil. water: of its table. strength: at the bases of slices.
    """
    start = time.perf_counter()
    try:
        slices = _sliced(campaign, layers, water, strength)
        result = replace(result, shape=_section(campaign), layers=tuple(layers), water=slices.water)
        critical = critical_surface(slices)
    except ValueError as error:
        return replace(result, notes=(str(error),))
    seconds = time.perf_counter() - start
    return replace(result, equilibrium=critical, frictional=slices.frictional, seconds=seconds)


def _sliced(campaign: Campaign, layers: Sequence[Layer], water: Water, strength: Strength | None) -> Slices:
    """The ground of a campaign in slices, arguments as of `_by_slices`; ValueError for ground that is no section."""
    site, run, shape = campaign.site, campaign.run, _section(campaign)
    moves = site.pressure
    return Slices.of(
        shape, layers, water=water if moves is None else moves.level, r_u=site.r_u,
        moving=None if moves is None else MovingWater.of(campaign, shape, layers),
        k_h=run.k_h, k_v=run.k_v, gravity=run.gravity, strength=strength,
        rock=[number for number, layer in enumerate(site.layers) if layer.rock],
    )  # fmt: skip


def slices_of_sample(model: GridModel, coefficients: np.ndarray | None) -> Slices:
    """The ground in slices, with the soil of a sample as the particles of a grid have it.

    Args:
        model: the grid.
        coefficients: (modes,) of the sample, None for median soil.

    Raises:
        ValueError: ground that is no section, or soil without a strength.
    """
    resting = under_own_flow(rested(model.campaign), model.soil, coefficients)
    return _sliced(resting, *_of_particles(model, coefficients))


def slices_at_rest(campaign: Campaign) -> Slices:
    """The section of a campaign with the strength of its soil's means, under its own water or the pressure of a time.

    Args:
        campaign: of which water that moves rests, as of `cooperative.scene.rested`.

    Raises:
        ValueError: limit equilibrium does not apply to its ground or its soil.
    """
    site = campaign.site
    if isinstance(site.water_table, Raster):
        raise ValueError("limit equilibrium is for sections, whose water is a level or a line")
    return _sliced(campaign, site.soils(campaign.soil), site.water_table, None)


def sample_strength(model: GridModel, coefficients: np.ndarray) -> Strength:
    """The strength of a sample at the bases of slices.

    Args:
        model: of a grid.
        coefficients: of the sample (modes,).
    """
    return _strength(model, _with_soil(model, coefficients))


def _median(campaign: Campaign) -> tuple[list[Layer], Water, Strength | None] | None:
    """Layers, water and strength of a campaign's median soil, which its numbers and trends give without a grid.

    None for soil that only particles have: with measured values, with a strength that goes with the stress, calibrated,
    or in other ground than a section.
    """
    site, random = campaign.site, campaign.random
    shape = as_section(site.shape)
    layers = site.soils(campaign.soil)
    fields = {name: site.values_of(name, field) for name, field in random.items()}
    if shape is None or site.by_stress(campaign.soil) is not None or campaign.run.strength_factor != 1:
        return None
    if not random.keys() <= {"strength", "cohesion", "friction", *UNUSED} or not isinstance(
        site.water_table, int | float | tuple | list | None
    ):
        return None
    every = [field for values in fields.values() for field in values if isinstance(field, RandomField)]
    if any(field.boreholes is not None or field.uncertain for field in every):
        return None
    rows_of = {"strength": STRENGTHS[0], "cohesion": STRENGTHS[0], "friction": STRENGTHS[1]}
    x, heights = shape.boundaries(layers)

    varying = [
        (rows_of[name], layer, field, float(field.distribution.transform(jnp.zeros(()))))
        for name in rows_of
        for layer, field in enumerate(fields.get(name, ()))
        if isinstance(field, RandomField) and hasattr(layers[layer].soil, name)
    ]

    def at(places: np.ndarray, z: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        numbers = np.full((2, places.size), np.nan)
        for row, layer, field, median in varying:
            here = number == layer
            top: str | float | np.ndarray = field.trend_from
            before = site.layers[layer].before(places[here]) if site.layers and top == "layer" else None
            if before is not None:
                top = before
            elif isinstance(top, str):
                top = np.interp(places[here], x, heights[layer if top == "layer" else 0])
            numbers[row, here] = median * field.grown(np.maximum(top - z[here], 0.0))
        return numbers[0], numbers[1]

    return layers, site.water_table, at if rows_of.keys() & fields.keys() else None


def _of_particles(model: GridModel, coefficients: np.ndarray | None) -> tuple[list[Layer], Water, Strength]:
    """Layers, water and strength of a sample, or of median soil, as particles of a grid have it."""
    scene = _with_soil(model, coefficients)
    table = scene.loads.water
    water = np.stack([table.x, table.z], axis=1).astype(float).tolist() if isinstance(table, WaterTable) else None
    layers = model.campaign.site.soils(model.campaign.soil)
    return _weighed(layers, model, scene), water, _strength(model, scene)


def _with_soil(model: GridModel, coefficients: np.ndarray | None) -> Scene:
    """Scene of a sample, or of median soil, whose stress nobody asks for."""
    return jaxmpm.with_soil(model.scene, jaxmpm.unstressed(model.scene), **model.varied(coefficients))[0]


def _weighed(layers: Sequence[Layer], model: GridModel, scene: Scene) -> list[Layer]:
    """The layers with the mean weight that a sample's soil has in each."""
    if "unit_weight" not in model.names:
        return list(layers)
    particles = scene.particles
    weight = STANDARD_GRAVITY * np.asarray(particles.mass, float) / np.asarray(particles.volume, float)
    number = np.zeros(weight.size, int) if model.layer is None else model.layer
    return [
        replace(layer, soil=replace(layer.soil, unit_weight=float(weight[number == k].mean())))
        for k, layer in enumerate(layers)
    ]


def _strength(model: GridModel, scene: Scene) -> Strength:
    """Peak strength at the bases of slices, interpolated between particles of the same layer."""
    parameters = {name: np.asarray(parameter.value, float) for name, parameter in declared(scene.material).items()}
    count = scene.particles.mass.shape
    undrained = np.broadcast_to(parameters.get("strength", np.nan), count)
    cohesion = np.where(np.isnan(undrained), np.broadcast_to(parameters.get("cohesion", np.nan), count), undrained)
    friction = np.broadcast_to(np.rad2deg(parameters.get("friction", np.nan)), count)
    friction = np.where(np.isnan(undrained), friction, 0.0)
    position = np.asarray(scene.particles.position, float).T
    number = np.zeros(count, int) if model.layer is None else model.layer
    spacing = np.array(model.campaign.grids[model.grid].spacing)[[0, -1]]
    fields = {
        layer: _interpolated(position[number == layer], np.stack([cohesion, friction])[:, number == layer], spacing)
        for layer in np.unique(number).tolist()
    }

    def at(x: np.ndarray, z: np.ndarray, layer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.full((2, x.size), np.nan)  # in a layer too thin for particles
        for which, strength in fields.items():
            here = layer == which
            if here.any():
                values[:, here] = strength(x[here], z[here])
        return values[0], values[1]

    return at


def _interpolated(
    position: np.ndarray, values: np.ndarray, spacing: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Values (k, n) at points x, z (n,) m from those (k, particles) of particles at positions (particles, 2) m.

    They are bilinear between points spacing (2,) m apart, which have the mean of their nearest particles. Those of a
    lattice coincide with them.
    """
    if np.ptp(values, axis=1).max() <= UNIFORM * np.abs(values).max():
        return lambda x, z: np.broadcast_to(values[:, :1], (len(values), x.size))
    from scipy.spatial import cKDTree  # loads what only soil that varies needs

    corner = position.min(axis=0)
    shape = np.maximum(np.rint(np.ptp(position, axis=0) / spacing).astype(int) + 1, 2)
    points = corner + np.indices(shape).reshape(2, -1).T * spacing
    neighbours = min(NEIGHBOURS, len(position))
    distance, nearest = cKDTree(position).query(points, k=[*range(1, neighbours + 1)])
    weight = 1 / np.maximum(distance, 1e-9) ** 2
    at_points = ((values[:, nearest] * weight).sum(axis=2) / weight.sum(axis=1)).reshape(-1, *shape)

    def at(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        place = np.clip((np.stack([x, z]) - corner[:, None]) / spacing[:, None], 0, (shape - 1)[:, None])
        i, j = low = np.minimum(place.astype(int), (shape - 2)[:, None])
        s, t = place - low
        return (
            at_points[:, i, j] * (1 - s) * (1 - t) + at_points[:, i + 1, j] * s * (1 - t)
            + at_points[:, i, j + 1] * (1 - s) * t + at_points[:, i + 1, j + 1] * s * t
        )  # fmt: skip

    return at


def _by_solver(result: Safety, model: GridModel, coefficients: np.ndarray | None, progress: Progress | None) -> Safety:
    """The result with the solver's factor, or a note why there is none; ValueError where there is neither."""
    campaign = model.campaign
    state = jaxmpm.at_rest(model.scene, apic=campaign.grids[model.grid].apic)
    scene, state = replace(model, state=state).of_sample(coefficients)
    # A factor of safety is of a steady load.
    scene = replace(scene, loads=replace(scene.loads, motion=None))
    middle = 1.0 if result.equilibrium is None else result.equilibrium.slip.factor
    bracket = (round(min(0.5, middle / 2), 2), round(max(3.0, 2 * middle), 2))
    try:
        answer = limit_load_factor(campaign, scene, state, bracket=bracket, progress=progress)
    except (ValueError, FloatingPointError) as error:
        if result.equilibrium is None:
            raise
        return replace(result, notes=(*result.notes, f"the solver gives no factor of safety: {error}"))
    assert answer.kink is not None
    # As stiff as the limit load's own runs: elastic displacement of soft soil would hide what slides.
    beyond = jaxmpm.reduced(jaxmpm.run.limit_load_scene(scene), answer.kink * (1 + BESIDE))
    rules = [jaxmpm.Settle(), jaxmpm.Exceeds(campaign.site.height / 4)]
    moving = jaxmpm.solve(beyond, state, t_end=campaign.run.t_end, rules=rules)
    remarks = [*doubts(answer, f"{failing_volume(campaign):g} {result.unit}"), *_held(model, beyond, moving.state)]
    result = replace(result, solver=answer, failing=(beyond, moving.state), doubts=tuple(remarks))
    return replace(result, reasons=tuple(_reasons(result, model)))


def _held(model: GridModel, scene: Scene, state: State) -> Iterator[str]:
    """Walls that hold, or let go, what moves just beyond the limit load."""
    limit = float(diagnostics.exceeded_displacement(scene, state, failing_volume(model.campaign))) / 2
    if limit == 0:
        return
    position, volume = (np.asarray(array, float) for array in (scene.particles.position, scene.particles.volume))
    walls = walls_reached(
        position, np.asarray(state.displacement, float), volume, model.walls, half_size=model.half_size,
        failure_displacement=limit, within=scene.grid.cell, reach=model.reach, polygon=model.campaign.site.fixed_edge,
    )  # fmt: skip
    if walls:
        yield f"what moves reaches {walls}, where no surface of limit equilibrium ends: lengthen the ground there"


def _reasons(result: Safety, model: GridModel) -> Iterator[str]:
    """Why the solver's factor is higher, or lower, than that of limit equilibrium, where they are far apart."""
    if result.difference is None or abs(result.difference) <= APART:
        return
    higher = result.difference > 0
    reasons = list(_causes(result, model, higher=higher))
    yield from reasons or [
        "none of the usual reasons applies: halve cell and spacing, and compare the surface with fos.png"
    ]


def _causes(result: Safety, model: GridModel, *, higher: bool) -> Iterator[str]:
    """Those of `_reasons` that apply."""
    campaign, numerics = model.campaign, model.campaign.grids[model.grid]
    site = campaign.site
    soils = [layer.soil for layer in site.soils(campaign.soil)]
    assert result.equilibrium is not None
    slip = result.equilibrium.slip
    cells = slip.thickness / numerics.cell
    if cells < CELLS_DEEP:
        resist = ", and coarse cells resist" if higher else ""
        yield f"what slides in limit equilibrium is {cells:.2g} cells deep{resist}: halve cell and spacing"
    unlocked = model.scene.numerics.fbar or model.scene.numerics.cell_average
    if higher and not unlocked and any(getattr(soil, "strength", None) is not None for soil in soils):
        yield "clay without a cure of locking resists too much: give the grid cell_average = true"
    thin = [
        layer.name
        for layer, thickness in zip(site.layers, site.thicknesses, strict=True)
        if thickness.too_thin(numerics.cell)
    ]
    if higher and thin:
        yield f"{', '.join(thin)} is thinner than its cells resolve, and too strong there: take smaller cells"
    if not higher and any(soil.softens for soil in soils if hasattr(soil, "softens")):
        yield "soil softens in the solver, while limit equilibrium has its peak strength on the whole surface"
    if not higher and any(
        getattr(soil, "tension_cutoff", None) == 0 and getattr(soil, "strength", None) for soil in soils
    ):
        yield "clay opens in tension in the solver, while limit equilibrium has it pull behind the crest"
    contact = getattr(site.shape, "interface", None)
    if not higher and contact is not None and contact.slip_length is not None:
        yield "the interface softens in the solver, while limit equilibrium has its strength before slip"
    if not higher and any(getattr(soil, "friction", None) and not getattr(soil, "dilation", 0.0) for soil in soils):
        yield "the solver's soil does not dilate by its friction angle, which limit equilibrium takes no account of"
    opens = any(getattr(soil, "tension_cutoff", None) is not None for soil in soils)
    if not higher and opens and slip.tension > STRETCHED:
        yield (
            f"{100 * slip.tension:.0f} % of the slip surface, at its crest, bears tension in limit equilibrium, while "
            "the solver's soil opens a crack there"
        )
    if slip.method == "janbu":
        yield "Janbu's method takes no shear between slices but by its correction"
    if slip.circle is not None and not result.frictional:
        yield "in clay limit equilibrium has circles alone, and the solver's soil fails in any shape"
    if higher and slip.area < failing_volume(campaign):
        yield (
            f"what slides in limit equilibrium has {slip.area:.2g} m2, less than the {failing_volume(campaign):.3g} m2 "
            f"that the solver counts as a failure: give least_volume = {slip.area / 4:.1g}"
        )
