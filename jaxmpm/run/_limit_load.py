"""When a slope moves on, told from its displacement in time, and the kink that this has over the reduction factor."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.run._integrate import Result, Settle, Watch, advance_lanes, farthest, steps_until
from jaxmpm.types import Scene, State, Status

LOOKS = 4
"""Looks in the time in which soil answers elastically."""

AROUND = (-0.1, -0.06, -0.03, 0.03, 0.06, 0.09)
"""Where the kink is looked for: factors over that at which the slope moves on, less 1."""

FOLLOWS = 1.5
"""Displacement, over that of the branch that stands, up to which a lane still follows it."""

ROUNDS, FOUND = 6, 0.03
"""Rounds in which the kink is looked for, and how close to the middle of its lanes it must be, over the factor."""


@dataclass(frozen=True)
class Times:
    """Times (s) of a scene: `elastic`, that of its slowest oscillation, and `fall`, in which its mechanism gets going.

    elastic: four travels of the slowest shear wave through the height of the soil. fall: five times sqrt(height / g).
    """

    elastic: float
    fall: float

    @classmethod
    def of(cls, scene: Scene, t_end: float) -> Times:
        """Those of a scene with gravity. Raises ValueError for a run of `t_end` seconds too short to tell by."""
        z = np.asarray(scene.particles.position[-1], float)
        height = float(z.max() - z.min())
        density = np.asarray(scene.particles.mass, float) / np.asarray(scene.particles.volume, float)
        slowest = math.sqrt(float(np.min(np.asarray(scene.material.shear, float) / density)))
        gravity = float(np.linalg.norm(np.asarray(scene.gravity, float)))
        if gravity == 0:
            raise ValueError("gravity = 0 m/s2: a limit load is one of gravity, give it")
        elastic = 4 * height / slowest
        if t_end < 4 * elastic:
            raise ValueError(
                f"t_end = {t_end:g} s, but soil this soft takes {elastic:.2g} s for an elastic oscillation: give "
                f"{4 * elastic:.2g} s or more to see it speed up"
            )
        return cls(elastic, 5 * math.sqrt(height / gravity))


def displacements(
    scene: Scene,
    state: State,
    axes: Scene,
    *,
    t_end: float,
    every: float,
    settle: Settle | None = None,
    least_volume: float | None = None,
    decide: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean displacement (looks, B) m of each lane every `every` seconds, or that which a least volume exceeds, and at
    the end the largest one (B,) m.

    settle: end a lane once it is quiet. decide: tells from the displacements so far which lanes need not go on.
    Raises FloatingPointError where a lane breaks off.
    """
    dt = float(scene.time_step)
    chunk = max(1, round(every / dt))
    state, watch = jax.tree.map(jnp.copy, state), Watch.start(np.shape(state.status))
    moved: list[np.ndarray] = []
    for _ in range(max(1, steps_until(t_end, dt * chunk))):
        state = advance_lanes(scene, state, jnp.asarray(chunk), axes)
        now = _mean(scene, state, axes) if least_volume is None else farthest(scene, state, axes, least_volume)
        moved.append(np.asarray(now))
        watch, ended = watch.look(scene, state, axes, chunk * dt, settle, None, least_volume)
        if decide is not None:
            ended = np.where((ended == Status.RUNNING) & decide(np.array(moved)), int(Status.DECIDED), ended)
        state = replace(state, status=jnp.asarray(ended, jnp.int32))
        if not np.any(ended == Status.RUNNING):
            break
    Result(state, scene.time_step).raise_if_failed()
    return np.array(moved), np.asarray(farthest(scene, state, axes, least_volume))


@partial(jax.jit, static_argnames="axes")
def _mean(scene: Scene, state: State, axes: Scene) -> Array:
    return jax.vmap(diagnostics.mean_displacement, in_axes=(axes, 0))(scene, state)


