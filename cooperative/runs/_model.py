"""The model of a grid: its scene at rest, and the strength that a sample's coefficients give its particles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm
import kl
from cooperative.estimate import Sampling
from cooperative.measure import SlopeGeometry
from cooperative.runs._initial import read_initial
from cooperative.scene import Campaign, Strength, built
from jaxmpm import Scene, Slope, State


@dataclass(frozen=True)
class GridModel:
    """One grid of a campaign, ready to run.

    grid: "rough" or "refined" of the `campaign`. scene, state: what the solver runs, at rest. expansion: of the random
    field. strength_factor: on its strength, where the grids are calibrated.
    """

    grid: str
    campaign: Campaign
    scene: Scene
    state: State
    expansion: kl.Expansion
    strength_factor: float = 1.0

    @property
    def half_size(self) -> np.ndarray:
        """Half the particle spacing per axis (d,) m."""
        return np.asarray(self.campaign.grids[self.grid].spacing) / 2

    @property
    def slides_on(self) -> bool:
        """Whether a run that ends once it has failed may be asked to slide on."""
        return self.grid == "refined" and bool(self.campaign.plan.slides)

    @property
    def reach(self) -> float:
        """Distance up to which two particles hang together (m): a little more than the diagonal of a cell."""
        return 1.5 * self.scene.grid.cell

    def strength(self, coefficients: jax.Array | np.ndarray) -> jax.Array:
        """Undrained strength at the particles (N,) Pa, for coefficients (M,)."""
        strength = self.campaign.strength
        marginal = strength.marginal(strength.mean, strength.cov)
        points = self.scene.particles.position if strength.sampled_at == "particles" else self._cell_centres()
        field = _strength(self.expansion, marginal, coefficients, points)
        return field if self.strength_factor == 1 else field * self.strength_factor

    def _cell_centres(self) -> jax.Array:
        """Centre of the cell that each particle starts in (d, N) m, kept in the slope's box where that ends in it."""
        grid, shape = self.scene.grid, self.campaign.slope
        origin = jnp.asarray(grid.origin)[:, None]
        centre = origin + (jnp.floor((self.scene.particles.position - origin) / grid.cell) + 0.5) * grid.cell
        return jnp.minimum(centre, jnp.asarray(box_of(shape))[:, None])


@jax.jit
def _strength(
    expansion: kl.Expansion, marginal: Any, coefficients: jax.Array | np.ndarray, position: jax.Array
) -> jax.Array:
    return marginal.transform(kl.field_at(expansion, coefficients, position))


def expansion_of(campaign: Campaign) -> kl.Expansion:
    """The strength's expansion over the whole box of the slope, the same for every grid."""
    return _expansion(campaign.strength, box_of(campaign.slope))


@lru_cache(maxsize=8)
def _expansion(strength: Strength, extent: tuple[float, ...]) -> kl.Expansion:
    return kl.expand(
        tuple(strength.correlation(length) for length in strength.length),
        origin=(0.0,) * len(extent),
        extent=extent,
        energy=strength.energy,
    )


def box_of(shape: Slope) -> tuple[float, ...]:
    """Edges of the box from the origin that holds the slope (d,) m."""
    top = shape.foundation + shape.height
    return (shape.length, top) if shape.width is None else (shape.length, shape.width, top)


def coefficients_of(campaign: Campaign, expansion: kl.Expansion) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for."""
    plan = campaign.plan
    return np.asarray(plan.coefficients(jax.random.key(plan.seed), plan.samples, expansion.modes))


def sampling_of(campaign: Campaign) -> Sampling:
    """The first phase as the campaign's estimator sees it; the random field is expanded when first asked for."""
    return Sampling(
        campaign.plan.samples,
        campaign.run.failure_displacement,
        campaign.plan.screening_stop,
        modes=lambda: int(expansion_of(campaign).modes),
        draw=lambda: coefficients_of(campaign, expansion_of(campaign)),
    )


def build(
    campaign: Campaign, grid: str, expansion: kl.Expansion, *, at_rest: bool = True, folder: Path | None = None
) -> GridModel:
    """Scene and initial state of one grid; ValueError where slope, soil and grid do not fit together.

    at_rest: False leaves the state free of stress, which is not solved for then: for who looks and does not run.
    folder: of the campaign, whose initial stress is taken where it keeps one of this grid.
    """
    scene, state = built(campaign, grid, at_rest=False)
    if at_rest:
        kept = None if folder is None else read_initial(folder, grid, scene, state)
        state = jaxmpm.at_rest(scene, apic=campaign.grids[grid].apic) if kept is None else kept
    factor = campaign.calibration.factor if campaign.calibration and grid == "rough" else 1.0
    return GridModel(grid, campaign, scene, state, expansion, factor)


def geometry_of(campaign: Campaign) -> SlopeGeometry:
    """Where the slope's toe is and how high it stands."""
    shape = campaign.slope
    return SlopeGeometry(toe_x=shape.toe_x, toe_z=shape.foundation, height=shape.height)
