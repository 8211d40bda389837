"""Transfers between the particles and the grid of a scene, and the averages that consist of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import around, fold, one_with, unfold
from jaxmpm.laws import frictional
from jaxmpm.protocols import Tensor
from jaxmpm.transfer import filtered, g2p, nodal_momentum, p2g, within_cells
from jaxmpm.types import Scene, State

# Nodes with less than this share of the mean particle mass get no velocity. Their momentum is lost, so the share is far
# below rounding; a node's velocity, a ratio of sums with the same weights, is accurate down to it.
MASS_FLOOR = 1e-12


class Maps(NamedTuple):
    """The transfers between a scene's grid and its particles at given positions.

    At open ends of the ground particles reach nodes beyond the last plane. `fold` adds sums there to the nodes that
    they are identified with, `unfold` copies values back.

    Args:
        scene: whose grid, kernel and engine are used.
        position: (d, N) m of the particles on the grid.
    """

    scene: Scene
    position: Array

    def to_grid(self, carried: Array | None, stress: Array | None, upright: Array | None = None) -> Array:
        """Map particles to nodes: see `jaxmpm.transfer.p2g`."""
        return self.fold(self.to_all_nodes(carried, stress, upright))

    def to_particles(self, nodal: Array, *, values: int, gradients: int) -> tuple[Array, Array]:
        """Interpolate nodal values at particles: see `jaxmpm.transfer.g2p`."""
        return self.from_all_nodes(self.unfold(nodal), values=values, gradients=gradients)

    def sums(
        self, carried: Mapping[str, Array], stress: Array | None, upright: Array | None = None
    ) -> dict[str, Array]:
        """Map blocks of channels to all nodes that particles reach.

        Args:
            carried: values (k, N) by name.
            stress: as of `jaxmpm.transfer.p2g`.
            upright: likewise.

        Returns:
            Sums (nodes, k) by the same names, of the stress the force (nodes, d) N, and "upright".
        """
        widths = {name: len(values) for name, values in carried.items()}
        if stress is not None:
            widths["force"] = self.scene.grid.dimension
        if upright is not None:
            widths["upright"] = len(upright)
        nodal = self.to_all_nodes(jnp.concatenate(list(carried.values())), stress, upright)
        blocks = jnp.split(nodal, np.cumsum(list(widths.values()))[:-1], axis=1)
        return dict(zip(widths, blocks, strict=True))

    def values(self, nodal: Mapping[str, Array], *, gradients: int = 0) -> tuple[dict[str, Array], Array]:
        """Interpolate blocks of nodal values at particles.

        Args:
            nodal: values (nodes, k) by name.
            gradients: number of channels, the first ones, whose gradients are interpolated too.

        Returns:
            Values (k, N) by the same names, and the gradients as of `jaxmpm.transfer.g2p`.
        """
        widths = [block.shape[1] for block in nodal.values()]
        channels = jnp.concatenate(list(nodal.values()), axis=1)
        values, gradient = self.to_particles(channels, values=sum(widths), gradients=gradients)
        return dict(zip(nodal, jnp.split(values, np.cumsum(widths)[:-1]), strict=True)), gradient

    def to_all_nodes(self, carried: Array | None, stress: Array | None, upright: Array | None = None) -> Array:
        """As `to_grid`, at all nodes that particles reach, those beyond open ends of the ground included."""
        grid, numerics = self.scene.grid, self.scene.numerics
        return p2g(grid, numerics.kernel, self.position, carried, stress, upright=upright, engine=numerics.engine)

    def from_all_nodes(self, nodal: Array, *, values: int, gradients: int) -> tuple[Array, Array]:
        """As `to_particles`, from all nodes that particles reach."""
        grid, numerics = self.scene.grid, self.scene.numerics
        return g2p(
            grid, numerics.kernel, self.position, nodal, values=values, gradients=gradients, engine=numerics.engine
        )

    def fold(self, reached: Array) -> Array:
        """Sums (nodes, c) with those beyond open ends added to the nodes that they are identified with."""
        return fold(one_with(self.scene), self.scene.grid, reached)

    def unfold(self, nodal: Array) -> Array:
        """Nodal values (nodes, c), copied to the nodes beyond open ends."""
        return unfold(one_with(self.scene), self.scene.grid, nodal)

    def momentum(self, moving: Array) -> Array:
        """Momentum (nodes, d) kg m/s from the channels of `jaxmpm.transfer.momentum` at all nodes that particles reach.

        An affine part refers to the positions of these nodes, so it is evaluated before those beyond open ends are
        added.
        """
        return self.fold(nodal_momentum(self.scene.grid, moving))

    def gradient(self, velocity: Array) -> Array:
        """Gradient (d, d, N) 1/s at the particles of velocities (nodes, d) m/s."""
        return self.to_particles(velocity, values=0, gradients=self.scene.grid.dimension)[1]

    def average(self, values: Array, passes: int) -> Array:
        """Average (N,) of `values` (N,) over the particles nearby, weighted by mass, through `passes` filters."""
        m = self.scene.particles.mass
        sums = self.to_grid(jnp.stack([m, m * values]), None)
        averaged, _ = self.to_particles(self.nodal_average(sums, passes), values=1, gradients=0)
        return averaged[0]

    def nodal_average(self, sums: Array, passes: int) -> Array:
        """Averages (nodes, c) from sums (nodes, 1 + c) of mass (kg) and of values by mass, through `passes` filters."""
        sums = filtered(self.scene.grid, sums, passes)
        return reciprocal(self.scene, sums[:, :1]) * sums[:, 1:]

    def cell_average(self, values: Array, volume: Array) -> Array:
        """Average (N,) of `values` (N,) over each cell by `volume` (N,) m3; soil with friction and other soil apart."""
        scene, kind = self.scene, frictional(self.scene.material)
        apart = None if isinstance(kind, bool) else kind
        return within_cells(scene.grid, self.position, values, volume, apart, engine=scene.numerics.engine)

    def unlocked(self, strain: Tensor, volume: Array) -> Tensor:
        """The strain with its mean averaged as the scene requires; `volume` (N,) m3 is that of the particles."""
        scene = self.scene
        if scene.numerics.fbar:
            return tensors.with_mean(strain, self.average(tensors.mean(strain), 0))
        if scene.numerics.cell_average:
            return tensors.with_mean(strain, self.cell_average(tensors.mean(strain), volume))
        return strain


def grid_position(scene: Scene, state: State) -> Array:
    """Positions of particles on the grid (d, N) m; tied sides wrap them round."""
    position = scene.particles.position + state.displacement
    return position if scene.boundary.tied is None else around(scene.boundary.tied, scene.grid, position)


def reciprocal(scene: Scene, mass: Array) -> Array:
    """1 / mass at nodes with mass, else 0."""
    carries = mass > MASS_FLOOR * jnp.mean(scene.particles.mass)
    return 1 / jnp.where(carries, mass, jnp.inf)