def speeds_up(moved: np.ndarray, first: int) -> np.ndarray:
    """Whether lanes have moved farther in some time than in all the time before, as long: (B,) of (looks, B) m.

    first: least number of looks in such a time. What stands, creeps at a constant speed or comes to rest does not; a
    body that slides off covers three times as much. Displacements count by their largest value so far, so that elastic
    ringing is none.
    """
    farthest = np.maximum.accumulate(moved, axis=0)
    halves = np.arange(max(first, 1), len(farthest) // 2 + 1)
    return np.any(farthest[2 * halves - 1] > 2 * farthest[halves - 1], axis=0)


class Kink(NamedTuple):
    """Where displacement over factor turns: at a factor `at`, between lanes that stand up to `stands` and move from
    `moves` on, `sharpness` times as steep after it as before. jumps: whether displacement jumps there."""

    at: float
    stands: float
    moves: float
    sharpness: float
    jumps: bool


def kink(factors: np.ndarray, moved: np.ndarray) -> Kink | None:
    """The kink of displacement `moved` (B,) m over rising factors (B,); None where all lanes lie on one branch.

    The branch of lanes that stand is the line through the two lowest, as far as lanes follow it; that of lanes that
    move is the line through three more, without the first, which may still be turning. They meet at the kink, or
    displacement jumps past the meeting.
    """
    flat = np.polyfit(factors[:2], moved[:2], 1)
    standing = np.maximum(np.polyval(flat, factors), moved[0])
    off = np.flatnonzero(moved > FOLLOWS * standing)
    if len(off) < 3:
        return None
    first = int(off[0])
    beyond = slice(first + 1, first + 4)
    steep = np.polyfit(factors[beyond], moved[beyond], 1)
    if steep[0] <= max(flat[0], 0):
        return None
    meeting = (flat[1] - steep[1]) / (steep[0] - flat[0])
    last = factors[first - 1]
    jumps = bool(meeting < last)
    rise = (moved[first] - moved[first - 1]) / (factors[first] - last)
    least = moved[:2].mean() / factors[:2].mean()
    sharpness = float(max(steep[0], rise) / max(flat[0], least))
    at = max(meeting, last)
    moves = next((factor for factor in factors[first:] if factor >= at), factors[-1])
    return Kink(float(at), float(last), float(moves), sharpness, jumps)


def lanes_around(middle: float) -> np.ndarray:
    """Factors (B,) on both sides of one, rising."""
    return middle * (1 + np.array(AROUND))


def find_kink(displacement: Callable[[np.ndarray], np.ndarray], start: float) -> Kink:
    """The kink, looked for from a factor at which the slope is thought to begin to move.

    displacement: of lanes (B,) m at factors (B,). Raises ValueError where none is found, and warns where displacement
    falls between factors, as that of a slope that slides does not.
    """
    known: dict[float, float] = {}
    middle = start
    for _ in range(ROUNDS):
        asked = lanes_around(middle)
        known |= zip(asked.tolist(), displacement(asked).tolist(), strict=True)
        factors = np.array(sorted(known))
        moved = np.array([known[factor] for factor in factors.tolist()])
        found, fall = kink(factors, moved), falls(factors, moved)
        if found is not None and abs(found.at / middle - 1) < FOUND:
            if fall is not None:
                warnings.warn(f"the limit load at R = {found.at:.3g} is in doubt: {fall}", stacklevel=2)
            return found
        middle = factors[0] if found is None else found.at
    seen = f"{moved[0]:.2g} to {moved[-1]:.2g} m at R = {factors[0]:.3g} to {factors[-1]:.3g}"
    raise ValueError(
        f"the displacement has no kink, {seen}: {fall or 'it grows too evenly for a limit load'}; or give a "
        "failure_displacement instead"
    )


def falls(factors: np.ndarray, moved: np.ndarray) -> str | None:
    """What to say of displacements (B,) m over rising factors (B,) that fall; None where they grow."""
    drops = moved[:-1] / np.maximum(moved[1:], np.finfo(float).tiny)
    worst = int(np.argmax(drops))
    if not drops[worst] > FOLLOWS:
        return None
    (more, less), (at, then) = moved[worst : worst + 2], factors[worst : worst + 2]
    return (
        f"it moves {more:.2g} m at R = {at:.3g} and {less:.2g} m at R = {then:.3g}, as grains do that shake loose "
        "and settle by chance: give a share of PIC (flip = 0.95), or soil with much friction some dilation"
    )
