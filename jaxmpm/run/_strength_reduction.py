"""Factor of safety by strength reduction: bisection in rounds, each round one batch."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from jaxmpm import diagnostics
from jaxmpm.laws import reduce_strength
from jaxmpm.run._integrate import Settle, check_run, lanes, repeat, solve
from jaxmpm.site import check_scene
from jaxmpm.types import Scene, State


@dataclass(frozen=True)
class FactorOfSafety:
    """stable: largest reduction factor R that stands. fails: smallest that fails, one resolution above.

    tried: every (R, largest displacement in m) that was run, by R; where the slope failed, the displacement
    is the one at which that was decided.
    """

    stable: float
    fails: float
    tried: tuple[tuple[float, float], ...]


def factor_of_safety(
    scene: Scene,
    state: State,
    *,
    failure_displacement: float = 1.0,
    bracket: tuple[float, float] = (0.5, 3.0),
    resolution: float = 0.01,
    t_end: float = 20.0,
    batch: int = 8,
    settle: Settle | None = None,
) -> FactorOfSafety:
    """Divide the strength by R and find where the slope fails.

    It fails where its largest displacement passes `failure_displacement` (m) within t_end (s).
    bracket: R that stands and R that fails. resolution: R is a multiple of it. batch: lanes per round.
    settle: when a lane counts as standing before t_end; the default of `Settle`.
    Raises ValueError when the bracket's ends do not stand and fail, FloatingPointError when a run breaks off.
    """
    check.positive("failure_displacement", failure_displacement, "m")
    check.positive("resolution", resolution)
    check.positive("bracket", bracket)
    check.whole("batch", batch, least=2)
    check_run(t_end, settle, failure_displacement)
    check_scene(scene)
    low, high = round(bracket[0] / resolution), round(bracket[1] / resolution)
    if not 0 < low < high:
        raise ValueError(f"bracket = {bracket}: give a lower and a higher reduction factor above 0")
    moved: dict[int, float] = {}
    points = sorted({round(p) for p in np.linspace(low, high, batch)})
    while points:
        factors = jnp.asarray([p * resolution for p in points], scene.particles.mass.dtype)
        varied, axes = reductions(scene, factors)
        result = solve(
            varied,
            repeat(state, len(points)),
            t_end=t_end,
            settle=settle or Settle(),
            stop_at=failure_displacement,
            axes=axes,
        ).raise_if_failed()
        moved |= dict(
            zip(
                points,
                np.asarray(jax.vmap(diagnostics.largest_displacement)(result.state)).tolist(),
                strict=True,
            )
        )
        stands = [p for p, u in moved.items() if u <= failure_displacement]
        fails = [p for p, u in moved.items() if u > failure_displacement]
        if not stands or not fails:
            side, end = ("fails", low) if not stands else ("stands", high)
            raise ValueError(f"the slope {side} even at R = {end * resolution:g}: widen the bracket {bracket}")
        low, high = max(p for p in stands if p < min(fails)), min(fails)
        inner = np.linspace(low, high, min(batch, high - low - 1) + 2)[1:-1]
        points = sorted({round(p) for p in inner} - set(moved))
    digits = max(0, -math.floor(math.log10(resolution)) + 2)
    tried = tuple((round(p * resolution, digits), moved[p]) for p in sorted(moved))
    return FactorOfSafety(round(low * resolution, digits), round(high * resolution, digits), tried)


def reductions(scene: Scene, factors: Array) -> tuple[Scene, Scene]:
    """The scene with a lane for every factor (B,) by which the strength is divided, and its axes for `solve`."""
    material = jax.vmap(lambda factor: reduce_strength(scene.material, factor))(factors)
    found = {name: getattr(material, name) for name in type(material).STRENGTH}
    return lanes(scene, **{name: value for name, value in found.items() if value is not None})


def reduced(scene: Scene, factor: float) -> Scene:
    """The scene with its strength divided by `factor`. ValueError for a law without strength, a factor not above 0."""
    check.positive("factor", factor)
    return replace(scene, material=reduce_strength(scene.material, jnp.asarray(factor, scene.particles.mass.dtype)))
