"""Back-analysis: the soil of a slide that happened, from its final surface and a few displacement histories.

Least squares with a prior: the most probable parameters, and how well the data determine each, by the Gauss-Newton
(Laplace) approximation of their covariance (Tarantola 2005, Inverse Problem Theory, 10.1137/1.9780898717921, Section
3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from cooperative.tools.research._run import Field, varied_run
from jaxmpm import Scene, State, numbers_of, objectives, pytree
from jaxmpm.support import check
from jaxmpm.support.text import shown

LOG_DEVIATION = 0.3
"""Prior deviation of the logarithms of factors: 1.3 either way."""


@pytree
@dataclass(frozen=True)
class Parameters:
    """What is looked for.

    Args:
        factors: logarithms of factors () on numbers of the scene, by the names that `jaxmpm.with_soil` and
            `jaxmpm.laws.declared` have for them.
        coefficients: (n,) of the field, independent standard normals.
    """

    factors: Mapping[str, Array | float]
    coefficients: Array | np.ndarray


@dataclass(frozen=True)
class Survey:
    """What is observed of a slide, and how.

    Args:
        seconds: length of the slide.
        times: number of equally spaced times at which markers are read.
        markers: (m,) particles whose displacement is followed.
        stations: (k,) positions along x where the surface is levelled (m).
        width: over which a levelling averages (m).
    """

    seconds: float
    times: int
    markers: np.ndarray
    stations: np.ndarray
    width: float = 2.0


@pytree
@dataclass(frozen=True)
class Observed:
    """Readings of a survey.

    Args:
        surface: (k,) height of the soil column at each station in the end (m).
        histories: (times, d, m) displacement of the markers (m).
    """

    surface: Array
    histories: Array


@dataclass(frozen=True)
class Recovery:
    """Result of a back-analysis.

    Args:
        parameters: most probable ones.
        losses: of each iteration.
        deviation: posterior standard deviation of each parameter.
        prior: prior standard deviation of each; the data determine what is far below it.
        predicted: what they would show.
    """

    parameters: Parameters
    losses: np.ndarray
    deviation: Parameters
    prior: Parameters
    predicted: Observed


def predict(
    scene: Scene,
    state: State,
    survey: Survey,
    parameters: Parameters,
    field: Field | None = None,
    *,
    memory: float = 2e9,
) -> Observed:
    """What the survey would show of the slide that these parameters make.

    Differentiable. Initial stress follows stiffness and weight; the time step stays that of the scene.

    Args:
        scene: with a law of any kind.
        state: at the start.
        survey: what is observed, and when.
        parameters: of the soil, and of walls and a base.
        field: coefficients (n,) -> the values that `jaxmpm.with_soil` takes, as `GridModel.leading` of a campaign
            gives them; None where there are no coefficients. Factors multiply what it gives.
        memory: bytes for reverse mode.

    Returns:
        Readings, nan where the run breaks off.

    Raises:
        ValueError: markers that are no particles of the scene, a factor of something that the scene does not have, or
            coefficients without a field.
    """
    count = scene.particles.mass.size
    strangers = [int(m) for m in survey.markers if not 0 <= m < count]
    if strangers:
        raise ValueError(
            f"markers = {shown(strangers)}: the scene has {count} particles, give numbers from 0 to {count - 1}"
        )
    if field is None and len(parameters.coefficients):
        raise ValueError(f"{len(parameters.coefficients)} coefficients without a field: give it, or no coefficients")
    values = {} if field is None else dict(field(jnp.asarray(parameters.coefficients, scene.particles.mass.dtype)))
    numbers = numbers_of(scene)
    if unknown := sorted(parameters.factors.keys() - numbers.keys()):
        raise ValueError(f"{unknown} is no number of the scene: give some of {list(numbers)}")
    for name, factor in parameters.factors.items():
        # Zones without a number have nan for it, and 0 times nan would be their part of its derivative.
        values[name] = jnp.nan_to_num(values.get(name, numbers[name])) * jnp.exp(factor)
    every = max(1, round(survey.seconds / float(scene.numerics.time_step) / survey.times))
    final, histories = varied_run(
        scene, state, values, every * survey.times, memory=memory, every=every,
        observe=lambda s: s.displacement[:, survey.markers],
    )  # fmt: skip
    stations = jnp.asarray(survey.stations, scene.particles.mass.dtype)
    return Observed(objectives.column_height(scene, final, stations, survey.width), histories)


def recover(
    scene: Scene,
    state: State,
    survey: Survey,
    observed: Observed,
    noise: float,
    *,
    names: Collection[str],
    field: Field | None = None,
    coefficients: int = 0,
    iterations: int = 60,
    optimiser: optax.GradientTransformation | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Recovery:
    """The most probable parameters behind `observed`, from the middle of the prior.

    Args:
        scene: with a law of any kind.
        state: at the start.
        survey: what is observed, and when.
        observed: readings.
        noise: standard deviation of every reading (m).
        names: of numbers on which factors are looked for, as in `Parameters`.
        field: as for `predict`.
        coefficients: how many the field has.
        iterations: of the optimiser.
        optimiser: of optax, L-BFGS with its line search by default.
        report: called with the number and the loss of every iteration.

    Raises:
        ValueError: a noise that is not positive, nothing to look for, a loss that is not finite, or as for `predict`.
    """
    check.positive("noise", noise, "m")
    check.whole("coefficients", coefficients, least=0)
    if not names and not coefficients:
        raise ValueError("there are neither names nor coefficients to look for: give some")
    dtype = scene.particles.mass.dtype
    none = jnp.zeros((), dtype)
    start = Parameters(dict.fromkeys(names, none), jnp.zeros(coefficients, dtype))
    prior = Parameters(dict.fromkeys(names, LOG_DEVIATION), np.ones(coefficients))
    optimiser = optax.with_extra_args_support(optimiser or optax.lbfgs())

    def residuals(parameters: Parameters) -> tuple[Array, Observed]:
        predicted = predict(scene, state, survey, parameters, field)
        misfit = jax.tree.map(lambda a, b: jnp.ravel(a - b) / noise, predicted, observed)
        unlikely = jax.tree.map(lambda value, deviation: jnp.ravel(value / deviation), parameters, prior)
        return jnp.concatenate(jax.tree.leaves((misfit, unlikely))), predicted

    def loss(parameters: Parameters) -> Array:
        return 0.5 * jnp.sum(residuals(parameters)[0] ** 2)

    @jax.jit
    def step(parameters: Parameters, memory: optax.OptState) -> tuple[Parameters, optax.OptState, Array]:
        value, gradient = jax.value_and_grad(loss)(parameters)
        change, memory = optimiser.update(gradient, memory, parameters, value=value, grad=gradient, value_fn=loss)
        return optax.apply_updates(parameters, change), memory, value

    # Of strong type, as a step returns it: a weak one in between would have the second step compiled anew.
    memory = jax.tree.map(lambda leaf: jnp.asarray(leaf, leaf.dtype), optimiser.init(start))
    parameters, losses = start, []
    best, least = start, np.inf
    for number in range(iterations):
        before = parameters
        parameters, memory, value = step(parameters, memory)
        losses.append(float(value))
        if not np.isfinite(losses[-1]):
            raise ValueError(f"the loss is {losses[-1]} at iteration {number}: take an optimiser of smaller steps")
        if losses[-1] < least:
            best, least = before, losses[-1]
        if report is not None:
            report(number, losses[-1])
    flat, restore = ravel_pytree(best)
    # Few parameters and many readings: forward mode.
    derivatives, fitted = jax.jit(jax.jacfwd(lambda p: residuals(restore(p)), has_aux=True))(flat)
    jacobian = np.asarray(derivatives, float)
    deviation = restore(jnp.asarray(np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))), dtype))
    return Recovery(best, np.array(losses), deviation, prior, fitted)
