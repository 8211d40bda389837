"""The limit load: stiffness at which it is sought, displacement of lanes, and its kink over the reduction factor."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.laws import Saturated, declared, drained, laws_of, stiffened, weakens_until
from jaxmpm.protocols import Material
from jaxmpm.run._early import elastic_period
from jaxmpm.run._integrate import solve
from jaxmpm.run._stopping import Exceeds, farthest
from jaxmpm.setup import wave_speed
from jaxmpm.soil import moduli
from jaxmpm.types import Scene, State, Status

YOUNG, POISSON = 1000.0, 0.3
"""Stiffness at which a limit load is sought: Young's modulus over the weight of soil as high as the ground; Poisson's
ratio."""

SHARE = 0.05
"""Least volume that counts as a failure where none is given, over the height of the slope to the power of the
dimensions."""

FALL, SOFTENING_FALL, SEEN = 3.0, 6.0, 2.0
"""Time that a mechanism is given to move, where it has to soften first, and the least one that shows it, over
sqrt(height / g)."""

MOVES, MOST = 10.0, 0.05
"""Displacement from which the search takes soil to move: elastic ones, weight times height squared over Young's
modulus; and its largest share of the height."""

FAR = 0.5
"""Displacement at which a run ends, over the height of the ground."""

COARSE = 1.1
"""Ratio of the factors between which the search of the kink begins."""

AROUND = (-0.1, -0.06, -0.03, 0.03, 0.06, 0.09)
"""Factors at which to search the kink, over that at which the slope begins to move, minus 1."""

FOLLOWS = 1.5
"""Ratio of slopes up to which displacement grows evenly, and of displacements up to which it does not fall."""

SURE = 10.0
"""Sharpness from which a kink is one although no lane has moved so far that it moves for certain."""

ROUNDS, CENTRED = 8, 0.02
"""Rounds of the search, and the largest distance of the kink from the middle of the lanes, over the factor."""

LOCAL = 0.1
"""Share of the least volume from which a slip that is smaller is reported."""


def limit_load_scene(scene: Scene, young: float = YOUNG) -> Scene:
    """The scene with the stiffness at which its limit load is sought.

    The limit load of soil that does not soften is one of strength: it depends neither on the moduli nor on the initial
    stress, while displacement below it is inversely proportional to the modulus. So all soil gets the same modulus, in
    proportion to weight and height, and displacement below the limit is as small a share of the height in every scene.
    The time step follows, and the share of PIC, as much in a second as before. Soil or an interface that softens does
    so by displacements; such a scene keeps its stiffness. Soil with a B-value is drained, as it is until it fails.

    Args:
        scene: at rest.
        young: Young's modulus over the weight of the ground's height.

    Returns:
        Scene.

    Raises:
        ValueError: If there is no gravity, or soil loses strength over time.
    """
    _gravity(scene)
    if weakens_until(scene.material) is not None:
        raise ValueError(
            "loss_time takes strength away while a slope is looked at, which has no limit load: give the soil the "
            "strength that it is left with, or a failure displacement"
        )
    sealed, scene = scene.material, replace(scene, material=drained(scene.material))
    if _softens(scene) or not {"bulk", "shear"} <= declared(scene.material).keys():
        return scene
    dtype, height = scene.particles.mass.dtype, heights(scene)[0]
    stress = _weight(scene) * height
    numbers = (jnp.asarray(number, dtype) for number in (*moduli(young * stress, POISSON), stress))
    material = stiffened(scene.material, *numbers)
    # Time steps allow for the sum of the wave speed and that of a fall through half the height.
    fall = math.sqrt(_gravity(scene) * height)
    before, after = (fall + wave_speed(scene.particles, law) for law in (sealed, material))
    share = before / after
    numerics = scene.numerics
    flip = None if numerics.flip is None else numerics.flip**share
    return replace(
        scene, material=material, numerics=replace(numerics, time_step=numerics.time_step * share, flip=flip)
    )


def least_failing_volume(height: float, dimension: int) -> float:
    """Least volume of soil whose slip is a failure, where none is given.

    Args:
        height: of the slope (m).
        dimension: of the scene.

    Returns:
        m3, in a section m2.
    """
    return SHARE * height**dimension


def _softens(scene: Scene) -> bool:
    """Whether soil or an interface softens, or has a memory and no method `stiffened`."""
    soil = any(
        law.initial_history(scene.particles) is not None and not hasattr(law, "stiffened") for law in _skeletons(scene)
    )
    return soil or scene.boundary.softening is not None


def _skeletons(scene: Scene) -> list[Material]:
    """The laws of all zones, of soil with a B-value that of its skeleton."""
    return [law.law if isinstance(law, Saturated) else law for law in laws_of(scene.material)]


def heights(scene: Scene) -> tuple[float, float]:
    """Height of the ground above its lowest soil, and the relief of its surface, or else that height (m)."""
    z, cell = np.asarray(scene.particles.position[-1], float), scene.grid.cell
    height, relief = float(np.ptp(z)) + _edge(scene), float(np.ptp(_tops(scene, cell)[1]))
    return height, relief if relief > cell else height


def _edge(scene: Scene) -> float:
    """Edge of a cube, in a section a square, as large as the mean particle (m)."""
    return float(np.mean(np.asarray(scene.particles.volume, float))) ** (1 / scene.grid.dimension)


def _tops(scene: Scene, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of soil of a width (m): their places (d - 1, K), in widths, and their highest particles (K,) m."""
    position = np.asarray(scene.particles.position, float)
    columns, owner = np.unique(np.floor(position[:-1] / width).astype(int), axis=1, return_inverse=True)
    top = np.full(columns.shape[1], -np.inf)
    np.maximum.at(top, owner.ravel(), position[-1])
    return columns, top


