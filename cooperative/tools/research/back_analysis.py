"""Back-analysis: the strength of a slide that happened, from its final surface and a few displacement histories.

Least squares with the prior of the random field: the most probable parameters, and how well the data determine each,
by the Gauss-Newton (Laplace) approximation of their covariance (Tarantola 2005, Inverse Problem Theory,
10.1137/1.9780898717921, Section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from cooperative.runs import GridModel
from jaxmpm import objectives, pytree, replay, with_soil
from jaxmpm.laws import declared
from jaxmpm.support.text import shown

# Prior deviation of the logarithms of strength and softening: a factor of 1.3 either way.
LOG_DEVIATION = 0.3


@pytree
@dataclass(frozen=True)
class Parameters:
    """What is looked for.

    Args:
        strength: logarithms of factors on the model's mean strength and softening modulus.
        softening: logarithms of factors on the model's mean strength and softening modulus.
        coefficients: (n,) the leading ones of the strength's random field, the rest being 0.
    """

    strength: Array | float
    softening: Array | float
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


def predict(model: GridModel, survey: Survey, parameters: Parameters, *, memory: float = 2e9) -> Observed:
    """What the survey would show of the slide that these parameters make.

    Differentiable.

    Args:
        model: grid and soil.
        survey: what is observed, and when.
        parameters: of the soil.
        memory: bytes for reverse mode.

    Raises:
        ValueError: markers that are no particles of the model, a soil that does not soften by a modulus, and random
            stiffness or weight.
    """
    model.refuse_own_start()
    scene, numbers = model.scene, declared(model.scene.material)
    count = scene.particles.mass.size
    strangers = [int(m) for m in survey.markers if not 0 <= m < count]
    if strangers:
        raise ValueError(
            f"markers = {shown(strangers)}: the model has {count} particles, give numbers from 0 to {count - 1}"
        )
    if {"softening_modulus", "strain_95"}.isdisjoint(numbers):
        raise ValueError("the soil does not soften: give it a softening_modulus, or leave back-analysis of it out")
    if "softening_modulus" not in numbers:
        raise ValueError(
            "the soil loses strength exponentially (strain_95), and back-analysis asks for the modulus of a straight "
            "loss: give the soil a softening_modulus instead"
        )
    dtype = scene.particles.mass.dtype
    missing = model.soil.modes - len(parameters.coefficients)
    field = jnp.concatenate([jnp.asarray(parameters.coefficients, dtype), jnp.zeros(missing, dtype)])
    values_of_soil = {
        numbers[name].path: numbers[name].value for name in ("strength", "softening_modulus")
    } | model.varied(field)
    changed = {"strength": parameters.strength, "softening.modulus": parameters.softening}
    # Zones without a parameter have nan for it, and 0 times nan would be their part of its derivative.
    values_of_soil |= {path: jnp.nan_to_num(values_of_soil[path]) * jnp.exp(change) for path, change in changed.items()}
    varied, _ = with_soil(scene, model.state, **values_of_soil)
    every = max(1, round(survey.seconds / float(scene.numerics.time_step) / survey.times))
    final, histories = replay(
        varied, model.state, every * survey.times, memory=memory, every=every,
        observe=lambda s: s.displacement[:, survey.markers],
    )  # fmt: skip
    return Observed(
        objectives.column_height(scene, final, jnp.asarray(survey.stations, dtype), survey.width), histories
    )


def recover(
    model: GridModel,
    survey: Survey,
    observed: Observed,
    noise: float,
    *,
    modes: int,
    iterations: int = 60,
    optimiser: optax.GradientTransformation | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Recovery:
    """The most probable parameters behind `observed`, with `modes` leading coefficients, from the prior's middle.

    Args:
        model: grid and soil.
        survey: what is observed, and when.
        observed: readings.
        noise: standard deviation of every reading (m).
        modes: number of leading coefficients.
        iterations: of the optimiser.
        optimiser: of optax, L-BFGS with its line search by default.
        report: called with the number and the loss of every iteration.

    Raises:
        ValueError: a noise that is not positive, more modes than the field has, or a loss that is not finite.
    """
    if not noise > 0:
        raise ValueError(f"noise = {noise} m: give a standard deviation above 0")
    if not 0 <= modes <= model.soil.modes:
        raise ValueError(f"modes = {modes}: the field has {model.soil.modes}, give at most these")
    dtype = model.scene.particles.mass.dtype
    start = Parameters(jnp.zeros((), dtype), jnp.zeros((), dtype), jnp.zeros(modes, dtype))
    prior = Parameters(LOG_DEVIATION, LOG_DEVIATION, np.ones(modes))
    optimiser = optax.with_extra_args_support(optimiser or optax.lbfgs())

    def residuals(parameters: Parameters) -> tuple[Array, Observed]:
        predicted = predict(model, survey, parameters)
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
