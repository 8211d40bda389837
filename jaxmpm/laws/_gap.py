"""The gap in soil that has opened: it closes before the soil bears pressure again."""

from __future__ import annotations

from functools import singledispatch

import jax.numpy as jnp
from jax import Array

from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.storage import stored_in_reverse
from jaxmpm.tensors import mean

SHARE = 1e-3
"""Largest pressure of loose soil, over the stress that the cutoff removed; rounding is far smaller."""


@singledispatch
def remembers_gap(law: Material) -> bool:
    """Whether a law has a tension cutoff and a memory of the gap that it opens.

    Args:
        law: a law.

    Returns:
        Whether the state has a gap.
    """
    return getattr(law, "tension_cutoff", None) is not None and getattr(law, "gap_memory", False)


@singledispatch
def update_with_gap(
    law: Material,
    strain: Tensor,
    stress: Tensor,
    history: History,
    dt: Array | None,
    *,
    gap: Array | None,
    received: Array | None = None,
    logarithmic: bool = False,
) -> tuple[Tensor, History, Array | None]:
    """Stress, history and gap after a strain increment.

    Soil that shrinks loses its tension first and then its gap; only the rest of the strain reaches the law. So its mean
    stress cannot become compressive before the opened volume has closed. The growth in volume has two parts: the
    elastic one, mean stress over bulk modulus, and the gap; so soil can rebound from its stress at rest. Growth under
    pressure is dilation and opens no gap.

    Args:
        law: the soil's law.
        strain: increment, tension positive.
        stress: tensor (Pa).
        history: of the law.
        dt: duration of the increment (s).
        gap: (N,) growth in volume, as a logarithm, that the tension cutoff has left without stress; None without
            memory.
        received: (N,) growth in volume, as a logarithm, that the soil has of the gaps of its neighbours and no strain
            shows, to which water in its voids yields; None for none.
        logarithmic: whether the trace of the strain is the logarithm of the volume's growth, else its increase.

    Returns:
        Stress (Pa), history and gap.
    """
    if gap is None:
        return *law.update(strain, stress, history, dt), None
    increase, before = stored_in_reverse([3 * mean(strain), mean(stress)])
    grown = increase if logarithmic else jnp.log1p(increase)
    shut = jnp.clip(jnp.minimum(-before / law.bulk, 0) - grown, 0, gap)
    remaining = jnp.where(shut > 0, grown + shut, increase)
    xx, yy, zz, xy, yz, xz = strain
    more = (remaining - increase) / 3
    stress, history = law.update((xx + more, yy + more, zz + more, xy, yz, xz), stress, history, dt)
    after = mean(stress)
    cut = before + law.bulk * remaining - after
    loose = after >= -SHARE * jnp.maximum(cut, 0)
    opened = jnp.maximum(gap + grown - (after - before) / law.bulk, 0)
    return stress, history, jnp.where(loose, opened, gap - shut)