def stands_to(scene: Scene) -> float:
    """Factor at which soil stands no more on a plane through its surface, inf where some of it has cohesion.

    The plane falls by half of the relief or more, less one particle. Beyond the factor what lies on it slides whatever
    the stress along it is (Taylor 1948, Fundamentals of Soil Mechanics, Section 16.9). Water lowers the factor further.

    Args:
        scene: at the start.

    Returns:
        Factor.
    """
    slope = _steepest(scene)
    factors = [law.stands_to(slope) if hasattr(law, "stands_to") and slope else None for law in _skeletons(scene)]
    finite = [float(np.max(factor)) for factor in factors if factor is not None]
    return max(finite) if len(finite) == len(factors) else math.inf


def _steepest(scene: Scene) -> float:
    """Slope of the steepest plane through two points of the surface, to the level that gravity has (rise over run)."""
    edge, (*pushes, down), steepest = _edge(scene), np.asarray(scene.loads.gravity, float).tolist(), 0.0
    columns, top = _tops(scene, edge)
    for axis, push in enumerate(pushes):
        lines = np.unique(np.delete(columns, axis, axis=0), axis=1, return_inverse=True)[1].ravel()
        for line in range(lines.max() + 1):
            x, z = columns[axis, lines == line] * edge, top[lines == line]
            run, rise = np.subtract.outer(x, x), np.subtract.outer(z, z)
            falls = (run != 0) & (rise >= np.ptp(z) / 2)
            run, rise = -run[falls], np.maximum(rise[falls] - edge, 0)
            along, across = push * run - down * rise, -down * abs(run) - push * np.sign(run) * rise
            steepest = max(steepest, float(np.max(along / np.maximum(across, 1e-9), initial=0.0)))
    return steepest


def _gravity(scene: Scene) -> float:
    gravity = float(np.linalg.norm(np.asarray(scene.loads.gravity, float)))
    if gravity == 0:
        raise ValueError("gravity = 0 m/s2: a limit load is one of gravity, give it")
    return gravity


def _weight(scene: Scene) -> float:
    """Mean unit weight of the soil (N/m3)."""
    particles = scene.particles
    return _gravity(scene) * float(np.sum(particles.mass, dtype=float)) / float(np.sum(particles.volume, dtype=float))


