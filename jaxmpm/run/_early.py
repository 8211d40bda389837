"""Rule by which the class of a lane is known before it rests or has run far."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.run._stopping import Reading, Rule, check_volume
from jaxmpm.support import check
from jaxmpm.types import Scene, State, Status

START = np.array([0.0, 0.0, np.nan, 0.0, np.inf, 0.0, np.nan, 0.0])
"""Memory of the rule at the start of a run without plastic strain, see `Early.judged`."""


@dataclass(frozen=True)
class Early(Rule):
    """Rule by which the rate of plastic strain decides the class of a lane of softening soil, before or beyond a limit.

    A block on a band that softens linearly moves at v = A exp(l t) + B exp(-l t), where l^2 is the loss of resistance
    per displacement over its mass. It stands if A <= 0, and v then falls faster than exp(-l t). If v grows, A > 0: the
    block speeds up while its soil softens, and does not slow down when that has ended. The mean plastic shear strain of
    the soil stands for the displacement of the block, since elastic oscillation never reduces it.

    Rates are those over windows of one look, or of as many as half of the slowest elastic oscillation takes. A lane
    fails once the rate of plastic strain exceeds `growth` times the least one so far. It stands once that rate is at
    most `decay` of the one in the window before: -l is less steep than ln(decay) per window. The largest displacement
    must not grow faster than that either, so that a part of a wide slope counts as well, or than `decay` squared of
    its fastest growth, below which it oscillates.

    Args:
        horizon: time (s) by which a lane that speeds up has to pass the displacement that decides its class. Its
            displacement by then, at its mean speed so far, has to exceed that too before it is decided.
        displacement: that decides the class (m); beyond it a lane is DECIDED at once, as by `Exceeds`.
        decay: rate of a lane that stands over that of the window before. A lane whose rate is below this share of its
            largest one is not decided.
        growth: rate of a lane that fails over the least one so far.
        least_volume: as for `Exceeds`.

    Raises:
        ValueError: If the horizon or the displacement is not above 0, the decay not between 0 and 1, or the growth not
            above 1.
    """

    horizon: float
    displacement: float
    decay: float = 0.2
    growth: float = 1.5
    least_volume: float | None = None

    def __post_init__(self) -> None:
        check.positive("early's horizon", self.horizon, "s")
        check.positive("early's displacement", self.displacement, "m")
        check.between("early's decay", self.decay, 0.0, 1.0)
        check.positive("early's growth - 1", self.growth - 1)
        check_volume(self.least_volume)

    def start(self) -> np.ndarray:
        """Memory of a run without plastic strain, see `judged`."""
        return START

    def check(self, scene: Scene, state: State) -> None:
        """Raise ValueError if the base moves, the soil does not soften, or it has strained plastically."""
        if scene.loads.motion is not None:
            raise ValueError(
                "the rule Early holds where no motion of the base stops a slide or starts one: leave it out"
            )
        if getattr(state.history, "shape", None) != np.shape(state.volume_ratio):
            raise ValueError(
                f"the rule Early needs plastic strain, and {type(scene.material).__name__} has none since it does not "
                "soften: leave it out"
            )
        if np.any(np.asarray(state.history) > 0):
            raise ValueError(
                "the rule Early counts plastic strain from 0, and the state has some: start at rest, or leave it out"
            )

    def measure(self, scene: Scene, state: State) -> tuple[Array, Array, Array]:
        """Mean plastic strain, half the period of the slowest oscillation (s), and displacement (m)."""
        return *measures(scene, state), diagnostics.exceeded_displacement(scene, state, self.least_volume)

    def judge(self, memory: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """SETTLED where a lane stands, DECIDED where it fails or has failed."""
        strain, half_period, displacement = reading.measured
        memory, stands, speeds_up = self.judged(memory, reading.elapsed, half_period, strain, displacement)
        bound_to = speeds_up & (self.projected(displacement, reading.time) > self.displacement)
        ends = [displacement > self.displacement, stands, bound_to]
        return memory, np.select(ends, [Status.DECIDED, Status.SETTLED, Status.DECIDED], Status.RUNNING)

    def foreseen(self, displacement: float, time: float) -> float:
        """The displacement (m) at the horizon of a lane that goes on at its mean speed so far."""
        return float(self.projected(np.asarray(displacement, float), np.asarray(time)))

    def projected(self, displacement: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Displacement (m) at the horizon of lanes that go on at their mean speed so far.

        Args:
            displacement: so far (m).
            time: so far (s), above 0.
        """
        return np.asarray(displacement * np.maximum(self.horizon / np.maximum(time, 1e-30), 1.0))

    def judged(
        self,
        memory: np.ndarray,
        elapsed: float | np.ndarray,
        half_period: np.ndarray,
        strain: np.ndarray,
        displacement: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply the rule after some time, to one lane or to B.

        Args:
            memory: (8,) or (8, B): seconds since the window began; plastic strain then; rate of plastic strain in the
                window before (1/s); the largest and the least rate of any window; displacement when the window began
                (m); its growth in the window before, and its fastest in any window (m/s).
            elapsed: time since the last look (s).
            half_period: shortest duration of a window (s).
            strain: mean plastic shear strain.
            displacement: largest displacement (m).

        Returns:
            The memory afterwards, whether the lane stands, and whether it speeds up.
        """
        since, began, before, largest, least, displacement_before, speed_before, fastest = memory
        since = since + elapsed
        ends = since >= half_period * (1 - 1e-6)
        rate, speed = (strain - began) / since, (displacement - displacement_before) / since
        largest_now, fastest_now = np.maximum(largest, rate), np.maximum(fastest, speed)
        still = (speed <= self.decay * speed_before) | (speed <= self.decay**2 * fastest_now)
        stands = ends & (rate <= self.decay * before) & still
        speeds_up = ends & (rate >= self.growth * least) & (rate >= self.decay * largest_now)
        least_now = np.where(rate > 0, np.minimum(least, rate), least)
        new = np.zeros_like(rate), strain, rate, largest_now, least_now, displacement, speed, fastest_now
        same = since, began, before, largest, least, displacement_before, speed_before, fastest
        return np.stack([np.where(ends, *pair) for pair in zip(new, same, strict=True)]), stands, speeds_up


def measures(scene: Scene, state: State) -> tuple[Array, Array]:
    """Mean plastic shear strain by initial volume, and half the period (s) of the slowest elastic oscillation.

    Args:
        scene: of one lane, of softening soil.
        state: of one lane.
    """
    volume = scene.particles.volume
    return jnp.sum(volume * state.history) / jnp.sum(volume), elastic_period(scene) / 2


def elastic_period(scene: Scene) -> Array:
    """Period of the slowest oscillation, four travels of the slowest shear wave through the soil's height.

    Args:
        scene: with a material that has `shear`.

    Returns:
        () s.
    """
    particles, height = scene.particles, scene.particles.position[-1]
    slowest = jnp.sqrt(jnp.min(scene.material.shear * particles.volume / particles.mass))
    return 4 * (jnp.max(height) - jnp.min(height)) / slowest
