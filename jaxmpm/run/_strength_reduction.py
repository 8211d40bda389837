"""Factor of safety by strength reduction: bisection in rounds, each round one batch."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.laws import drained, reduce_strength
from jaxmpm.run._advance import repeat
from jaxmpm.run._integrate import solve
from jaxmpm.run._lanes import varied_lanes
from jaxmpm.run._limit_load import (
    YOUNG,
    Scale,
    find_kink,
    find_start,
    limit_load_scene,
    lowest_local,
    moved,
    stands_to,
)
from jaxmpm.run._stopping import Exceeds, Rule, Settle, check_duration, check_volume, farthest
from jaxmpm.setup import WALL_STRENGTH, check_scene
from jaxmpm.support import check
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value
from jaxmpm.types import Boundary, Scene, State


@by_value
@dataclass(frozen=True)
class FactorOfSafety:
    """Result of strength reduction.

    By the limit load, `stable` and `fails` are the runs on both sides of the kink, and displacements are those of soil
    that has the stiffness at which the limit load is sought. The last four are None by a displacement.

    Args:
        stable: largest reduction factor R that stands.
        fails: smallest R that fails, one resolution above.
        tried: every (R, largest displacement in m) that was run, by R; where the slope failed, the displacement is the
            one at which that was decided. By the limit load it is the displacement that the least volume has exceeded.
        kink: R at which displacement begins to grow.
        sharpness: its growth beyond the kink over that below.
        volume: of the soil that moves just beyond the kink, by more than half of what the least volume does (m3, in a
            section m2).
        local: the smallest R tried at which a slip moves that is smaller than the least volume, but a tenth of it or
            more, and the volume of that slip; also None where there is none.
    """

    stable: float
    fails: float
    tried: tuple[tuple[float, float], ...]
    kink: float | None = None
    sharpness: float | None = None
    volume: float | None = None
    local: tuple[float, float] | None = None


LIMIT_LOAD: Literal["limit load"] = "limit load"


def factor_of_safety(
    scene: Scene,
    state: State,
    *,
    failure_displacement: float | None = None,
    criterion: Literal["limit load"] | None = None,
    bracket: tuple[float, float] = (0.5, 3.0),
    resolution: float = 0.01,
    t_end: float = 20.0,
    batch: int = 8,
    settle: Rule | None = None,
    least_volume: float | None = None,
    progress: Callable[[Sequence[float], Sequence[float]], None] | None = None,
) -> FactorOfSafety:
    """Divide the strength by R and bisect the R at which the slope fails within t_end.

    With the criterion "limit load" the slope fails at the kink, where displacement begins to grow with R. If no soil
    softens, all soil then has the stiffness of `limit_load_scene`, so that the answer does not depend on Young's
    modulus. Without softening the answer of a displacement criterion depends on `failure_displacement`, since a
    perfectly plastic slope slides a little and stands again. Soil with a B-value is drained, as it is until it fails.

    Args:
        scene: to run.
        state: at the start.
        failure_displacement: the slope fails if its largest displacement exceeds this (m), by default 1 m.
        criterion: "limit load" in place of `failure_displacement`.
        bracket: R that stands and R that fails.
        resolution: R is a multiple of it; by the limit load, distance of the runs beside the kink from it.
        t_end: duration (s); by the limit load, the longest one, of which three times sqrt(height / g) are used,
            twice that where soil softens.
        batch: lanes per round.
        settle: rule by which a lane stands before t_end; None for the default of `Settle` with `least_volume`. A limit
            load takes none.
        least_volume: use the displacement that this volume (m3, in a section m2) has exceeded, instead of the largest.
            By the limit load None is 0.05 h^2, in 3D 0.05 h^3, h the relief of the ground.
        progress: called after each round of runs with its factors and their displacements (m).

    Returns:
        Bracket, trials and kink.

    Raises:
        ValueError: If the bracket's ends do not stand and fail, or an argument is invalid.
        FloatingPointError: If a run breaks off.
    """
    if criterion not in (None, LIMIT_LOAD):
        raise ValueError(f"criterion = {shown(criterion)}: give {LIMIT_LOAD!r}, or a failure_displacement instead")
    if criterion is not None and failure_displacement is not None:
        raise ValueError(f"both criterion and failure_displacement = {failure_displacement} m are given: leave one out")
    limit = 1.0 if failure_displacement is None else failure_displacement
    check.positive("failure_displacement", limit, "m")
    check.positive("resolution", resolution)
    check.positive("bracket", bracket)
    check.whole("batch", batch, least=2)
    if isinstance(settle, type) or (settle is not None and not isinstance(settle, Rule)):
        raise ValueError(f"settle = {shown(settle)}: give Settle(...) or another rule, or None")
    check_duration(t_end)
    check_volume(least_volume)
    check_scene(scene)
    if scene.free_field is not None:
        raise ValueError(
            "a factor of safety with ends = 'free field', whose ground would keep its strength: build the section with "
            "walls, or shake `reduced(scene, R)`"
        )
    low, high = math.floor(bracket[0] / resolution + 1e-9), math.ceil(bracket[1] / resolution - 1e-9)
    if not bracket[0] < bracket[1]:
        raise ValueError(f"bracket = {bracket}: give a lower and a higher reduction factor above 0")
    if low < 1:
        raise ValueError(f"resolution = {resolution:g} exceeds the lower end of bracket = {bracket}: give a finer one")
    if criterion == LIMIT_LOAD:
        if settle is not None:
            raise ValueError("settle is given by the limit load, whose runs all have one duration: leave it out")
        return by_limit_load(
            scene, state, bracket=bracket, resolution=resolution, t_end=t_end, batch=batch, least_volume=least_volume,
            progress=progress,
        )  # fmt: skip
    scene = replace(scene, material=drained(scene.material))
    settle, exceeds = settle or Settle(least_volume=least_volume), Exceeds(limit, least_volume)
    outcomes: dict[int, tuple[float, bool]] = {}
    points = sorted({round(p) for p in np.linspace(low, high, batch)})
    while points:
        factors = [p * resolution for p in points]
        judged = _by_displacement(exceeds, scene, state, factors, t_end, settle)
        outcomes |= zip(points, judged, strict=True)
        if progress is not None:
            progress(factors, [displacement for displacement, _ in judged])
        stands = [p for p, (_, failed) in outcomes.items() if not failed]
        fails = [p for p, (_, failed) in outcomes.items() if failed]
        if not stands or not fails:
            side, end = ("fails", low) if not stands else ("stands", high)
            raise ValueError(f"the slope {side} even at R = {end * resolution:g}: widen the bracket {bracket}")
        if min(stands) > min(fails):
            raise ValueError(
                f"the slope fails at R = {min(fails) * resolution:g} and stands at {min(stands) * resolution:g}: its "
                "displacement does not grow with R; give another failure_displacement or a narrower bracket"
            )
        low, high = max(p for p in stands if p < min(fails)), min(fails)
        inner = np.linspace(low, high, min(batch, high - low - 1) + 2)[1:-1]
        points = sorted({round(p) for p in inner} - set(outcomes))
    digits = max(0, -math.floor(math.log10(resolution)) + 2)
    return FactorOfSafety(
        stable=round(low * resolution, digits),
        fails=round(high * resolution, digits),
        tried=tuple((round(p * resolution, digits), outcomes[p][0]) for p in sorted(outcomes)),
    )


def _by_displacement(
    exceeds: Exceeds, scene: Scene, state: State, factors: list[float], t_end: float, settle: Rule
) -> list[tuple[float, bool]]:
    """Largest displacement (m) at each factor, and whether the slope exceeds the limit."""
    varied, axes = reductions(scene, jnp.asarray(factors, scene.particles.mass.dtype))
    lanes = repeat(state, len(factors))
    result = solve(varied, lanes, t_end=t_end, rules=[settle, exceeds], axes=axes).raise_if_failed()
    moved = np.asarray(farthest(varied, result.state, axes, exceeds.least_volume))
    return [(u, u > exceeds.displacement) for u in moved.tolist()]


def by_limit_load(
    scene: Scene,
    state: State,
    *,
    bracket: tuple[float, float],
    resolution: float,
    t_end: float,
    batch: int,
    least_volume: float | None = None,
    progress: Callable[[Sequence[float], Sequence[float]], None] | None = None,
    young: float = YOUNG,
) -> FactorOfSafety:
    """The factor by the limit load, as `factor_of_safety`, with soil of a stiffness as of `limit_load_scene`."""
    stiff = limit_load_scene(scene, young)
    scale = Scale.of(stiff, t_end, least_volume)
    tried: dict[float, tuple[float, float]] = {}

    def displacement(factors: np.ndarray) -> np.ndarray:
        varied, axes = reductions(stiff, jnp.asarray(factors, scene.particles.mass.dtype))
        lanes = moved(varied, repeat(state, len(factors)), axes, scale)
        pairs = zip(lanes.displacement.tolist(), lanes.volume.tolist(), strict=True)
        tried.update(zip(factors.tolist(), pairs, strict=True))
        if progress is not None:
            progress(factors.tolist(), lanes.displacement.tolist())
        return np.where(lanes.slid, np.inf, lanes.displacement)

    start = find_start(displacement, scale.moves, bracket, batch)
    turn = find_kink(displacement, start, resolution, scale.moves)
    most, numerics = stands_to(scene), scene.numerics
    if turn.stands > most:
        raise ValueError(
            f"the limit load at R = {turn.at:.3g} is that of a slip as thick as cells of {scene.grid.cell:g} m, but "
            f"soil without cohesion stands on its face up to R = {most:.3g} at most: take finer cells"
        )
    if most < math.inf and numerics.flip is None and numerics.pic_damping is None:
        warnings.warn(
            f"the limit load at R = {turn.at:.3g} is in doubt: with pure FLIP soil without cohesion rings, and may "
            "shake loose below it: compare with flip = 0.95",
            stacklevel=3,
        )
    rows = [(factor, *tried[factor]) for factor in sorted(tried)]
    return FactorOfSafety(
        stable=round(turn.stands, 4),
        fails=round(turn.moves, 4),
        tried=tuple((factor, metres) for factor, metres, _ in rows),
        kink=round(turn.at, 4),
        sharpness=round(turn.sharpness, 1),
        volume=next((slid for factor, metres, slid in rows if factor > turn.at and metres > scale.moves), None),
        local=lowest_local(rows, turn.stands, scale.volume),
    )


def reductions(scene: Scene, factors: Array) -> tuple[Scene, Scene]:
    """The scene with a lane for every reduction factor, and its axes for `solve`.

    The factor divides the strength, also of walls with friction.

    Args:
        scene: of one lane.
        factors: (B,) above 0.

    Returns:
        Scene and axes, as of `lanes`.
    """
    varied, axes = varied_lanes(scene, partial(reduce_strength, scene.material), factors)
    walls = jax.vmap(partial(_reduced_walls, scene.boundary))(factors)
    lanes_first: dict[str, Any] = dict.fromkeys(walls, 0)
    varied = replace(varied, boundary=replace(varied.boundary, **walls))
    return varied, replace(axes, boundary=replace(axes.boundary, **lanes_first))


def _reduced_walls(boundary: Boundary, factor: Array) -> dict[str, Any]:
    """Friction and cohesion of the walls, if any, divided by a factor."""
    strength = {name: getattr(boundary, name) for name in WALL_STRENGTH.values()}
    return {name: value / factor for name, value in strength.items() if value is not None}


def reduced(scene: Scene, factor: float) -> Scene:
    """The scene with its strength divided by a factor, also of walls with friction and of a free field.

    Args:
        scene: with a law that has strength.
        factor: above 0.

    Returns:
        Scene.

    Raises:
        ValueError: If the law has no strength, or the factor is not above 0.

    Example:
        >>> import jaxmpm as mpm
        >>> soil, grid = mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,))
        >>> scene, _ = mpm.column(4.0, soil, grid)
        >>> float(mpm.reduced(scene, 1.5).material.strength)
        6000.0
    """
    check.positive("factor", factor)
    by = jnp.asarray(factor, scene.particles.mass.dtype)
    field = scene.free_field
    if field is not None:
        field = replace(field, low=reduced(field.low, factor), high=reduced(field.high, factor))
    weaker = reduce_strength(scene.material, by)
    boundary = replace(scene.boundary, **_reduced_walls(scene.boundary, by))
    return replace(scene, material=weaker, boundary=boundary, free_field=field)