@dataclass(frozen=True)
class Scale:
    """Duration of a run that shows whether soil moves, and the displacement by which the search takes it to.

    Args:
        duration: s.
        moves: m.
        far: displacement at which a run ends (m).
        volume: of soil that has to move so far (m3, in a section m2).
    """

    duration: float
    moves: float
    far: float
    volume: float

    @classmethod
    def of(cls, scene: Scene, t_end: float, volume: float | None) -> Scale:
        """Scale of a scene with gravity.

        Args:
            scene: as it runs, see `limit_load_scene`.
            t_end: longest duration (s).
            volume: the least that is a failure, None for a share of the relief.

        Raises:
            ValueError: If there is no gravity, or `t_end` is too short for the height or the softness of the soil.
        """
        gravity = _gravity(scene)
        height, relief = heights(scene)
        elastic, fall = float(elastic_period(scene)), math.sqrt(height / gravity)
        if t_end < 4 * elastic:
            raise ValueError(
                f"t_end = {t_end:g} s, but soil this soft takes {elastic:.2g} s for an elastic oscillation: give "
                f"{4 * elastic:.2g} s or more to see whether it moves on"
            )
        if t_end < SEEN * fall:
            raise ValueError(
                f"t_end = {t_end:g} s, but ground {height:.3g} m high takes {SEEN * fall:.2g} s to show that it moves: "
                "give that or more"
            )
        young = 2 * (1 + POISSON) * float(np.min(np.asarray(scene.material.shear))) / (_weight(scene) * height)
        return cls(
            duration=min(t_end, max((SOFTENING_FALL if _softens(scene) else FALL) * fall, 2 * elastic)),
            moves=min(MOVES / min(young, YOUNG), MOST) * height,
            far=FAR * height,
            volume=least_failing_volume(relief, scene.grid.dimension) if volume is None else volume,
        )


class Moved(NamedTuple):
    """What lanes have moved at the end.

    Args:
        displacement: (B,) that the least volume has exceeded at the end (m).
        slid: (B,) bool, lanes that ended early, since they had moved far or broke off while they moved.
        volume: (B,) that moved more than the search's limit and half that displacement (m3, in a section m2).
    """

    displacement: np.ndarray
    slid: np.ndarray
    volume: np.ndarray


def moved(scene: Scene, state: State, axes: Scene, scale: Scale) -> Moved:
    """Run lanes and measure what they have moved.

    Args:
        scene: with lanes.
        state: of B lanes.
        axes: leaves of the scene that have lanes first.
        scale: of the scene.

    Raises:
        FloatingPointError: If a lane breaks off that did not slide.
    """
    result = solve(scene, state, t_end=scale.duration, axes=axes, rules=[Exceeds(scale.far, scale.volume)])
    displacement = np.asarray(farthest(scene, result.state, axes, scale.volume))
    off = result.broke_off & (result.status != Status.BAD_PARAMETER) & (displacement > scale.moves)
    statuses = np.where(off, int(Status.DECIDED), result.status).astype(np.int32)
    replace(result, state=replace(result.state, status=jnp.asarray(statuses))).raise_if_failed()
    limit = np.maximum(scale.moves, displacement / 2)
    volume = jax.vmap(_volume_beyond, in_axes=(axes, 0, 0))(scene, result.state, jnp.asarray(limit))
    return Moved(displacement, statuses == Status.DECIDED, np.asarray(volume))


def _volume_beyond(scene: Scene, state: State, limit: Array) -> Array:
    """Initial volume of soil that moved farther than a limit (m)."""
    return jnp.sum(jnp.where(diagnostics.displacement(state) > limit, scene.particles.volume, 0.0))


class Kink(NamedTuple):
    """Kink of displacement over factor.

    Args:
        at: factor of the kink.
        stands: largest factor of a lane on the branch that stands.
        moves: smallest factor of a lane that is off it.
        sharpness: slope of the branch that moves over that of the one that stands.
    """

    at: float
    stands: float
    moves: float
    sharpness: float


