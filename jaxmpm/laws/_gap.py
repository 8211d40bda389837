"""The gap in soil that has come apart: it closes before the soil bears pressure again."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxmpm.tensors import mean
from jaxmpm.types import Material, Tensor

SHARE = 1e-3
"""Pressure over the stress that the cutoff took away, up to which soil is loose: rounding is far less."""


@singledispatch
def remembers_gap(law: Material) -> bool:
    """Whether soil of this law has a tension cutoff and remembers what it opens."""
    return getattr(law, "tension_cutoff", None) is not None and getattr(law, "gap_memory", False)


@singledispatch
def update_with_gap(
    law: Material,
    strain: Tensor,
    stress: Tensor,
    history: Any,
    dt: Array | None,
    *,
    gap: Array | None,
    logarithmic: bool = False,
) -> tuple[Tensor, Any, Array | None]:
    """Stress (Pa), history and gap (N,) after a strain increment within dt (s), as `Material.update` has the first two.

    gap: growth in volume, a logarithm, that the tension cutoff has not answered with stress; None where it is not
    remembered. logarithmic: whether the trace of the strain is the growth of a step, else the volume's increase.

    Soil that shrinks loses its tension first and then its gap, and only what is left strains it: its mean stress
    cannot become compressive before the opened volume has closed. What soil grows by is the elastic part, its mean
    stress over the bulk modulus, and the gap: so it may rebound from the stress that it had at rest. Growth under
    pressure is dilation, and opens no gap.
    """
    if gap is None:
        return *law.update(strain, stress, history, dt), None
    increase, before = 3 * mean(strain), mean(stress)
    grown = increase if logarithmic else jnp.log1p(increase)
    shut = jnp.clip(jnp.minimum(-before / law.bulk, 0) - grown, 0, gap)
    left = jnp.where(shut > 0, grown + shut, increase)
    xx, yy, zz, xy, yz, xz = strain
    more = (left - increase) / 3
    stress, history = law.update((xx + more, yy + more, zz + more, xy, yz, xz), stress, history, dt)
    after = mean(stress)
    cut = before + law.bulk * left - after
    loose = after >= -SHARE * jnp.maximum(cut, 0)
    opened = jnp.maximum(gap + grown - (after - before) / law.bulk, 0)
    return stress, history, jnp.where(loose, opened, gap - shut)
