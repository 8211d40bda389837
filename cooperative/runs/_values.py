"""A parameter that varies at points of one sample, and by what its trends multiply it there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import kl
from cooperative.runs._random_soil import RandomSoil
from cooperative.scene import RandomField, Site
from jaxmpm import Discretisation
from kl.marginal import Marginal


def growth_at(
    site: Site, layers: Sequence[RandomField | float], points: jax.Array, numerics: Discretisation
) -> tuple[jax.Array | None, ...]:
    """By what trends multiply a parameter at points (N,), in each layer; None where it has none.

    Args:
        site: of the campaign.
        layers: what the parameter is in each layer, a field or a number.
        points: (d, N) m.
        numerics: of the grid on which the layers lie.
    """

    def growth(field: RandomField | float, number: int) -> jax.Array | None:
        if not isinstance(field, RandomField) or field.trend is None:
            return None
        depth = site.depth(np.asarray(points), field, number, numerics if site.layers else None)
        return jnp.asarray(field.grown(depth), points.dtype)

    return tuple(growth(field, number) for number, field in enumerate(layers))


def values_at(
    soil: RandomSoil,
    name: str,
    layers: Sequence[RandomField | float],
    points: jax.Array,
    growth: Sequence[jax.Array | None],
    layer: np.ndarray | None,
    sample: jax.Array | np.ndarray,
    cell: float | None = None,
) -> jax.Array:
    """A parameter at points (N,) of a sample.

    Args:
        soil: what is random.
        name: of the parameter.
        layers: what it is in each layer, a field or a number.
        points: (d, N) m.
        growth: by what trends multiply it at the points (N,), in each layer.
        layer: number of the layer of each point (N,), None where the ground has none.
        sample: (modes,) of the sample.
        cell: edge (m) of the squares or cubes around the points over which its fields are averaged, None for none.
    """
    groups = soil.groups_of(name)
    fields = tuple(
        (
            group.expansion if cell is None else kl.field.averaged(group.expansion, (cell,) * len(points)),
            soil.coefficients(sample, stops)[name],
            group.inside(points),
        )
        for stops, group in groups.items()
    )
    numbers = list(groups)
    of_layer = [number if number in groups else None for number in range(len(layers))]
    marginals = tuple(soil.marginal(layer, name, sample, stops) for layer, stops in zip(layers, of_layer, strict=True))
    which = tuple(numbers.index(stops) if stops in groups else 0 for stops in of_layer)
    grown = tuple(times(by, soil.factor(layer, sample)) for by, layer in zip(growth, layers, strict=True))
    return _values(fields, which, marginals, grown, layer)


def times(growth: jax.Array | None, factor: jax.Array | None) -> jax.Array | None:
    """The product of two factors (N,) or (), of which None is none."""
    if growth is None or factor is None:
        return factor if growth is None else growth
    return growth * factor.astype(growth.dtype)


@partial(jax.jit, static_argnames="which")
def _values(
    fields: tuple[tuple[kl.Expansion | kl.field.Waves, jax.Array | np.ndarray, jax.Array], ...],
    which: tuple[int, ...],
    marginals: tuple[Marginal, ...],
    grown: tuple[jax.Array | None, ...],
    layer: np.ndarray | None,
) -> jax.Array:
    """fields: expansions, their coefficients and points.

    which: number of the field of each layer.
    """
    gaussian = [kl.field_at(*field) for field in fields]
    values = [
        marginal.transform(gaussian[number]) if growth is None else marginal.transform(gaussian[number]) * growth
        for number, marginal, growth in zip(which, marginals, grown, strict=True)
    ]
    if layer is None:
        return values[0]
    return jnp.take_along_axis(jnp.stack(values), jnp.asarray(layer)[None], axis=0)[0]
