"""The model of a grid: its scene at rest, and the soil that a sample's coefficients give its particles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm
import kl
from cooperative.estimate import Sampling
from cooperative.measure import ColumnPlan, OpenGround
from cooperative.runs._initial import read_initial
from cooperative.runs._random_soil import RandomSoil, random_soil
from cooperative.scene import Campaign, RandomField, built
from jaxmpm import Face, Scene, State, column_shape, with_columns


@dataclass(frozen=True)
class GridModel:
    """One grid of a campaign, ready to run.

    grid: "rough" or "refined" of the `campaign`. scene, state: what a sample's soil is put into, at rest; what is
    random is there the same in a layer, and of no sample. soil: what is random. strength_factor: on strength, where the
    grids are calibrated. layer: number of the layer that each particle is of (N,), None where the ground has none.
    """

    grid: str
    campaign: Campaign
    scene: Scene
    state: State
    soil: RandomSoil
    strength_factor: float = 1.0
    layer: np.ndarray | None = None

    @property
    def half_size(self) -> np.ndarray:
        """Half the particle spacing per axis (d,) m."""
        return np.asarray(self.campaign.grids[self.grid].spacing) / 2

    @property
    def slides_on(self) -> bool:
        """Whether a run that ends once it has failed may be asked to slide on."""
        return self.grid == "refined" and bool(self.campaign.plan.slides)

    @property
    def slides_end(self) -> tuple[float, float] | None:
        """Displacement (m) from which on a run goes on beyond t_end, and up to when (s); None where none does."""
        run = self.campaign.run
        if run.last(self.grid) == run.t_end:
            return None
        return run.failure_displacement, run.last(self.grid)

    @property
    def geometry(self) -> Face | OpenGround:
        """The slope's face, or the height of the ground's surface above each particle."""
        shape = self.campaign.site.shape
        if shape.face is not None:
            return shape.face
        return OpenGround(
            shape.heights(*np.asarray(self.scene.particles.position[:-1], float)), self.campaign.site.track
        )

    @property
    def walls(self) -> tuple[tuple[int, int, float], ...]:
        """Axis, side (-1 low, 1 high) and place (m) of every wall but the base."""
        grid = self.scene.grid
        upright = len(grid.shape) - 1
        return tuple(
            (wall.axis, -1 if wall.side == "low" else 1, grid.origin[wall.axis] + wall.index * grid.cell)
            for wall in self.scene.walls
            if wall.axis != upright
        )

    @property
    def reach(self) -> float:
        """Distance up to which two particles hang together (m): a little more than the diagonal of a cell."""
        return 1.5 * self.scene.grid.cell

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that samples differ in, as `parameters` gives them."""
        random = tuple(self.campaign.random)
        bound = self.strength_factor != 1 and "friction" in random and "dilation" not in random
        return (*random, "dilation") if bound else random

    @property
    def own_start(self) -> bool:
        """Whether samples have an initial stress and a time step of their own: where stiffness or weight are random."""
        return not {"young", "poisson", "unit_weight"}.isdisjoint(self.names)

    def parameters(self, coefficients: jax.Array | np.ndarray) -> dict[str, jax.Array]:
        """The random parameters at the particles, each (N,), by name: in SI units, angles in degrees.

        coefficients: (modes,) of a sample. Raises ValueError for another number of them.
        """
        own = {group.layer: self.soil.coefficients(coefficients, group.layer) for group in self.soil.groups}
        found = {
            name: self._values(field, name, {layer: each[name] for layer, each in own.items() if name in each})
            for name, field in self.campaign.random.items()
        }
        return found if self.strength_factor == 1 else self._weakened(found)

    def varied(self, coefficients: jax.Array | np.ndarray) -> dict[str, jax.Array]:
        """The random parameters at the particles, each (N,), as `jaxmpm.solve_each` and `with_soil` take them: by the
        names of the law, angles in radians, softening that of the grid's bands."""
        found = self.parameters(coefficients)
        found |= {name: jnp.deg2rad(found[name]) for name in ANGLES if name in found}
        found |= {name: found[name] * self._per_band(name) for name in PER_BAND if name in found}
        return {IN_LAW.get(name, name): value for name, value in found.items()}

    def _per_band(self, name: str) -> jax.Array:
        """The law's number of a parameter over the scene's own, which is of a band as thick as `softening_length`."""
        part, _, parameter = IN_LAW[name].partition(".")
        soils = [each.soil for each in self.campaign.site.soils(self.campaign.soil)]
        own = np.array([getattr(soil, name) for soil in soils])
        return getattr(getattr(self.scene.material, part), parameter) / (
            own[0] if self.layer is None else own[self.layer]
        )

    def of_sample(self, coefficients: jax.Array | np.ndarray) -> tuple[Scene, State]:
        """Scene and initial state of a sample, with its own time step. Raises ValueError for values that no soil
        has."""
        return jaxmpm.with_soil(self.scene, self.state, **self.varied(coefficients))

    @property
    def median(self) -> tuple[Scene, State]:
        """Scene and initial state of the median soil: that of a sample whose coefficients are all zero."""
        return self.of_sample(np.zeros(self.soil.modes))

    def time_step(self, coefficients: jax.Array | np.ndarray) -> float:
        """Of a sample (s)."""
        if not self.own_start:
            return float(self.scene.time_step)
        scene, _ = jaxmpm.with_soil(self.scene, jaxmpm.unstressed(self.scene), **self.varied(coefficients))
        return float(scene.time_step)

    def strength(self, coefficients: jax.Array | np.ndarray) -> jax.Array:
        """Undrained strength at the particles (N,) Pa, for coefficients (modes,). Raises ValueError where that is not
        what is random."""
        if "strength" not in self.campaign.random:
            raise ValueError(f"random are {', '.join(self.campaign.random)}, not the strength: give [strength]")
        return self.parameters(coefficients)["strength"]

    def looking(self) -> GridModel:
        """The same grid, whose runs keep what passes over each column of cells where the scene wants that of it. Raises
        ValueError for exposed places outside the ground."""
        hazard = self.campaign.hazard
        if hazard is None or self.grid != "refined":
            return self
        plan = column_plan(self.scene)
        for place in hazard.places:
            place.columns(plan)
        moved = self.campaign.run.failure_displacement
        return replace(self, state=with_columns(self.scene, self.state, moved=moved, every=hazard.every))

    def with_measured(self, campaign: Campaign) -> GridModel:
        """The same grid once its campaign is measured: a rough one with the strength of its calibration, unless it has
        that already. Raises ValueError for exposed places outside the ground."""
        model, calibration = replace(self, campaign=campaign).looking(), campaign.measured.calibration
        factor = calibration.factor if calibration is not None and self.grid == "rough" else 1.0
        return model if factor == self.strength_factor else model.weakened(factor)

    def weakened(self, factor: float) -> GridModel:
        """The same grid with all strength, random or not, times a factor."""
        known = "strength" in self.campaign.random and self.campaign.site.interface is None
        scene = self.scene if known else jaxmpm.reduced(self.scene, 1 / factor)
        return replace(self, scene=scene, strength_factor=factor)

    def _weakened(self, found: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Parameters with their strength times the factor: of friction its tangent."""
        factor, weaker = self.strength_factor, dict(found)
        for name in {"strength", "cohesion", "residual_cohesion"} & found.keys():
            weaker[name] = found[name] * factor
        for name in {"friction", "residual_friction"} & found.keys():
            weaker[name] = jnp.rad2deg(jnp.arctan(jnp.tan(jnp.deg2rad(found[name])) * factor))
        if {"friction", "dilation"} & found.keys():
            law: Any = self.scene.material
            friction = weaker.get("friction", jnp.rad2deg(law.friction))
            dilation = jnp.minimum(found.get("dilation", jnp.rad2deg(law.dilation)), friction)
            weaker["dilation"] = jnp.broadcast_to(dilation, self.scene.particles.mass.shape)
        return weaker

    def _values(
        self, field: RandomField, name: str, coefficients: Mapping[int | None, jax.Array | np.ndarray]
    ) -> jax.Array:
        """A parameter at the particles (N,), of the coefficients of its fields by the layer at which they stop."""
        position = self.scene.particles.position
        points = position if field.sampled_at == "particles" else self._cell_centres()
        depth = None
        layers = self.campaign.site.values_of(name, field)
        each = [layer if isinstance(layer, RandomField) else None for layer in layers]
        if any(layer is not None and layer.trend is not None for layer in each):
            depth = self.campaign.site.depth(np.asarray(points))
        grown = tuple(
            None if layer is None or layer.trend is None else jnp.asarray(layer.grown(depth), position.dtype)
            for layer in each
        )
        marginals = tuple(
            layer.distribution if isinstance(layer, RandomField) else kl.Normal(layer, 0.0) for layer in layers
        )
        groups = self.soil.groups_of(name)
        fields = tuple((group.expansion, coefficients[stops], group.inside(points)) for stops, group in groups.items())
        numbers = list(groups)
        of_layer = [number if number in groups else None for number in range(len(layers))]
        which = tuple(numbers.index(stops) if stops in groups else 0 for stops in of_layer)
        return _values(fields, which, marginals, grown, self.layer)

    def _cell_centres(self) -> jax.Array:
        """Centre of the cell that each particle starts in (d, N) m, kept in the ground's box where that ends in it."""
        grid, shape = self.scene.grid, self.campaign.site.shape
        origin = jnp.asarray(grid.origin)[:, None]
        centre = origin + (jnp.floor((self.scene.particles.position - origin) / grid.cell) + 0.5) * grid.cell
        end = jnp.asarray(shape.corner) + jnp.asarray(shape.extent)
        return jnp.minimum(centre, end[:, None])


ANGLES = ("friction", "dilation", "residual_friction")
"""Parameters that scenes give in degrees and laws take in radians."""

IN_LAW = {
    "softening_modulus": "softening.modulus",
    "residual_ratio": "softening.residual_ratio",
    "strain_95": "softening.strain_95",
    "residual_cohesion": "softening.cohesion",
    "residual_friction": "softening.friction",
    "softening_strain": "softening.strain",
    "rate_coefficient": "rate.coefficient",
}
"""Names that parameters of a scene have in the law, where those are others."""

PER_BAND = ("softening_modulus", "strain_95", "softening_strain")
"""Parameters whose number in the law goes with the thickness of the grid's shear bands."""


@partial(jax.jit, static_argnames="which")
def _values(
    fields: tuple[tuple[kl.Expansion, jax.Array | np.ndarray, jax.Array], ...],
    which: tuple[int, ...],
    marginals: tuple[Any, ...],
    grown: tuple[jax.Array | None, ...],
    layer: np.ndarray | None,
) -> jax.Array:
    """fields: expansions, their coefficients and points. which: number of the field of each layer."""
    gaussian = [kl.field_at(*field) for field in fields]
    each = [
        marginal.transform(gaussian[number]) if growth is None else marginal.transform(gaussian[number]) * growth
        for number, marginal, growth in zip(which, marginals, grown, strict=True)
    ]
    if layer is None:
        return each[0]
    return jnp.take_along_axis(jnp.stack(each), jnp.asarray(layer)[None], axis=0)[0]


def coefficients_of(campaign: Campaign, soil: RandomSoil) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for."""
    plan = campaign.plan
    return np.asarray(plan.coefficients(jax.random.key(plan.seed), plan.samples, soil.modes))


def sampling_of(campaign: Campaign) -> Sampling:
    """The first phase as the campaign's estimator sees it; random fields are expanded when first asked for."""
    return Sampling(
        campaign.plan.samples,
        campaign.run.failure_displacement,
        campaign.plan.screening_stop,
        modes=lambda: int(random_soil(campaign).modes),
        draw=lambda: coefficients_of(campaign, random_soil(campaign)),
    )


def build(
    campaign: Campaign, grid: str, soil: RandomSoil, *, at_rest: bool = True, folder: Path | None = None
) -> GridModel:
    """Scene and initial state of one grid; ValueError where slope, soil, grid and exposed places do not fit together.

    at_rest: False leaves the state free of stress, which is not solved for then: for who looks and does not run.
    folder: of the campaign, whose initial stress is taken where it keeps one of this grid.
    """
    scene, state = built(campaign, grid, at_rest=False)
    if at_rest:
        kept = None if folder is None else read_initial(folder, grid, scene, state)
        state = jaxmpm.at_rest(scene, apic=campaign.grids[grid].apic) if kept is None else kept
    layer = campaign.site.layer_of(np.asarray(scene.particles.position), campaign.grids[grid])
    return GridModel(grid, campaign, scene, state, soil, layer=layer).with_measured(campaign)


def column_plan(scene: Scene) -> ColumnPlan:
    """Where the columns of cells of a grid stand, between its walls where it has some."""
    grid, shape = scene.grid, column_shape(scene)
    ends = []
    for axis, count in enumerate(shape):
        walls = {wall.side: wall.index for wall in scene.walls if wall.axis == axis}
        low, high = walls.get("low", 0), walls.get("high", count)
        ends.append((grid.origin[axis] + low * grid.cell, grid.origin[axis] + high * grid.cell))
    return ColumnPlan(tuple(grid.origin[: len(shape)]), grid.cell, shape, tuple(ends))
