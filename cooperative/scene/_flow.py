"""Water that moves in a campaign's ground: its flow, and the ground at rest under the pressure of a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from cooperative.scene._site import Site
from cooperative.scene.tables import Hydraulics, RandomField, Seepage
from jaxmpm import Discretisation, Raster, Scene, seepage
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.seepage import AtSide, Cells, Flow, Heads, PressureInTime, PressureTable, Problem, Retention
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil
from jaxmpm.support import check
from jaxmpm.support.check import Invalid, about
from jaxmpm.support.text import shown

if TYPE_CHECKING:
    from cooperative.scene._campaign import Campaign

STANDS = 0.3
"""Pressure head (m) at the ground's surface from which on another program's water stands on it."""
SOAKS = 0.1
"""Share of the rain below which what soaks in betrays another unit."""
FULL = 0.98
"""Share of the surface that is saturated from which on the ground is full."""


@dataclass(frozen=True)
class Solved:
    """The flow of a campaign, on the host.

    Args:
        times: (n,) s, from 0.
        at_times: heads at each of them.
        cells: of the flow.
        number: of the layer of each cell.
        rained: water that fell on the ground up to the last time (m3, in a section m2).
        entered: of it what soaked in.
        balance: largest error of the water balance, as a share of what has crossed faces.
        steps: of the flow.
        full: time from which on the ground is saturated to its surface (s), None where it never is.
    """

    times: np.ndarray
    at_times: tuple[Heads, ...]
    cells: Cells
    number: np.ndarray
    rained: float
    entered: float
    balance: float
    steps: int
    full: float | None

    def heads(self, time: float) -> Heads:
        """Pressure heads at a time (s), linear between the times; ValueError beyond them."""
        check.between("time", time, float(self.times[0]), float(self.times[-1]), ends=True)
        after = min(int(np.searchsorted(self.times, time, side="right")), len(self.times) - 1)
        before = max(after - 1, 0)
        share = (time - self.times[before]) / max(self.times[after] - self.times[before], 1e-300)
        first, last = self.at_times[before], self.at_times[after]
        return replace(first, total=jnp.asarray((1 - share) * first.total + share * last.total))

    def pressure(self, position: np.ndarray, time: float, unit_weight: float = WATER_WEIGHT) -> np.ndarray:
        """Pore pressures (N,) Pa at points (d, N) m at a time (s), below 0 under suction."""
        return unit_weight * np.asarray(self.heads(time).at(position), float)


@dataclass(frozen=True)
class Resting:
    """The pressure under which a ground rests.

    Args:
        time: of it (s).
        heads: at that time.
        retentions: of each layer, that of another one in rock; None where no soil is given, which has no suction.
        suction: whether it holds grains together.
        level: of the pool (m), None where none stands on the ground.
        dry: unit weight of each layer without its water (N/m3), nan where weight does not follow the water.
        unit_weight: of water under the gravity of the runs (N/m3).
        flow: in time, of which this is the pressure.
        flowing: by which it was solved, None where another program computed it.
    """

    time: float
    heads: seepage.HeadsAt
    retentions: tuple[Retention, ...] | None
    suction: bool
    level: float | None
    dry: tuple[float, ...]
    unit_weight: float
    flow: PressureInTime = field(repr=False, compare=False)
    flowing: CampaignFlow | None = field(repr=False, compare=False)

    def retention(self, number: np.ndarray) -> Retention | None:
        """Of points in layers of these numbers (N,)."""
        return None if self.retentions is None else seepage.zoned(self.retentions, number)  # type: ignore[type-var]

    def on(self, scene: Scene, site: Site, numerics: Discretisation) -> Scene:
        """A grid's scene under this pressure, which was built with the pool."""
        layer = site.layer_of(np.asarray(scene.particles.position), numerics)
        number = np.zeros(scene.particles.mass.size, int) if layer is None else layer
        dry = np.array(self.dry)[number]
        return seepage.with_pressure(
            scene, self.heads, retention=self.retention(number), suction=self.suction, level=self.level,
            dry_weight=None if np.isnan(dry).all() else dry, unit_weight=self.unit_weight,
        )  # fmt: skip

    def at(self, position: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressure taken off the total stress (N,) Pa, and unit weight (N,) N/m3, nan where it does not follow water.

        Args:
            position: (d, N) m.
            number: of the layer there (N,).
        """
        head = np.asarray(self.heads.at(position), float)
        retention = self.retention(number)
        pressure = seepage.suction_pressure(head, retention if self.suction else None, self.unit_weight)
        dry = np.array(self.dry)[number]
        content = np.zeros_like(head) if retention is None else np.asarray(retention.water_content(head), float)
        return pressure, dry + WATER_WEIGHT * content


def at_time(campaign: Campaign, time: float | None = None, flow: PressureInTime | None = None) -> Campaign:
    """A campaign whose ground rests under the pressure of a time; one at rest already stays so.

    Args:
        campaign: the campaign.
        time: s, None for that of its table, or at which it rests already.
        flow: of a sample, None for that of the campaign.
    """
    table, site = campaign.seepage, campaign.site
    assert table is not None
    if site.pressure is not None and flow is None and time is None:
        return campaign
    moment = (table.moment if site.pressure is None else site.pressure.time) if time is None else time
    flow = campaign.flow if flow is None else flow
    retentions = retentions_of(campaign)
    heavier = campaign.run.gravity / STANDARD_GRAVITY
    usual = next((retention for retention in retentions if retention is not None), None)
    filled = None if usual is None else tuple(retention or usual for retention in retentions)
    resting = Resting(
        moment, flow.heads(moment), filled, table.suction,
        _pool(campaign, moment), _dry(campaign.soil, site, retentions), WATER_WEIGHT * heavier,
        flow, campaign.flowing if table.given_by is None else None,
    )  # fmt: skip
    return replace(campaign, ground=replace(site, pressure=resting))


def _dry(soil: AnySoil, site: Site, retentions: Sequence[Retention | None]) -> tuple[float, ...]:
    """Unit weight of each layer without its water (N/m3), nan where no saturated one is given."""
    saturated = [getattr(layer_soil.soil, "saturated_unit_weight", None) for layer_soil in site.soils(soil)]
    return tuple(
        math.nan if wet is None or retention is None else float(wet - WATER_WEIGHT * float(retention.porosity))
        for wet, retention in zip(saturated, retentions, strict=True)
    )


def _pool(campaign: Campaign, time: float) -> float | None:
    """Level (m) of the water that stands on the ground at a time (s), None where none does."""
    assert campaign.seepage is not None
    level = campaign.seepage.level_at(time)
    return level if level is not None and level > _surface(campaign)[1].min() else None


def _surface(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Points in plan (axes, n) m and the height of the ground there (n,) m."""
    shape = campaign.site.shape
    axes = [
        low + edge * (np.arange(200) + 0.5) / 200 for low, edge in zip(shape.corner[:-1], shape.extent, strict=False)
    ]
    plan = np.stack([coordinate.ravel() for coordinate in np.meshgrid(*axes, indexing="ij")])
    heights = np.asarray(shape.heights(*plan), float)
    there = np.isfinite(heights)
    return plan[:, there], heights[there]


def retentions_of(campaign: Campaign) -> tuple[Retention | None, ...]:
    """How each layer, or all of the ground, holds water.

    Args:
        campaign: whose water moves.

    Returns:
        None for rock that lets none through, or where no soil is given.

    Raises:
        ValueError: numbers that are missing or out of their limits.
    """
    labels = [f"layer {shown(layer.name)}" for layer in campaign.site.layers] or ["soil"]
    return tuple(
        _retention(tables, label) if tables else None for tables, label in zip(campaign.hydraulics, labels, strict=True)
    )


def _retention(tables: tuple[Hydraulics, ...], where: str) -> Retention:
    """The soil of a layer by the tables from which it has its numbers, its own first."""
    numbers = {name: value for table in reversed(tables) for name, value in table.numbers.items()}
    name = next((table.soil_class for table in tables if table.soil_class is not None), None)
    model = next((table.model for table in tables if table.model is not None), "van genuchten")
    with jax.enable_x64(True):
        try:
            if model == "gardner":
                if name is not None:
                    rule, remedy = "has no numbers of gardner", "give conductivity, alpha and porosity"
                    raise Invalid(("soil_class",), repr(name), rule, remedy)
                soil: Retention = seepage.gardner(**numbers)
            elif name is not None:
                soil = seepage.soil_class(name, **numbers)
            else:
                entry = 0.02 if numbers.get("n", 2.0) < 2.0 else 0.0
                soil = seepage.van_genuchten(**{"air_entry": entry, **numbers})
            return jax.tree.map(lambda value: np.asarray(value, float), soil)
        except ValueError as error:
            raise about(f"[{where}] of the flow, to which soil_class gives all numbers", error) from error


def _conductivities(campaign: Campaign) -> tuple[RandomField | float, ...]:
    """The conductivity of each layer, or of all of the ground: a field, or its number (m/s); 0 where no water flows."""
    conductivities = [
        next((table.conductivity for table in tables if table.conductivity is not None), None)
        for tables in campaign.hydraulics
    ]
    return tuple(
        value if isinstance(value, RandomField) else 0.0 if soil is None else float(soil.conductivity)
        for value, soil in zip(conductivities, retentions_of(campaign), strict=True)
    )


def flow_of(campaign: Campaign) -> PressureInTime:
    """The pore pressure of a campaign in time: its flow, or what another program has computed.

    Args:
        campaign: with a table of rain or drawdown.

    Raises:
        ValueError: ground, soil and water do not go together, or the flow does not converge.
    """
    table = campaign.seepage
    assert table is not None
    if table.given_by is not None:
        return _given(campaign, table)
    (solved,) = campaign.flowing.solved([None])
    if solved.rained > 0 and solved.entered < SOAKS * solved.rained:
        check.warn(
            f"of {solved.rained:.3g} {'m3' if campaign.dimension == 3 else 'm2'} of rain no more than "
            f"{solved.entered:.3g} soak in, the rest runs off: that is more than the ground takes up or drains all the "
            "time; was it meant in another unit, such as mm/day, or the conductivity?"
        )
    if solved.full is not None:
        check.warn(
            f"the ground is saturated to its surface from {solved.full:g} s on: all further rain runs off; is that "
            "meant, and are there levels beyond the ends, or drains?"
        )
    return solved


@dataclass(frozen=True)
class CampaignFlow:
    """The flow of a campaign, to be solved with one conductivity or another.

    Args:
        table: of rain or drawdown.
        cells: of the flow.
        number: of the soil in each cell among those through which water flows.
        layer: number of the layer in each cell.
        conductivities: of each layer, or of all of the ground: a field, or its number (m/s), 0 where no water flows.
        problem: of the flow, with the median of a conductivity that varies.
        steady: the same under the steady rain before time 0, None without.
        initial: heads (m) at rest of the cells' shape, from which steady flow is sought where there is one.
    """

    table: Seepage
    cells: Cells
    number: np.ndarray
    layer: np.ndarray
    conductivities: tuple[RandomField | float, ...]
    problem: Problem
    steady: Problem | None
    initial: np.ndarray

    @classmethod
    def of(cls, campaign: Campaign) -> CampaignFlow:
        """The flow of a campaign; ValueError where ground, soil and water do not go together."""
        table = campaign.seepage
        assert table is not None
        cells, number, layer = _cells(campaign, table)
        soils = [retention for retention in retentions_of(campaign) if retention is not None]
        with jax.enable_x64(True):
            soil: Any = seepage.zoned(soils, number) if len(soils) > 1 else soils[0]  # type: ignore[type-var]
            start = _at_rest(campaign, table, cells)
            sides = _sides(campaign, table, start)
            problem = seepage.problem(cells, soil, _face(table), *sides)
            steady = None
            if table.initial_rate is not None:
                steadily = replace(table, rate=((0.0, table.initial_rate),))
                steady = seepage.problem(cells, soil, _face(steadily), *sides)
            initial = np.asarray(seepage.hydrostatic(problem, _levels(start, cells)))
            # Held on the host: elsewhere 64 bits may be off.
            problem, steady = jax.tree.map(np.asarray, (problem, steady))
        return cls(table, cells, number, layer, _conductivities(campaign), problem, steady, initial)

    def solved(self, conductivities: Sequence[np.ndarray | None]) -> list[Solved]:
        """The flow with each of several conductivities, side by side.

        Args:
            conductivities: of the cells (m/s), of their shape; None for the median.

        Raises:
            ValueError: a flow does not converge, or the ground is full before time 0.
        """
        table = self.table
        times = sorted({0.0, *table.times, table.moment})
        usual = self.problem.soil.conductivity
        lanes = np.stack(
            [np.asarray(usual) if conductivity is None else conductivity for conductivity in conductivities]
        )

        def with_soil(problem: Problem, conductivity: jax.Array) -> Problem:
            return replace(problem, soil=replace(problem.soil, conductivity=conductivity))

        with jax.enable_x64(True):
            initial = np.broadcast_to(self.initial, lanes.shape)
            if (steady := self.steady) is not None:
                starts, converged = jax.vmap(lambda k: seepage.steady(with_soil(steady, k), self.initial))(lanes)
                initial = np.asarray(starts)
                self._check_start(initial, np.asarray(converged))

            def run(conductivity: jax.Array, start: jax.Array) -> Flow:
                return seepage.run(with_soil(self.problem, conductivity), start, times, tolerance=table.tolerance)

            if len(lanes) == 1:
                flow = jax.tree.map(lambda leaf: leaf[None], run(jnp.asarray(lanes[0]), jnp.asarray(initial[0])))
            else:
                flow = jax.vmap(run)(jnp.asarray(lanes), jnp.asarray(initial))
            flow.raise_if_failed()
            return [self._of_lane(jax.tree.map(lambda leaf: leaf[n], flow), times) for n in range(len(lanes))]  # noqa: B023

    def _check_start(self, initial: np.ndarray, converged: np.ndarray) -> None:
        """Raise ValueError for steady flow before time 0 that does not converge, or that fills the ground."""
        rate = f"initial_rate = {self.table.initial_rate:g} m/s"
        if not converged.all():
            remedy = "give less, larger cells or soil with an air_entry, or begin with the water of [water]"
            raise Invalid((), None, f"the steady flow of {rate} does not converge", remedy)
        if any(_full(self.cells, head) for head in initial):
            rule = "is more than the ground drains, so that it is saturated to its surface before time 0"
            raise Invalid((), rate, rule, "give less, levels beyond the ends, drains or more conductive soil")

    def _of_lane(self, flow: Flow, times: Sequence[float]) -> Solved:
        """One flow, on the host."""
        heads = [np.asarray(head, float) for head in flow.head]
        every = (Heads.of(self.problem, head) for head in flow.head)
        at_times = tuple(replace(head, total=cast(jax.Array, np.asarray(head.total, float))) for head in every)
        # Under a pool it is no wonder that it is.
        rate = self.table.rate
        rains = rate is not None and max(value for _, value in rate) > 0
        wet = (t for t, head in zip(times, heads, strict=True) if t > 0 and _full(self.cells, head))
        full = next(wet, None) if rains else None
        rained = float(np.sum(np.asarray(flow.record.rain)))
        balance = float(np.max(np.asarray(flow.balance_error)[: int(flow.steps)]))
        return Solved(
            np.array(times), at_times, self.cells, self.number, rained, rained - float(flow.runoff), balance,
            int(flow.steps), full,
        )  # fmt: skip


def _full(cells: Cells, head: np.ndarray) -> bool:
    """Whether the top cell of nearly every column is saturated."""
    soil = cells.soil.reshape(-1, cells.shape[-1])
    has = soil.any(axis=1)
    top = cells.shape[-1] - 1 - np.argmax(soil[:, ::-1], axis=1)
    at = np.take_along_axis(head.reshape(soil.shape), top[:, None], 1)[:, 0]
    return float(np.mean(at[has] >= 0)) > FULL


def _cells(campaign: Campaign, table: Seepage) -> tuple[Cells, np.ndarray, np.ndarray]:
    """Cells of the flow without those of rock, and the number of the soil and of the layer in each."""
    site, d = campaign.site, campaign.dimension
    cell = campaign.refined.cell
    spacing = table.cell or (*(cell,) * (d - 1), cell / 2)
    if len(spacing) != d:
        raise Invalid(("cell",), str(list(spacing)), "of the flow", f"give {d} edges, one per axis")
    cells = seepage.cells_under(site.shape, spacing)
    position = cells.centres().reshape(d, -1)
    layer = site.layer_of(position, campaign.grids["refined"])
    retentions = retentions_of(campaign)
    if layer is None:
        return cells, np.zeros(cells.shape, int), np.zeros(cells.shape, int)
    layer = layer.reshape(cells.shape)
    wet = np.array([retention is not None for retention in retentions])
    if not any(wet):
        raise Invalid((), None, "no layer has soil through which water flows", "give soil, or a layer of it")
    for number, stratum in enumerate(site.layers):
        if not wet[number] and not stratum.rock:
            raise Invalid((), stratum.label, "has no conductivity", "give soil for all, or a layer of that name")
    active = cells.soil & wet[layer]
    count = np.cumsum(wet) - 1
    return replace(cells, active=active), np.where(active, count[layer], 0), layer


Start = float | np.ndarray | Raster
"""Level, points (n, 2) or heights of the water at rest before the flow (m)."""


def _at_rest(campaign: Campaign, table: Seepage, cells: Cells) -> Start:
    """The water from which the flow begins, or is sought; ValueError where none is known, or it floods the ground."""
    water = campaign.site.water_table
    if water is None:
        level = table.level_at(0.0)
        if level is None and table.initial_rate is None:
            raise Invalid(
                (),
                None,
                "the state of the ground before time 0 is not known",
                'give [water] a level or a table, or initial_rate, a steady rain such as "300 mm/year"',
            )
        return campaign.site.shape.corner[-1] if level is None else level
    start: Start = water if isinstance(water, int | float | Raster) else np.array(water, float)
    plan, heights = _surface(campaign)
    above = _level_at(start, plan) - heights
    pool = table.level_at(0.0)
    flooded = above > cells.spacing[-1] if pool is None else above > np.maximum(pool - heights, 0) + cells.spacing[-1]
    if flooded.any():
        at = ", ".join(f"{x:.4g}" for x in plan[:, np.argmax(np.where(flooded, above, -1))])
        stands = "and no level is given" if pool is None else f"above the level of {pool:g} m at time 0"
        rule = f"stands {above[flooded].max():.3g} m above the ground at ({at}) m, {stands}"
        raise Invalid((), "[water]", rule, "give the pool its level in the table of the flow, or lower the water")
    return start


def _level_at(start: Start, plan: np.ndarray) -> np.ndarray:
    """Level (n,) m of the water at rest at points in plan (axes, n) m."""
    if isinstance(start, Raster):
        return start.at(*plan)
    return np.interp(plan[0], *start.T) if isinstance(start, np.ndarray) else np.full(plan.shape[1], float(start))


def _levels(start: Start, cells: Cells) -> np.ndarray:
    """The same in each column of the cells."""
    plan = cells.centres()[:-1, ..., 0]
    return _level_at(start, plan.reshape(len(plan), -1)).reshape(plan.shape[1:])


def _face(table: Seepage) -> AtSide:
    return seepage.open_face("surface", rain=_series(table.rate), level=_series(table.level))


def _series(pairs: tuple[tuple[float, float], ...] | None) -> Any:
    """As boundaries take it."""
    if pairs is None:
        return None
    if len(pairs) == 1 and pairs[0][0] <= 0:
        return pairs[0][1]
    times, values = np.array(pairs, float).T
    if times[0] > 0:  # nothing is known before: no rain
        times, values = np.r_[0.0, times], np.r_[0.0, values]
    return times, values


def _sides(campaign: Campaign, table: Seepage, start: Start) -> list[AtSide]:
    """What happens at the ends, the base and in drains."""
    shape = campaign.site.shape
    conditions = []
    x0, x1 = shape.corner[0], shape.corner[0] + shape.extent[0]
    for side, end_level, x in (("left", table.left, x0), ("right", table.right, x1)):
        if end_level == "closed":
            continue
        if end_level is not None:
            level = _series(end_level)
            if isinstance(level, tuple) and end_level[0][0] > 0:
                level = level[0], np.r_[end_level[0][1], level[1][1:]]
        elif table.initial_rate is not None or campaign.dimension == 3:
            continue
        else:
            inside = np.array([[x + 1e-6 * (1 if side == "left" else -1) * shape.extent[0]]])
            level = float(_level_at(start, inside)[0])
            if level >= float(np.asarray(shape.heights(*inside))[0]) or level <= shape.corner[-1]:
                continue
        conditions.append(seepage.open_face(cast(seepage.Side, side), level=level))
    if table.base == "free drainage":
        conditions.append(seepage.free_drainage())
    if table.drains:
        conditions.append(seepage.drain(table.drains, radius=table.drain_radius))
    return conditions


def _given(campaign: Campaign, table: Seepage) -> PressureTable:
    """The pore pressure of another program, checked against the ground."""
    if table.water_tables is None:
        assert table.pressure is not None
        pressures = PressureTable.of_rows(table.pressure)
    else:
        pressures = PressureTable.of_rasters(dict(cast("Sequence[tuple[float, Raster]]", table.water_tables)))
    pressures.check_ground(campaign.site.shape)
    if all(retention is None for retention in retentions_of(campaign)) and any(
        getattr(layer.soil, "saturated_unit_weight", None) is not None for layer in campaign.site.soils(campaign.soil)
    ):
        rule = (
            "beside the pressure of another program lacks the soil's porosity and retention, by which weight follows "
            "the water"
        )
        raise Invalid((), "saturated_unit_weight", rule, "give soil in the table of the pressure, or leave it out")
    for time in (*table.times, table.moment):
        heads = pressures.heads(time)
        plan, heights = _surface(campaign)
        pool = table.level_at(time)
        over = heads.at(np.vstack([plan, heights])) - (0.0 if pool is None else np.maximum(pool - heights, 0.0))
        if over.max() > STANDS:
            at = ", ".join(f"{x:.4g}" for x in plan[:, over.argmax()])
            raise Invalid(
                (),
                None,
                f"pressure at {time:g} s is that of {over.max():.3g} m of water on the ground at ({at}) m, "
                f"{'and no level is given' if pool is None else f'above the level of {pool:g} m'}",
                "give level for the pool, or heads of this ground",
            )
    return pressures
