"""The contact of soil with rigid ground, node by node: where it lies, and the strength of the soil on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.boundary import on_contact
from jaxmpm.equations import MASS_FLOOR, Maps
from jaxmpm.laws import declared
from jaxmpm.support.values import by_value
from jaxmpm.types import Scene


@by_value
@dataclass(frozen=True)
class Contact:
    """Nodes of a scene at which soil slides on rigid ground.

    Args:
        scene: at the start.
        nodes: their numbers (n,).
        points: their positions (d, n) m.
        below: for each of them the number of the nearest one below soil (n,), itself where soil lies on it.
    """

    scene: Scene = field(repr=False)
    nodes: np.ndarray
    points: np.ndarray
    below: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Contact:
        """That of a scene at the start.

        Args:
            scene: with walls with friction or a base.

        Returns:
            Its nodes.
        """
        grid, particles = scene.grid, scene.particles
        with jax.ensure_compile_time_eval():
            nodes = np.flatnonzero(on_contact(scene))
            volume = np.asarray(Maps(scene, particles.position).to_grid(particles.volume[None], None))[nodes, 0]
        points = np.array(grid.origin)[:, None] + grid.cell * np.array(np.unravel_index(nodes, grid.shape))
        covered = np.flatnonzero(volume > MASS_FLOOR * float(np.mean(np.asarray(particles.volume))))
        nearest = np.zeros(nodes.size, int)
        if covered.size:
            from scipy.spatial import KDTree  # loads what only contacts need

            nearest = covered[KDTree(points[:, covered].T).query(points.T)[1]]
        return cls(scene, nodes, points, nodes[nearest])

    def spread(self, values: ArrayLike) -> Array:
        """Values at all nodes of the grid (nodes,), of those at the contact's (n,); 0 at others."""
        values = jnp.asarray(values, self.scene.particles.mass.dtype)
        return jnp.zeros(self.scene.grid.nodes, values.dtype).at[self.nodes].set(values)

    def of_soil(self, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Strength of the soil that lies on the contact at the start, as `with_soil` takes it.

        It is the average by volume over the soil at each node, and that of the nearest soil where none lies.

        Args:
            values: `friction` (radians), `cohesion` and `strength` (Pa) of the soil, numbers or (N,); those that are
                left out are the scene's own, nan where soil has none.

        Returns:
            Friction and cohesion (nodes,), by their names in `jaxmpm.setup.WALL_STRENGTH`.
        """
        numbers = {name: entry.value for name, entry in declared(self.scene.material).items()} | dict(values)
        volume = self.scene.particles.volume

        def number(name: str) -> Array:
            return jnp.nan_to_num(jnp.broadcast_to(jnp.asarray(numbers.get(name, 0.0), volume.dtype), volume.shape))

        friction, bond = jnp.tan(number("friction")), number("cohesion") + number("strength")
        maps = Maps(self.scene, self.scene.particles.position)
        strength = {"wall_friction": volume * friction, "wall_cohesion": volume * bond}
        carried = {name: values[None] for name, values in {"volume": volume, **strength}.items()}
        sums = {name: maps.fold(block)[self.below, 0] for name, block in maps.sums(carried, None).items()}
        return {name: self.spread(sums[name] / sums["volume"]) for name in strength}
