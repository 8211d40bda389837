"""Detection of accelerating slopes, and of the kink of displacement over the reduction factor."""

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
from jaxmpm.run._advance import advance_lanes
from jaxmpm.run._early import check_early, elastic_period
from jaxmpm.run._integrate import Result
from jaxmpm.run._stopping import Settle, Watch, farthest, steps_until
from jaxmpm.types import Scene, State, Status

LOOKS = 4
"""Looks in the period of the slowest elastic oscillation."""

AROUND = (-0.1, -0.06, -0.03, 0.03, 0.06, 0.09)
"""Factors at which to search the kink, over that at which the slope accelerates, minus 1."""

FOLLOWS = 1.5
"""Largest displacement of a lane on the branch that stands, over that of the branch."""

ROUNDS, CENTRED = 6, 0.03
"""Rounds of the search, and the largest distance of the kink from the middle of the lanes, over the factor."""


@dataclass(frozen=True)
class Times:
    """Characteristic times of a scene.

    Args:
        elastic: period of the slowest oscillation (s), four travels of the slowest shear wave through the soil's
            height.
        fall: time in which a mechanism accelerates (s), five times sqrt(height / g).
    """

    elastic: float
    fall: float

    @classmethod
    def of(cls, scene: Scene, t_end: float) -> Times:
        """Times of a scene with gravity; ValueError for a run of `t_end` seconds that is too short for them."""
        z = np.asarray(scene.particles.position[-1], float)
        height = float(z.max() - z.min())
        gravity = float(np.linalg.norm(np.asarray(scene.gravity, float)))
        if gravity == 0:
            raise ValueError("gravity = 0 m/s2: a limit load is one of gravity, give it")
        elastic = float(elastic_period(scene))
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
    """Displacements of lanes in time.

    Args:
        scene: with lanes.
        state: of B lanes.
        axes: leaves of the scene that have lanes first.
        t_end: duration (s).
        every: time between two values (s).
        settle: end a lane once it has settled.
        least_volume: use the displacement that this volume of soil has exceeded instead of the mean (m3, in a section
            m2).
        decide: function of the displacements so far that returns (B,) bool, which lanes need not go on.

    Returns:
        Mean displacement (looks, B) m, or the one that a least volume exceeds, and the largest one at the end (B,) m.

    Raises:
        FloatingPointError: If a lane breaks off.
        ValueError: If `settle` has a rule that needs a class.
    """
    check_early(None if settle is None else settle.early, scene, state, None)
    dt = float(scene.time_step)
    chunk = max(1, round(every / dt))
    state, watch = jax.tree.map(jnp.copy, state), Watch.start(np.shape(state.status))
    displacements: list[np.ndarray] = []
    for _ in range(max(1, steps_until(t_end, dt * chunk))):
        state = advance_lanes(scene, state, jnp.asarray(chunk), axes)
        now = _mean(scene, state, axes) if least_volume is None else farthest(scene, state, axes, least_volume)
        displacements.append(np.asarray(now))
        watch, ended = watch.look(scene, state, axes, chunk * dt, settle, None, least_volume)
        if decide is not None:
            ended = np.where((ended == Status.RUNNING) & decide(np.array(displacements)), int(Status.DECIDED), ended)
        state = replace(state, status=jnp.asarray(ended, jnp.int32))
        if not np.any(ended == Status.RUNNING):
            break
    Result(state, scene.time_step).raise_if_failed()
    return np.array(displacements), np.asarray(farthest(scene, state, axes, least_volume))


@partial(jax.jit, static_argnames="axes")
def _mean(scene: Scene, state: State, axes: Scene) -> Array:
    return jax.vmap(diagnostics.mean_displacement, in_axes=(axes, 0))(scene, state)


