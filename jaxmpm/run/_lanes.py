"""Lanes whose laws differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.laws import with_parameters
from jaxmpm.protocols import Material
from jaxmpm.setup import check_scene, check_shape, parameter_names
from jaxmpm.types import Scene

Values = TypeVar("Values")


def lanes(scene: Scene, **values: Array) -> tuple[Scene, Scene]:
    """A scene whose material differs between lanes, and the axes for `solve(..., axes=axes)`.

    Args:
        scene: that lanes share.
        **values: parameters of the material by name, with the lanes as leading axis: `lanes(scene, strength=...)` with
            strength (B,) or (B, N) Pa.

    Returns:
        Scene, and axes: a scene with 0 at leaves that have lanes first, None at the others.

    Raises:
        ValueError: If a name is unknown or one of stiffness, a shape is different, or a value is beyond its limit; the
            lane is its first index.
    """
    unknown = set(values) - set(parameter_names(scene))
    if unknown or not values:
        raise ValueError(
            f"{sorted(unknown)} is no parameter of {type(scene.material).__name__}: "
            f"use one of {sorted(parameter_names(scene))}"
        )
    if stiff := sorted({"bulk", "shear"} & values.keys()):
        raise ValueError(
            f"{' and '.join(stiff)} of lanes: time step and initial stress go with the stiffness, give it to "
            "`solve_each` or `with_soil`"
        )
    first = {name: jax.tree.leaves(value)[0] for name, value in values.items()}
    count = {np.shape(leaf)[:1] for leaf in first.values()}
    for name, leaf in first.items():
        if np.ndim(leaf) < 1 or len(count) > 1 or not len(leaf):
            raise ValueError(f"{name} has shape {np.shape(leaf)}: give (lanes,) or (lanes, N), as many for every name")
        check_shape(f"a lane of {name}", leaf[0], scene.particles)
    return varied_lanes(scene, partial(with_parameters, scene.material), {n: jnp.asarray(v) for n, v in values.items()})


def varied_lanes(scene: Scene, law_of: Callable[[Values], Material], lanes: Values) -> tuple[Scene, Scene]:
    """A scene with a law for each lane, and the axes for `solve(..., axes=axes)`.

    Args:
        scene: that lanes share.
        law_of: function of one lane's values that returns its law.
        lanes: pytree of arrays (B, ...), values of each lane.

    Returns:
        Scene and axes, as of `lanes`.

    Raises:
        ValueError: If a law is beyond its limits.
    """
    first = law_of(jax.tree.map(lambda leaf: leaf[0], lanes))
    axes = jax.tree.map(lambda one, other: None if one is other else 0, scene.material, first)
    varied = replace(scene, material=jax.vmap(law_of, out_axes=axes)(lanes))
    axes = replace(jax.tree.map(lambda _: None, scene), material=axes)
    check_scene(varied, axes)
    return varied, axes