class Branches(NamedTuple):
    """The lines of displacement over factor, below a kink and beyond, each by its slope and intercept."""

    below: np.ndarray
    beyond: np.ndarray

    @property
    def meeting(self) -> float:
        """Factor at which they meet."""
        return float((self.below[1] - self.beyond[1]) / (self.beyond[0] - self.below[0]))

    def off(self, factors: np.ndarray, displacements: np.ndarray, resolution: float) -> np.ndarray:
        """Whether lanes are off the branch that stands.

        Below the meeting a bend may lie between the branches, as high as the other one gains within the resolution.
        Beyond it a lane that has half of what the other branch gained, and half of that at least, is off: what yields
        below a jump bends as well.
        """
        past = factors - self.meeting
        gained = self.beyond[0] * np.where(past > 0, np.maximum(past, resolution) / 2, resolution)
        return displacements - np.polyval(self.below, factors) > gained


def branches(factors: np.ndarray, displacements: np.ndarray, moves: float) -> tuple[Branches, float] | None:
    """The branches of displacement over factor, and the sharpness of their kink.

    One is the line through the two lowest lanes. The other is the steepest through three lanes that follow one another:
    a lane in the bend makes it less steep, and far beyond the kink a slide that comes to rest flattens.

    Args:
        factors: (B,), rising.
        displacements: (B,) m, inf for lanes that slid off.
        moves: what such a lane has moved at least (m).

    Returns:
        Branches and sharpness, None if displacement grows too evenly.
    """
    finite = np.isfinite(displacements)
    tried, metres = factors[finite], displacements[finite]
    if len(tried) < 2:
        return None
    below = np.polyfit(tried[:2], metres[:2], 1)
    parts = [slice(k, k + 3) for k in range(max(1, len(tried) - 2))]
    beyond = max((np.polyfit(tried[part], metres[part], 1) for part in parts), key=lambda line: line[0])
    if not finite.all() and beyond[0] <= FOLLOWS * max(below[0], 0.0):
        slope = moves / (factors[len(tried)] - tried[-1])
        beyond = np.array([slope, metres[-1] - slope * tried[-1]])
    least = metres[:2].mean() / tried[:2].mean()
    sharpness = float(beyond[0] / max(below[0], least, np.finfo(float).tiny))
    return (Branches(below, beyond), sharpness) if sharpness > FOLLOWS else None