def speeds_up(displacements: np.ndarray, first: int) -> np.ndarray:
    """Whether the displacement of lanes grew more in some period than in all the time before, of the same length.

    A lane that stands, creeps at a constant speed or comes to rest has not; a body that slides off covers three times
    as much. Displacements count by their largest value so far, so elastic oscillation has no effect.

    Args:
        displacements: (looks, B) m.
        first: least number of looks in such a period.

    Returns:
        (B,) bool.
    """
    farthest = np.maximum.accumulate(displacements, axis=0)
    halves = np.arange(max(first, 1), len(farthest) // 2 + 1)
    return np.any(farthest[2 * halves - 1] > 2 * farthest[halves - 1], axis=0)


class Kink(NamedTuple):
    """Kink of displacement over factor.

    Args:
        at: factor of the kink.
        stands: largest factor of a lane that stands.
        moves: factor from which lanes move.
        sharpness: slope of the curve after the kink over that before it.
        jumps: whether displacement jumps there.
    """

    at: float
    stands: float
    moves: float
    sharpness: float
    jumps: bool


def kink(factors: np.ndarray, displacements: np.ndarray) -> Kink | None:
    """The kink of displacement over the factor.

    One branch is the line through the two lowest lanes, as far as lanes follow it. The other is the line through three
    lanes that move, without the first, which may lie in the bend. The lines meet at the kink, unless displacement jumps
    past their meeting.

    Args:
        factors: (B,), rising.
        displacements: (B,) m.

    Returns:
        Kink, None if all lanes lie on one branch.
    """
    flat = np.polyfit(factors[:2], displacements[:2], 1)
    standing = np.maximum(np.polyval(flat, factors), displacements[0])
    off = np.flatnonzero(displacements > FOLLOWS * standing)
    if len(off) < 3:
        return None
    first = int(off[0])
    beyond = slice(first + 1, first + 4)
    steep = np.polyfit(factors[beyond], displacements[beyond], 1)
    if steep[0] <= max(flat[0], 0):
        return None
    meeting = (flat[1] - steep[1]) / (steep[0] - flat[0])
    last = factors[first - 1]
    jumps = bool(meeting < last)
    rise = (displacements[first] - displacements[first - 1]) / (factors[first] - last)
    least = displacements[:2].mean() / factors[:2].mean()
    sharpness = float(max(steep[0], rise) / max(flat[0], least))
    at = max(meeting, last)
    moves = next((factor for factor in factors[first:] if factor >= at), factors[-1])
    return Kink(float(at), float(last), float(moves), sharpness, jumps)


def lanes_around(middle: float) -> np.ndarray:
    """Factors (B,) on both sides of one, rising."""
    return middle * (1 + np.array(AROUND))


def find_kink(displacement: Callable[[np.ndarray], np.ndarray], start: float) -> Kink:
    """Search the kink from a factor near which the slope begins to move.

    It warns if displacement falls between factors, which that of a slide does not.

    Args:
        displacement: function of factors (B,) that returns the displacements of lanes (B,) m.
        start: factor to start from.

    Returns:
        Kink.

    Raises:
        ValueError: If there is none.
    """
    known: dict[float, float] = {}
    middle = start
    for _ in range(ROUNDS):
        tried = lanes_around(middle)
        known |= zip(tried.tolist(), displacement(tried).tolist(), strict=True)
        factors = np.array(sorted(known))
        displacements = np.array([known[factor] for factor in factors.tolist()])
        turn, fall = kink(factors, displacements), falls(factors, displacements)
        if turn is not None and abs(turn.at / middle - 1) < CENTRED:
            if fall is not None:
                warnings.warn(f"the limit load at R = {turn.at:.3g} is in doubt: {fall}", stacklevel=2)
            return turn
        middle = factors[0] if turn is None else turn.at
    text = f"{displacements[0]:.2g} to {displacements[-1]:.2g} m at R = {factors[0]:.3g} to {factors[-1]:.3g}"
    raise ValueError(
        f"the displacement has no kink, {text}: {fall or 'it grows too evenly for a limit load'}; or give a "
        "failure_displacement instead"
    )


def falls(factors: np.ndarray, displacements: np.ndarray) -> str | None:
    """Warning about displacements (B,) m that fall over rising factors (B,); None if they grow."""
    drops = displacements[:-1] / np.maximum(displacements[1:], np.finfo(float).tiny)
    worst = int(np.argmax(drops))
    if not drops[worst] > FOLLOWS:
        return None
    (more, less), (at, then) = displacements[worst : worst + 2], factors[worst : worst + 2]
    return (
        f"it moves {more:.2g} m at R = {at:.3g} and {less:.2g} m at R = {then:.3g}, as grains do that shake loose "
        "and settle by chance: give a share of PIC (flip = 0.95), or soil with much friction some dilation"
    )
