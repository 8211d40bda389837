"""The model of a grid, and the soil that a sample's coefficients give its particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm
import kl
from cooperative.measure import ColumnPlan, OpenGround
from cooperative.runs._derived import (
    IN_LAW,
    LEVEL,
    ON_WALLS,
    PRESSURE,
    RATIO,
    SATURATED,
    by_stress,
    wet_or_dry,
    wetted,
)
from cooperative.runs._flow import under_own_flow
from cooperative.runs._lanes import lanes_of
from cooperative.runs._random_soil import RandomSoil
from cooperative.runs._values import growth_at, times, values_at
from cooperative.scene import CONTACT, Campaign, RandomField, rested
from jaxmpm import Face, Scene, State, with_columns
from jaxmpm.ground import Contact
from jaxmpm.laws import Zoned, declared, with_parameters
from jaxmpm.run import SlidesEnd, column_shape
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check
from jaxmpm.support.values import by_value

T = TypeVar("T")


@by_value
@dataclass(frozen=True)
class GridModel:
    """One grid of a campaign, ready to run.

    Args:
        grid: "rough" or "refined" of the `campaign`.
        campaign: the campaign.
        scene: what a sample's soil is put into, at rest; what is random is there the same in a layer, and of no sample.
        state: what a sample's soil is put into, at rest; what is random is there the same in a layer, and of no sample.
        soil: what is random.
        growth: see `growth_of_trends`.
        strength_factor: on strength, where the grids are calibrated.
        layer: number of the layer that each particle is of (N,), None where the ground has none.
        stress: effective and vertical (N,) Pa, at rest, None where no strength goes with it.
    """

    grid: str
    campaign: Campaign
    scene: Scene
    state: State
    soil: RandomSoil
    growth: Mapping[str, tuple[jax.Array | None, ...]] = field(default_factory=dict)
    strength_factor: float = 1.0
    layer: np.ndarray | None = None
    stress: jax.Array | None = None

    @property
    def lanes(self) -> int:
        """Runs that go at once through one program in this process."""
        return lanes_of(self.campaign.plan, self.grid, self.scene.particles.position.shape[-1])

    @property
    def half_size(self) -> np.ndarray:
        """Half the particle spacing per axis (d,) m."""
        return np.asarray(self.campaign.grids[self.grid].spacing) / 2

    @property
    def slides_on(self) -> bool:
        """Whether a run that has failed, or a slide that has not come to rest, may be asked to slide on."""
        return self.grid == "refined" and self.campaign.plan.slides != 0

    @property
    def t_end(self) -> float | SlidesEnd:
        """When a run ends (s), and from which displacement on it goes on then, where slides do."""
        run = self.campaign.run
        if run.last(self.grid) == run.t_end:
            return run.t_end
        return SlidesEnd(run.t_end, run.failure_displacement, run.last(self.grid), self.campaign.failing_volume)

    @property
    def geometry(self) -> Face | OpenGround:
        """The slope's face, or the height of the ground's surface above each particle."""
        shape = self.campaign.site.shape
        if shape.face is not None:
            return shape.face
        return OpenGround(
            shape.heights(*np.asarray(self.scene.particles.position, float)[:-1]), self.campaign.site.track
        )

    @property
    def walls(self) -> tuple[tuple[int, int, float], ...]:
        """Axis, side (-1 low, 1 high) and position (m) of every wall but the base."""
        grid = self.scene.grid
        upright = len(grid.shape) - 1
        return tuple(
            (wall.axis, -1 if wall.side == "low" else 1, grid.origin[wall.axis] + wall.index * grid.cell)
            for wall in self.scene.boundary.walls
            if wall.axis != upright
        )

    @property
    def columns(self) -> ColumnPlan:
        """Where the columns of its cells stand, between its walls where it has some."""
        grid, shape = self.scene.grid, column_shape(self.scene)
        ends = []
        for axis, count in enumerate(shape):
            walls = {wall.side: wall.index for wall in self.scene.boundary.walls if wall.axis == axis}
            low, high = walls.get("low", 0), walls.get("high", count)
            ends.append((grid.origin[axis] + low * grid.cell, grid.origin[axis] + high * grid.cell))
        return ColumnPlan(tuple(grid.origin[: len(shape)]), grid.cell, shape, tuple(ends))

    @property
    def reach(self) -> float:
        """Distance up to which two particles hang together (m): a little more than the diagonal of a cell."""
        return 1.5 * self.scene.grid.cell

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters of the law that samples differ in: random ones, and those that go with these."""
        varied = (name for name in self.campaign.random if name not in CONTACT)
        grown = [] if self.stress is None else ["strength"]
        grown += ["unit_weight"] if wetted(self.campaign.site, self.campaign.soil) else []
        random = tuple(dict.fromkeys(IN_LAW.get(name, name) for name in (*varied, *grown)))
        bound = (
            name
            for name, number in declared(self.scene.material).items()
            if self.strength_factor != 1 and name not in random and not number.parameter.reduced
            and number.parameter.at_most in random
        )  # fmt: skip
        return (*random, *bound)

    @property
    def varied_names(self) -> tuple[str, ...]:
        """What samples differ in, by the names of `jaxmpm.with_soil` and `solve_each`."""
        level = () if self.campaign.site.level is None else (LEVEL,)
        return (*self.names, *self.of_contact, *level, *self.of_flow)

    @property
    def of_contact(self) -> tuple[str, ...]:
        """Which strengths of the interface differ at its nodes: random ones, and those of the soil."""
        random, soil = self.campaign.random, self.campaign.site.contact_of_soil
        return tuple(key for name, key in CONTACT.items() if name in random or name.removeprefix("interface_") in soil)

    @property
    def of_flow(self) -> tuple[str, ...]:
        """What the flow of each sample gives its scene, where its conductivity varies."""
        if not self.campaign.conductivities:
            return ()
        resting = rested(self.campaign).site.pressure
        assert resting is not None
        weighs, presses = not np.isnan(resting.dry).all(), self.scene.boundary.pressure is not None
        return (PRESSURE, *(("unit_weight",) if weighs else ()), *((ON_WALLS,) if presses else ()))

    @cached_property
    def contact(self) -> Contact:
        """Nodes at which soil slides on rigid ground."""
        return Contact.of(self.scene)

    @property
    def own_start(self) -> bool:
        """Whether samples have an initial stress or a time step of their own: random stiffness, weight or water."""
        return not {"young", "poisson", "unit_weight", "k0", "b_value", LEVEL, PRESSURE}.isdisjoint(self.varied_names)

    def parameters(self, coefficients: jax.Array | np.ndarray | None = None) -> dict[str, jax.Array]:
        """The parameters at the particles in which samples differ, each (N,), by engineer's name.

        In SI units, angles in degrees, softening that of a band as thick as `softening_length`; a strength ratio beside
        its strength, a saturated weight beside the weight.

        Args:
            coefficients: (modes,) of a sample, None for the median soil.

        Raises:
            ValueError: another number of them.
        """
        parameters = self._drawn(coefficients)
        numbers = self._in_law(parameters, self.water_level(coefficients))
        law = {name: self._of_engineers(name, value, inverse=True) for name, value in numbers.items()}
        return law | {name: parameters[name] for name in (*IN_LAW, *CONTACT) if name in parameters}

    def parameters_of_samples(self, coefficients: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Some of `parameters` for many samples, each (samples, N), in one program; for `of` a few particles.

        Args:
            coefficients: (samples, modes).
            names: of the parameters.
        """

        def of_sample(row: jax.Array | np.ndarray) -> dict[str, jax.Array]:
            values = self.parameters(row)
            return {name: values[name] for name in names}

        # The weight of soil under a random water level is worked out on the host.
        if self.water_level() is None:
            values = jax.jit(jax.vmap(of_sample))(coefficients)
        else:
            values = jax.tree.map(lambda *of: np.stack(of), *map(of_sample, coefficients))
        return {name: np.asarray(value, float) for name, value in values.items()}

    def varied(self, coefficients: jax.Array | np.ndarray | None = None) -> dict[str, jax.Array]:
        """The same as `solve_each` takes them: angles in radians, softening that of the grid's bands.

        It may be differentiated by the coefficients.

        Raises:
            ValueError: another number of them, or traced ones where the water differs.
        """
        if check.is_traced(coefficients) and not {LEVEL, PRESSURE}.isdisjoint(self.varied_names):
            raise ValueError(
                f"random are {', '.join(self.varied_names)}, and water of samples is worked out on the host, without "
                "derivatives: give it as a number"
            )
        level = self.water_level(coefficients)
        values = self._in_law(self._drawn(coefficients), level)
        values |= self._at_contact(coefficients, values) | self._under_water(coefficients)
        return values if level is None else values | {LEVEL: jnp.asarray(level, self.scene.loads.gravity.dtype)}

    def leading(self, coefficients: jax.Array | np.ndarray) -> dict[str, jax.Array]:
        """As `varied`, of the leading coefficients alone; the others are 0."""
        every = jnp.zeros(self.soil.modes, self.scene.particles.mass.dtype)
        return self.varied(every.at[: len(coefficients)].set(coefficients))

    def water_level(self, coefficients: jax.Array | np.ndarray | None = None) -> float | None:
        """Height (m) of the water of a sample, or of the median one; None where samples do not differ in it."""
        level = self.campaign.site.level
        return None if level is None else level.at(0.0 if coefficients is None else float(coefficients[-1]))

    def of_sample(self, coefficients: jax.Array | np.ndarray | None = None) -> tuple[Scene, State]:
        """Scene and initial state of a sample, or of the median soil, with its own time step.

        Raises:
            ValueError: values that no soil has.
        """
        return jaxmpm.with_soil(self.scene, self.state, **self.varied(coefficients))

    @property
    def median(self) -> tuple[Scene, State]:
        """Scene and initial state of the median soil: that of a sample whose coefficients are all zero."""
        return self.of_sample()

    def time_step(self, coefficients: jax.Array | np.ndarray) -> float:
        """Of a sample (s)."""
        if not self.own_start:
            return float(self.scene.numerics.time_step)
        scene, _ = jaxmpm.with_soil(self.scene, jaxmpm.unstressed(self.scene), **self.varied(coefficients))
        return float(scene.numerics.time_step)

    def strength(self, coefficients: jax.Array | np.ndarray | None = None) -> jax.Array:
        """Undrained strength at the particles (N,) Pa, for coefficients (modes,).

        Raises:
            ValueError: that is not what is random.
        """
        if "strength" not in self.names:
            raise ValueError(f"random are {', '.join(self.campaign.random)}, not the strength: let strength vary")
        return self.parameters(coefficients)["strength"]

    def looking(self) -> GridModel:
        """The same grid, whose runs keep what passes over each column of cells where the scene wants that of it.

        Raises:
            ValueError: exposed places outside the ground.
        """
        hazard = self.campaign.hazard
        if hazard is None or self.grid != "refined":
            return self
        for element in self.campaign.elements_at_risk:
            element.columns(self.columns)
        state = with_columns(
            self.scene, self.state, moved=self.campaign.run.failure_displacement, every=hazard.every,
            surface=self._heights(),
        )  # fmt: skip
        return replace(self, state=state)

    def _heights(self) -> np.ndarray:
        """Heights (m) of the ground's surface at the nodes of the grid in plan; beyond its ends those of the ends."""
        grid, shape = self.scene.grid, self.campaign.site.shape
        ends = [(low, low + edge) for low, edge in zip(shape.corner[:-1], shape.extent, strict=False)]
        axes = [
            np.clip(grid.origin[axis] + grid.cell * np.arange(grid.shape[axis]), *ends[axis])
            for axis in range(len(ends))
        ]
        plan = np.meshgrid(*axes, indexing="ij")
        heights = np.asarray(shape.heights(*(coordinates.ravel() for coordinates in plan)), float).reshape(
            plan[0].shape
        )
        # Where a raster has no height there is no ground, and all soil that comes there is above it.
        return np.where(np.isfinite(heights), heights, shape.corner[-1])

    def with_measured(self, campaign: Campaign) -> GridModel:
        """The same grid once its campaign is measured.

        A rough one has the strength of its calibration.

        Raises:
            ValueError: elements at risk outside the ground.
        """
        model, calibration = replace(self, campaign=campaign).looking(), campaign.measured.calibration
        factor = campaign.run.strength_factor
        factor *= calibration.factor if calibration is not None and self.grid == "rough" else 1.0
        return model if factor == self.strength_factor else model.with_strength_factor(factor)

    def of(self, particles: np.ndarray) -> GridModel:
        """The same grid with some of its particles alone, for their `parameters`: it does not run.

        Args:
            particles: (n,) their numbers, ascending.
        """
        scene, law, count = self.scene, self.scene.material, self.scene.particles.mass.size
        at = partial(_at, particles=particles, count=count)
        if isinstance(law, Zoned):
            spans = [span for _, span in law.zones]
            inside = [particles[(particles >= of.start) & (particles < of.stop)] - of.start for of in spans]
            laws = tuple(_at(*of_zone) for of_zone in zip(law.laws, inside, law.counts, strict=True))
            law = replace(law, laws=laws, counts=tuple(map(len, inside)))
        else:
            law = at(law)
        loads = replace(scene.loads, pore_pressure=at(scene.loads.pore_pressure), k0=at(scene.loads.k0))
        return replace(
            self, scene=replace(scene, particles=at(scene.particles), loads=loads, material=law),
            growth=at(dict(self.growth)), layer=at(self.layer), stress=at(self.stress),
        )  # fmt: skip

    def with_strength_factor(self, factor: float) -> GridModel:
        """The same grid with all strength, random or not, times a factor."""
        zoned = isinstance(self.scene.material, Zoned)
        divides = "strength" in self.campaign.random and self.scene.boundary.friction is None and not zoned
        scene = self.scene if divides else jaxmpm.reduced(self.scene, self.strength_factor / factor)
        return replace(self, scene=scene, strength_factor=factor)

    def growth_of_trends(self) -> dict[str, tuple[jax.Array | None, ...]]:
        """By what the trend of each parameter that varies multiplies it at the particles (N,), in each layer."""
        site, numerics = self.campaign.site, self.campaign.grids[self.grid]
        return {
            name: growth_at(site, site.values_of(name, random), self._points(random), numerics)
            for name, random in self.campaign.random.items()
        }

    def _points(self, random: RandomField) -> jax.Array:
        """Points (d, N) m at which a field is taken: particles, or centres of their first cells in the ground's box."""
        position, grid, shape = self.scene.particles.position, self.scene.grid, self.campaign.site.shape
        if random.sampled_at == "particles":
            return position
        origin = jnp.asarray(grid.origin)[:, None]
        centre = origin + (jnp.floor((position - origin) / grid.cell) + 0.5) * grid.cell
        end = jnp.asarray(shape.corner) + jnp.asarray(shape.extent)
        return jnp.minimum(centre, end[:, None])

    def _drawn(self, coefficients: jax.Array | np.ndarray | None) -> dict[str, jax.Array]:
        """What is random at the particles (N,), in engineers' numbers."""
        sample, site = np.zeros(self.soil.modes) if coefficients is None else coefficients, self.campaign.site
        return {
            name: values_at(
                self.soil, name, site.values_of(name, random), self._points(random), self.growth[name], self.layer,
                sample, self.scene.grid.cell if random.sampled_at == "cell averages" else None,
            )
            for name, random in self.campaign.random.items()
        }  # fmt: skip

    def _at_contact(
        self, coefficients: jax.Array | np.ndarray | None, soil: Mapping[str, jax.Array]
    ) -> dict[str, jax.Array]:
        """Strength (nodes,) of the interface, where it is random or that of a sample's soil, whose numbers are given.

        soil: numbers of the law, by name.
        """
        if not self.of_contact:
            return {}
        contact, site = self.contact, self.campaign.site
        from_soil = contact.of_soil(soil) if site.contact_of_soil else {}
        from_soil = {name: from_soil[name] for name in self.of_contact if name in from_soil}
        sample = np.zeros(self.soil.modes) if coefficients is None else coefficients
        points = jnp.asarray(contact.points, self.scene.particles.position.dtype)
        for name, key in CONTACT.items():
            if name not in self.campaign.random:
                continue
            field, group = self.campaign.random[name], self.soil.groups_of(name)[None]
            gaussian = kl.field_at(group.expansion, self.soil.coefficients(sample)[name], group.inside(points))
            value = self.soil.marginal(field, name, sample, None).transform(gaussian)
            depth = site.depth(contact.points, field, 0)
            grown = None if field.trend is None else jnp.asarray(field.grown(depth), value.dtype)
            if (grown := times(grown, self.soil.factor(field, sample))) is not None:
                value = value * grown.astype(value.dtype)
            strength = jnp.tan(jnp.deg2rad(value)) if key == CONTACT["interface_friction"] else value
            from_soil[key] = contact.spread(self.strength_factor * strength)
        return from_soil

    def _under_water(self, coefficients: jax.Array | np.ndarray | None) -> dict[str, jax.Array]:
        """Pore pressure of a sample's own flow, and what goes with it; nothing where conductivity does not vary."""
        if not self.of_flow:
            return {}
        campaign, scene = self.campaign, self.scene
        site = under_own_flow(campaign, self.soil, coefficients).site
        assert site.pressure is not None
        bare = replace(scene, loads=replace(scene.loads, pore_pressure=None))
        wet = site.pressure.on(bare, site, campaign.grids[self.grid])
        weight = STANDARD_GRAVITY * wet.particles.mass / wet.particles.volume
        values = {PRESSURE: wet.loads.pore_pressure, "unit_weight": weight, ON_WALLS: wet.boundary.pressure}
        return {name: value for name in self.of_flow if (value := values[name]) is not None}

    def _in_law(self, parameters: Mapping[str, jax.Array], level: float | None) -> dict[str, jax.Array]:
        """Numbers (N,) of the law by engineer's name, reduced where calibrated: the one way from soil to particle."""
        parameters = {name: value for name, value in parameters.items() if name not in CONTACT}
        numbers = {name: self._of_engineers(name, value) for name, value in parameters.items() if name not in IN_LAW}
        site, soil = self.campaign.site, self.campaign.soil
        layer = np.zeros(self.scene.particles.mass.size, int) if self.layer is None else self.layer
        if SATURATED in parameters or wetted(site, soil):
            weights = parameters.get(SATURATED), parameters.get("unit_weight")
            numbers["unit_weight"] = wet_or_dry(self.scene, site, soil, layer, *weights, level)
        if "k0" in numbers:
            everywhere = self.scene.loads.k0
            assert everywhere is not None  # a layer without one has that of the scene
            numbers["k0"] = jnp.where(jnp.isnan(numbers["k0"]), everywhere, numbers["k0"])
        if self.stress is not None:
            grown = by_stress(site, soil, layer, self.stress, parameters.get(RATIO), numbers.get("strength"))
            numbers["strength"] = self._of_engineers("strength", grown)
        if self.strength_factor == 1:
            return numbers
        law = self.scene.material
        in_law = declared(law)
        full = with_parameters(law, {name: value for name, value in numbers.items() if name in in_law})
        reduced = declared(jaxmpm.laws.reduce_strength(full, jnp.asarray(1 / self.strength_factor, law.bulk.dtype)))
        count = self.scene.particles.mass.shape
        return {
            name: jnp.broadcast_to(reduced[name].value, count) if name in in_law else numbers[name]
            for name in self.names
        }

    def _of_engineers(self, name: str, value: jax.Array, *, inverse: bool = False) -> jax.Array:
        """A parameter's number in the law, of the engineer's; inverse: the engineer's, of that in the law."""
        number = declared(self.scene.material).get(name)
        if number is None:
            return value
        if isinstance(self.scene.material, Zoned):
            value = jnp.where(jnp.isnan(number.value), jnp.nan, value)  # in zones without it
        if number.parameter.angle:
            return jnp.rad2deg(value) if inverse else jnp.deg2rad(value)
        if not number.parameter.per_band:
            return value
        # The law's own number is of the grid's bands, that of the soil of one as thick as its `softening_length`.
        soils = [layer.soil for layer in self.campaign.site.soils(self.campaign.soil)]
        values = np.array([getattr(soil, name, None) for soil in soils], float)
        scale = number.value / (values[0] if self.layer is None else values[self.layer])
        return value / scale if inverse else value * scale


def _at(values: T, particles: np.ndarray, count: int) -> T:
    """Arrays of `count` particles in a tree, at some of them."""
    return jax.tree.map(lambda leaf: leaf[..., particles] if np.shape(leaf)[-1:] == (count,) else leaf, values)