def find_kink(displacement: Callable[[np.ndarray], np.ndarray], start: float, resolution: float, moves: float) -> Kink:
    """Search the kink from a factor near which the slope begins to move.

    Lanes around a factor give both branches; their meeting is the next factor, until it lies in the middle of the
    lanes. Lanes between, at last at most the resolution from the kink, then bound it, and where displacement jumps move
    it. The search warns if displacement falls between factors, which that of a slide does not.

    Args:
        displacement: function of factors (B,) that returns the displacements of lanes (B,) m.
        start: factor to start from.
        resolution: largest distance of the kink from a lane on each side.
        moves: displacement from which the slope moves for certain (m).

    Returns:
        Kink.

    Raises:
        ValueError: If there is none.
    """
    measured: dict[float, float] = {}

    def curve(tried: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factors and displacements of all lanes from the lowest one of this round on."""
        new = np.array(sorted({round(factor, 6) for factor in tried.tolist()} - measured.keys()))
        measured.update(zip(new.tolist(), displacement(new).tolist(), strict=True) if new.size else ())
        factors = np.array([factor for factor in sorted(measured) if factor >= middle * (1 + AROUND[0]) * (1 - 1e-6)])
        return factors, np.array([measured[factor] for factor in factors.tolist()])

    middle = start
    for _ in range(ROUNDS):
        factors, displacements = curve(middle * (1 + np.array(AROUND)))
        found = branches(factors, displacements, moves)
        if not displacements[-1] > moves and (found is None or found[1] < SURE):
            found, at = None, middle * (1 + AROUND[-1])  # what yields below the limit grows by degrees
        elif found is None:
            at = factors[0]
        else:
            at = min(max(found[0].meeting, factors[0] * (1 - CENTRED)), factors[-1] * (1 + CENTRED))
        if found is not None and abs(at / middle - 1) < CENTRED:
            break
        middle = at
    else:
        text = f"{displacements[0]:.2g} to {displacements[-1]:.2g} m at R = {factors[0]:.3g} to {factors[-1]:.3g}"
        fall = falls(factors, displacements)
        raise ValueError(
            f"the displacement has no kink, {text}: {fall or 'it grows too evenly for a limit load'}; or give a "
            "failure_displacement instead"
        )
    lines, sharpness = found
    resolution = min(resolution, CENTRED * at)  # well within the lanes
    tried = at + resolution * np.array([-1.0, 1.0])
    while True:
        factors, displacements = curve(tried)
        off = lines.off(factors, displacements, resolution)
        first = int(np.argmax(off))
        stands, beyond = float(factors[first - 1]), float(factors[first])
        if beyond - stands <= 2 * resolution * (1 + 1e-3):
            break
        tried = np.array([(stands + beyond) / 2])
    if (fall := falls(factors, displacements)) is not None:
        warnings.warn(f"the limit load at R = {at:.3g} is in doubt: {fall}", stacklevel=2)
    return Kink(min(max(at, stands), beyond), stands, beyond, sharpness)


def falls(factors: np.ndarray, displacements: np.ndarray) -> str | None:
    """Warning about displacements (B,) m that fall over rising factors (B,); None if they grow."""
    finite = np.isfinite(displacements)
    factors, displacements = factors[finite], displacements[finite]
    drops = displacements[:-1] / np.maximum(displacements[1:], np.finfo(float).tiny)
    worst = int(np.argmax(drops)) if drops.size else 0
    if not (drops.size and drops[worst] > FOLLOWS):
        return None
    (more, less), (at, then) = displacements[worst : worst + 2], factors[worst : worst + 2]
    return (
        f"it moves {more:.2g} m at R = {at:.3g} and {less:.2g} m at R = {then:.3g}, as grains do that shake loose "
        "and settle by chance: give a share of PIC (flip = 0.95), or soil with much friction some dilation"
    )


def find_start(
    displacement: Callable[[np.ndarray], np.ndarray], moves: float, bracket: tuple[float, float], batch: int
) -> float:
    """A factor near which the slope begins to move, by bisection.

    Args:
        displacement: function of factors (B,) that returns the displacements of lanes (B,) m.
        moves: displacement from which the slope moves (m).
        bracket: factors that stand and move.
        batch: lanes of a round.

    Returns:
        Factor.

    Raises:
        ValueError: If all lanes stand, or all move.
    """
    (low, high), measured = bracket, np.empty((0, 2))
    tried = np.geomspace(low, high, batch)
    while tried.size:
        measured = np.concatenate([measured, np.stack([tried, displacement(tried)], axis=1)])
        measured = measured[np.argsort(measured[:, 0])]
        move = measured[:, 1] > moves
        if move.all() or not move.any():
            side, end = ("fails", low) if move.all() else ("stands", high)
            raise ValueError(f"the slope {side} even at R = {end:g}: widen the bracket {bracket}")
        first = int(np.argmax(move))
        if first == 0:
            above = measured[~move, 0].min()
            raise ValueError(
                f"the slope fails at R = {low:g} and stands at {above:g}: its displacement does not grow with R; "
                "give a narrower bracket"
            )
        low, high = measured[first - 1, 0], measured[first, 0]
        rounds = math.ceil(math.log(high / low) / math.log(COARSE) - 1e-9)
        tried = np.geomspace(low, high, min(batch, rounds - 1) + 2)[1:-1] if rounds > 1 else np.empty(0)
    return math.sqrt(low * high)


def lowest_local(
    tried: Sequence[tuple[float, float, float]], below: float, volume: float
) -> tuple[float, float] | None:
    """The lowest factor below the kink at which a slip smaller than the least volume moves, and its volume.

    Args:
        tried: factor, displacement (m) and moved volume of lanes.
        below: factor of the kink.
        volume: the least that is a failure.
    """
    slips = [(factor, moving) for factor, _, moving in tried if factor < below and LOCAL * volume <= moving < volume]
    lowest = min(slips, default=None)
    return None if lowest is None else (round(lowest[0], 4), lowest[1])
