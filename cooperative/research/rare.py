"""Rare failures by gradient: the most likely failing field, and importance sampling around it.

Coefficients of the random field are independent standard normals. The failing field closest to their origin is the
most likely one, the design point of the first-order reliability method (FORM). It is searched for with gradients of a
smooth measure of the slide; sampling around it then uses the campaign's own, hard failure, so that a poor design point
costs variance and never a bias.

Sources: Hasofer and Lind (1974), J. Eng. Mech. Div. 100, 111-121; Zhang and Der Kiureghian (1995), the improved HL-RF
step, 10.1007/978-0-387-34866-7_32; Melchers (1989), importance sampling at the design point,
10.1016/0167-4730(89)90003-9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from cooperative.estimate import Estimate, as_answers, with_variance
from cooperative.runs import GridModel
from jaxmpm import objectives, replay, with_soil

# Displacement (m) below which the smooth measure flattens out.
FLOOR = 1e-4


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


def design_point(
    limit_state: Callable[[np.ndarray], tuple[float, np.ndarray]], modes: int, search: Search | None = None
) -> DesignPoint:
    """Search for the point of least norm with a limit state of 0, by the improved HL-RF iteration.

    Args:
        limit_state: coefficients (M,) -> its value, positive where the slope stands, and its gradient (M,).
        modes: number of coefficients.
        search: settings, None for the defaults.

    Raises:
        ValueError: the slope fails already at the origin (the median field), or where a gradient is zero or not finite.
    """
    search = search or Search()
    at = np.zeros(modes)
    value, gradient = _checked(limit_state, at)
    if value <= 0:
        raise ValueError(
            f"the limit state is {value:.3g} at the origin, the median field: it fails too often to be called rare"
        )
    scale, values, betas, converged = value, [value], [0.0], False
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


def _checked(limit_state: Callable[[np.ndarray], tuple[float, np.ndarray]], at: np.ndarray) -> tuple[float, np.ndarray]:
    value, gradient = limit_state(at)
    gradient = np.asarray(gradient, float)
    if not np.isfinite(value) or not np.isfinite(gradient).all() or not gradient.any():
        raise ValueError(
            f"the limit state is {value:.3g} with a gradient of norm {np.linalg.norm(gradient):.3g} at distance "
            f"{np.linalg.norm(at):.3g}: take a smooth measure that still changes there, or a shorter run"
        )
    return float(value), gradient


def slide_limit_state(
    model: GridModel, *, seconds: float, displacement: float, memory: float = 2e9
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Limit state of a slope and its gradient by the field's coefficients, for `design_point`.

    log(displacement / u), u the root mean square displacement (m) after `seconds` on the model's grid: positive where
    the slope stands, smooth from rest to slide. A few seconds are enough, and a longer run makes it rougher.

    Args:
        model: grid and soil.
        seconds: length of the run (s).
        displacement: at which the limit state is 0 (m).
        memory: bytes for reverse mode.

    Raises:
        ValueError: stiffness or weight are random, on which the initial stress depends.
    """
    model.refuse_own_start()
    scene, state = model.scene, model.state
    steps = max(1, round(seconds / float(scene.time_step)))

    def measured(coefficients: jax.Array) -> jax.Array:
        varied, _ = with_soil(scene, state, **model.varied(coefficients))
        final, _ = replay(varied, state, steps, memory=memory)
        return jnp.log(displacement / FLOOR) - objectives.log_displacement(final, FLOOR)

    both = jax.jit(jax.value_and_grad(measured))

    def limit_state(coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = both(jnp.asarray(coefficients, scene.particles.mass.dtype))
        return float(value), np.asarray(gradient, float)

    return limit_state


def importance_sampling(
    fails: Callable[[np.ndarray], np.ndarray], centre: np.ndarray, samples: int, *, seed: int = 0, level: float = 0.95
) -> Estimate:
    """Probability of failure from samples around `centre` (M,), weighted back to the standard normal.

    The normal density is shifted, not stretched: with tens of coefficients a stretched one has weights of unbounded
    variance. The interval is that of the mean of the weights; where no sample fails, it is open to 1, since nothing
    bounds the weights of failures that were not drawn. It presumes one design point and a limit state that is nearly
    plane: elsewhere it is too narrow, and lacks failures around other points.

    Args:
        fails: coefficients (samples, M) -> whether each fails.
        centre: design point (M,).
        samples: number of samples.
        seed: of the samples.
        level: confidence level of the interval.

    Raises:
        ValueError: fewer than 2 samples, or an answer is missing.
    """
    if samples < 2:
        raise ValueError(f"samples = {samples}: give 2 or more")
    centre = np.asarray(centre, float)
    shifted = centre + np.random.default_rng(seed).standard_normal((samples, centre.size))
    failed = as_answers(fails(shifted))
    if failed.size != samples:
        raise ValueError(f"{failed.size} answers of {samples} samples: give one of each row of coefficients")
    weights = np.exp(centre @ centre / 2 - shifted @ centre) * failed
    estimate = with_variance(
        "importance sampling",
        float(weights.mean()),
        float(weights.var(ddof=1)) / samples,
        samples,
        level=level,
        notes=(f"{int(failed.sum())} of {samples} samples around the design point fail",),
        independent=np.inf if centre.any() else samples,
    )
    return replace(estimate, interval=(0.0, 1.0)) if centre.any() and not failed.any() else estimate
