"""When a slope moves on, told from its displacement in time, and the kink that this has over the reduction factor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.run._integrate import Result, Settle, Watch, advance_lanes, steps_until
from jaxmpm.types import Scene, State, Status

LOOKS = 4
"""Looks in the time in which soil answers elastically."""

AROUND = (-0.1, -0.06, -0.03, 0.03, 0.06, 0.09)
"""Where the kink is looked for: factors over that at which the slope moves on, less 1."""

FOLLOWS = 2.0
"""Displacement, over that of the branch that stands, up to which a lane still follows it."""


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
    decide: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean displacement (looks, B) m of each lane every `every` seconds, and at the end the largest one (B,) m.

    settle: end a lane once it is quiet. decide: tells from the mean displacements so far which lanes need not go on.
    Raises FloatingPointError where a lane breaks off.
    """
    dt = float(scene.time_step)
    chunk = max(1, round(every / dt))
    state, watch = jax.tree.map(jnp.copy, state), Watch.start(np.shape(state.status))
    moved: list[np.ndarray] = []
    for _ in range(max(1, steps_until(t_end, dt * chunk))):
        state = advance_lanes(scene, state, jnp.asarray(chunk), axes)
        moved.append(np.asarray(_mean(scene, state, axes)))
        watch, ended = watch.look(scene, state, axes, chunk * dt, settle, None)
        if decide is not None:
            ended = np.where((ended == Status.RUNNING) & decide(np.array(moved)), int(Status.DECIDED), ended)
        state = replace(state, status=jnp.asarray(ended, jnp.int32))
        if not np.any(ended == Status.RUNNING):
            break
    Result(state, scene.time_step).raise_if_failed()
    return np.array(moved), np.asarray(jax.vmap(diagnostics.largest_displacement)(state))


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


def kink(factors: np.ndarray, moved: np.ndarray) -> tuple[float, float]:
    """Where displacement over factor turns, and how many times steeper it is after it: of lanes (B,) of which the lower
    half stands, the upper moves on, by `moved` (B,) m.

    Both branches are lines, that of the lanes that stand without the last, which already yields. The kink is where they
    meet; where displacement jumps after that, it is the last lane that still follows the lower branch.
    """
    half = len(factors) // 2
    trusted = slice(0, half - 1)
    flat, steep = (np.polyfit(factors[part], moved[part], 1) for part in (trusted, slice(half, None)))
    meeting = (flat[1] - steep[1]) / (steep[0] - flat[0])
    standing = np.maximum(np.polyval(flat, factors[:half]), moved[0])
    following = factors[:half][moved[:half] <= FOLLOWS * standing]
    jump = (moved[half] - moved[half - 1]) / (factors[half] - factors[half - 1])
    least = moved[trusted].mean() / factors[trusted].mean()
    return max(float(meeting), float(following[-1])), float(max(steep[0], jump) / max(flat[0], least))


def lanes_around(middle: float) -> np.ndarray:
    """Factors (B,) on both sides of one, rising."""
    return middle * (1 + np.array(AROUND))
