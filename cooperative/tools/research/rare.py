"""Rare failures by gradient: the most likely failing field, and importance sampling around it.

Coefficients of the random field are independent standard normals. The failing field closest to their origin is the
most likely one, the design point of the first-order reliability method (FORM). It is searched for with gradients of a
smooth measure of the slide; sampling around it then uses the campaign's own, hard failure, so that a poor design point
costs variance and never a bias. Where soil fails in several ways there are several design points: `design_points`
starts from elsewhere too, and samples are drawn around all that it finds.

Sources: Hasofer and Lind (1974), J. Eng. Mech. Div. 100, 111-121; Zhang and Der Kiureghian (1995), the improved HL-RF
step, 10.1007/978-0-387-34866-7_32; Melchers (1989), importance sampling at the design point,
10.1016/0167-4730(89)90003-9; Der Kiureghian and Dakessian (1998), several design points,
10.1016/S0167-4730(97)00026-X; Owen and Zhou (2000), weights of a mixture, 10.1080/01621459.2000.10473909.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special, stats

from cooperative.estimate import LEVEL, Estimate, as_answers, with_variance
from cooperative.tools.research._run import Field, varied_run
from jaxmpm import Scene, State, objectives
from jaxmpm.support import check

# Displacement (m) below which the smooth measure flattens out.
FLOOR = 1e-4
ALIKE = 0.95
"""Cosine between two design points from which on they are one."""
BEYOND, APART = 1.3, 0.5
"""Distance of a probe for further regions, over that of the design point, and its largest cosine with one: a plane
limit state does not fail there, and what begins farther out weighs less than a tenth from a distance of 2.6 on."""
LARGEST = 0.2
"""Share of the weight in one sample from which on the samples show too little of their scatter."""


@dataclass(frozen=True)
class Search:
    """How a design point is searched for.

    Args:
        steps: gradients at most.
        tolerance: of the limit state, as a share of its value at the origin, and of the angle (1 - cosine) between the
            point and the gradient.
        longest: step in coefficient space at most, which keeps the search where a run still resembles the last one.
    """

    steps: int = 40
    tolerance: float = 1e-2
    longest: float = 1.5


@dataclass(frozen=True)
class DesignPoint:
    """Most likely failing field, and the search for it.

    Args:
        coefficients: (M,) of the most likely failing field.
        beta: their distance from the origin.
        probability: what FORM makes of it, Phi(-beta).
        converged: whether the tolerances were met.
        values: of the limit state, step by step.
        betas: distances from the origin, step by step.
        gradients: how many were spent.
    """

    coefficients: np.ndarray
    beta: float
    probability: float
    converged: bool
    values: tuple[float, ...]
    betas: tuple[float, ...]
    gradients: int


class NotRare(ValueError):
    """The slope of the median field fails."""


def design_point(
    limit_state: Callable[[np.ndarray], tuple[float, np.ndarray]],
    modes: int,
    search: Search | None = None,
    *,
    start: np.ndarray | None = None,
) -> DesignPoint:
    """Search for the point of least norm with a limit state of 0, by the improved HL-RF iteration.

    The point is the nearest of its surroundings. `design_points` looks for others.

    Args:
        limit_state: coefficients (M,) -> its value, positive where the slope stands, and its gradient (M,).
        modes: number of coefficients.
        search: settings, None for the defaults.
        start: coefficients (M,) from which the search begins, None for the origin, the median field. A limit state that
            is symmetric about the origin has no gradient there.

    Raises:
        ValueError: the slope fails already at the origin, or where a gradient is zero or not finite.
    """
    search = search or Search()
    at = np.zeros(modes) if start is None else np.array(start, float)
    if at.shape != (modes,) or not np.isfinite(at).all():
        raise ValueError(f"start has shape {at.shape}: give {modes} finite coefficients")
    scale = float(limit_state(np.zeros(modes))[0])
    if scale <= 0:
        raise NotRare(
            f"the limit state is {scale:.3g} at the origin, the median field: it fails too often to be called rare"
        )
    value, gradient = _checked(limit_state, at)
    values, betas, converged = [value], [float(np.linalg.norm(at))], False
    for _ in range(search.steps):
        norm = float(np.linalg.norm(gradient))
        # The point closest to the origin where the linearised limit state is 0.
        towards = gradient * (gradient @ at - value) / norm**2 - at
        far = float(np.linalg.norm(towards))
        towards *= min(1.0, search.longest / max(far, 1e-12))
        penalty = 2 * max(float(np.linalg.norm(at)) / norm, 1e-12)
        merit = 0.5 * at @ at + penalty * abs(value)
        share = 1.0
        while True:
            trial = at + share * towards
            trial_value, slope = _checked(limit_state, trial)
            if 0.5 * trial @ trial + penalty * abs(trial_value) < merit or share < 0.1:
                break
            share /= 2
        at, value, gradient = trial, trial_value, slope
        values.append(value)
        betas.append(float(np.linalg.norm(at)))
        cosine = -float(gradient @ at) / max(float(np.linalg.norm(gradient)) * betas[-1], 1e-12)
        if abs(value) <= search.tolerance * scale and 1 - cosine <= search.tolerance:
            converged = True
            break
    beta = betas[-1]
    return DesignPoint(at, beta, float(stats.norm.sf(beta)), converged, tuple(values), tuple(betas), len(values))


def design_points(
    limit_state: Callable[[np.ndarray], tuple[float, np.ndarray]],
    modes: int,
    search: Search | None = None,
    *,
    starts: int = 4,
    seed: int = 0,
) -> tuple[DesignPoint, ...]:
    """Design points of searches from the origin, from the mirror image of each point found, and from elsewhere.

    No number of starts shows that there are no others.

    Args:
        limit_state: as for `design_point`.
        modes: number of coefficients.
        search: settings, None for the defaults.
        starts: searches from random directions, at the distance of the nearest point so far, or 1.
        seed: of the directions.

    Returns:
        Those that converged, nearest first, each direction once.

    Raises:
        ValueError: the slope fails already at the origin, or no search converges.
    """
    found: list[DesignPoint] = []
    directions = np.random.default_rng(seed).standard_normal((starts, modes))
    waiting: list[np.ndarray | None] = [None, *(direction / np.linalg.norm(direction) for direction in directions)]
    reason = ValueError(f"no search of {starts + 1} converges: give more starts, or a longer search")
    while waiting:
        start = waiting.pop(0)
        distance = min((point.beta for point in found), default=1.0)
        try:
            point = design_point(limit_state, modes, search, start=None if start is None else distance * start)
        except NotRare:
            raise
        except ValueError as error:
            reason = error  # elsewhere than at the origin a search may come where the measure is flat
            continue
        towards = point.coefficients / max(point.beta, 1e-12)
        if point.converged and all(towards @ other.coefficients < ALIKE * other.beta for other in found):
            found.append(point)
            waiting.append(-towards)
    if not found:
        raise reason
    return tuple(sorted(found, key=lambda point: point.beta))


def _checked(limit_state: Callable[[np.ndarray], tuple[float, np.ndarray]], at: np.ndarray) -> tuple[float, np.ndarray]:
    value, gradient = limit_state(at)
    gradient = np.asarray(gradient, float)
    if not np.isfinite(value) or not np.isfinite(gradient).all() or not gradient.any():
        raise ValueError(
            f"the limit state is {value:.3g} with a gradient of norm {np.linalg.norm(gradient):.3g} at distance "
            f"{np.linalg.norm(at):.3g}: take a smooth measure that still changes there, a shorter run, or another start"
        )
    return float(value), gradient


def slide_limit_state(
    scene: Scene, state: State, field: Field, *, seconds: float, displacement: float, memory: float = 2e9
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Limit state of a slope and its gradient by the coefficients of a field, for `design_point`.

    log(displacement / u), u the root mean square displacement (m) after `seconds`: positive where the slope stands,
    smooth from rest to slide. A few seconds are enough, and a longer run makes it rougher. Initial stress follows
    stiffness and weight; the time step stays that of the scene.

    Args:
        scene: with a law of any kind.
        state: at the start.
        field: coefficients (M,) -> the values that `jaxmpm.with_soil` takes, as `GridModel.varied` of a campaign does.
        seconds: length of the run (s).
        displacement: at which the limit state is 0 (m).
        memory: bytes for reverse mode.

    Raises:
        ValueError: a length or a displacement that is not positive.
    """
    check.positive("seconds", seconds, "s")
    check.positive("displacement", displacement, "m")
    steps = max(1, round(seconds / float(scene.numerics.time_step)))

    def measured(coefficients: jax.Array) -> jax.Array:
        final, _ = varied_run(scene, state, field(coefficients), steps, memory=memory)
        return jnp.log(displacement / FLOOR) - objectives.log_displacement(final, FLOOR)

    both = jax.jit(jax.value_and_grad(measured))

    def limit_state(coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = both(jnp.asarray(coefficients, scene.particles.mass.dtype))
        return float(value), np.asarray(gradient, float)

    return limit_state


def importance_sampling(
    fails: Callable[[np.ndarray], np.ndarray],
    centre: np.ndarray,
    samples: int,
    *,
    seed: int = 0,
    level: float = LEVEL,
    probes: int = 16,
) -> Estimate:
    """Probability of failure from samples around design points, weighted back to the standard normal.

    The normal density is shifted, not stretched: with tens of coefficients a stretched one has weights of unbounded
    variance. Around several points it is their mixture, in proportion to Phi(-distance). The interval is that of the
    mean of the weights. It presumes that the points show all regions that fail, and that each limit state is nearly
    plane. Two things speak against that, and then a note says so and the interval is open to 1: `probes` that fail far
    from every point, and a sample that carries much of the weight. It is open, too, where no sample fails, since
    nothing bounds the weights of failures that were not drawn.

    Args:
        fails: coefficients (n, M) -> whether each fails.
        centre: design point (M,), or several (k, M).
        samples: number of samples.
        seed: of the samples.
        level: confidence level of the interval.
        probes: runs in random directions beyond the design points, besides their mirror images; 0 looks for no further
            regions.

    Raises:
        ValueError: fewer than 2 samples, or an answer is missing.
    """
    if samples < 2:
        raise ValueError(f"samples = {samples}: give 2 or more")
    centres, generator = np.atleast_2d(np.asarray(centre, float)), np.random.default_rng(seed)
    beta = np.linalg.norm(centres, axis=1)
    # Of rare points the ratios of Phi(-beta) alone matter.
    log_share = stats.norm.logsf(beta) - special.logsumexp(stats.norm.logsf(beta))
    shifted = generator.standard_normal((samples, centres.shape[1]))
    shifted += centres[generator.choice(len(centres), samples, p=np.exp(log_share)) if len(centres) > 1 else 0]
    failed = as_answers(fails(shifted))
    if failed.size != samples:
        raise ValueError(f"{failed.size} answers of {samples} samples: give one of each row of coefficients")
    weights = np.exp(-special.logsumexp(shifted @ centres.T - beta**2 / 2 + log_share, axis=1)) * failed
    points = "the design point" if len(centres) == 1 else f"{len(centres)} design points"
    notes = [f"{int(failed.sum())} of {samples} samples around {points} fail"]
    shift, probability = beta.any(), float(weights.mean())
    if shift and probes and (elsewhere := _elsewhere(fails, centres, probes, seed)):
        notes.append(
            f"MORE THAN ONE REGION FAILS: so do {elsewhere} probes at {BEYOND * beta.min():.3g} from the origin, far "
            "from the design points. The estimate may lack what fails there: look for more points (design_points)"
        )
    if shift and (heaviest := float(weights.max() / (weights.sum() or 1.0))) > LARGEST:
        notes.append(
            f"THE WEIGHTS ARE UNEVEN: one sample carries {heaviest:.0%} of the estimate, which is then too low more "
            "often than not. Most of what fails lies elsewhere, or the samples are too few"
        )
    estimate = with_variance(
        "importance sampling",
        probability,
        float(weights.var(ddof=1)) / samples,
        samples,
        level=level,
        notes=tuple(notes),
        independent=np.inf if shift else samples,
    )
    if not shift:
        return estimate
    low = estimate.interval[0] if failed.any() else 0.0
    return estimate if failed.any() and len(notes) == 1 else replace(estimate, interval=(low, 1.0))


def _elsewhere(fails: Callable[[np.ndarray], np.ndarray], centres: np.ndarray, probes: int, seed: int) -> int:
    """How many fail of the design points' mirror images and of random directions, a little farther out than they."""
    directions = np.concatenate(
        [-centres, np.random.default_rng([seed, 1]).standard_normal((probes, centres.shape[1]))]
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    beta = np.linalg.norm(centres, axis=1)
    far = directions[(directions @ (centres / beta[:, None]).T).max(axis=1) < APART]
    return int(as_answers(fails(BEYOND * beta.min() * far)).sum()) if len(far) else 0
