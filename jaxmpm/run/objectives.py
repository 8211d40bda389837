"""Smooth measures of a slide, for derivatives; each states how far it lies from the hard one."""

from __future__ import annotations

import warnings

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from jaxmpm import diagnostics
from jaxmpm.types import Scene, State

HALVINGS = 50
"""Of the bracket of a quantile: more than float64 has digits."""

HARDLY = 0.1
"""Share of the largest displacement below which soil at the front has hardly moved."""


def soft_largest_displacement(state: State, width: float = 0.1) -> Array:
    """Smooth largest displacement (m): width * log of the sum of exp(u / width) over the particles.

    Lies above the largest displacement, by at most width * log(N): 0.8 m for 2000 particles and 0.1 m at rest, where
    all are alike, and by width * log(n) where n particles share the largest.
    The largest itself (`diagnostics.largest_displacement`) has the derivative of the one particle that leads.
    Raises ValueError for a width not above 0.
    """
    check.positive("width", width, "m")
    return width * jax.nn.logsumexp(diagnostics.displacement(state) / width)


def front(scene: Scene, state: State, share: float = 0.01, width: float = 0.5) -> Array:
    """Where along x (m) the foremost `share` of all mass begins, as a smooth quantile; of a slide see `runout`.

    Solves mass share of (1 + tanh((x - front) / width)) / 2 = share by bisection, and differentiates the equation
    itself. Lies behind the foremost particle; the quantile of particles spread over much more than `width` is met to
    second order in it. Ground ahead of a slide counts, though it never moves: where the soil beyond the front has moved
    less than a tenth of the largest displacement a warning says so, unless the state is being traced.
    Raises ValueError for a share outside 0 to 1/2, or a width not above 0.
    """
    check.between("share", share, 0.0, 0.5)
    check.positive("width", width, "m")
    x, moved = diagnostics.position(scene, state)[0], diagnostics.displacement(state)
    at = _foremost(x, scene.particles.mass, share, width)
    if not check.is_traced(scene, state):
        beyond = np.asarray(moved)[np.asarray(x) >= float(at)]
        if beyond.size and beyond.mean() < HARDLY * float(jnp.max(moved)):
            warnings.warn(
                f"the front at {float(at):.3g} m is of soil that has moved {beyond.mean():.2g} m, the slide up to "
                f"{float(jnp.max(moved)):.2g} m: it is the ground ahead of the slide, use objectives.runout",
                stacklevel=2,
            )
    return at


def runout(
    scene: Scene, state: State, toe: float, *, moved: float = 1.0, share: float = 0.02, width: float = 0.25
) -> Array:
    """How far beyond `toe` (x, m) the foremost `share` of the sliding soil begins (m): a smooth run-out.

    A particle counts to the sliding soil by its mass times a smooth step in its displacement u, which is 0 up to
    moved / 2, 1/2 at `moved` (m) and 1 from 3 moved / 2 on, so that ground which never moved does not count at all. The
    quantile is that of `front`, less what it lies ahead of soil that is all in one place. So it is 0 where nothing
    slides, below 0 where the slide stays behind the toe, and lies behind the hard run-out, that of the foremost
    particle's edge, by the length that `share` of the slide takes and some 2 `width`.
    Raises ValueError for a share outside 0 to 1/2, or lengths that are not above 0.
    """
    check.finite("toe", toe, "m")
    check.between("share", share, 0.0, 0.5)
    for name, length in (("moved", moved), ("width", width)):
        check.positive(name, length, "m")
    rise = jnp.clip(diagnostics.displacement(state) / moved - 0.5, 0.0, 1.0)
    mass, x = scene.particles.mass, diagnostics.position(scene, state)[0]
    # A grain at the toe is the run-out of what does not slide; a slide of one particle outweighs it a thousand times.
    weight = jnp.append(mass * rise**3 * (10 - 15 * rise + 6 * rise**2), 1e-3 * jnp.mean(mass))
    ahead = width * np.arctanh(1 - 2 * share)
    return _foremost(jnp.append(x, jnp.asarray(toe, x.dtype)), weight, share, width) - toe - ahead


def _foremost(x: Array, weight: Array, share: float, width: float) -> Array:
    """Where the foremost `share` of the weight (N,) at x (N,) begins: differentiable in both."""
    w = weight / jnp.sum(weight)

    def beyond(at: Array, x: Array, w: Array) -> Array:
        return jnp.sum(w * 0.5 * (1 + jnp.tanh((x - at) / width))) - share

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        right = beyond(middle, *fixed) > 0
        return jnp.where(right, middle, low), jnp.where(right, high, middle)

    fixed = jax.lax.stop_gradient((x, w))
    # Beyond these ends all of the weight lies on one side, were it in one place.
    reach = width * jnp.arctanh(1 - 2 * share)
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.min(fixed[0]) - reach, jnp.max(fixed[0]) + reach))
    at = jax.lax.stop_gradient((low + high) / 2)
    # One Newton step, exact at the solution, carries the derivative of the implicit equation.
    slope = jax.lax.stop_gradient(jax.grad(beyond)(at, *fixed))
    return at - beyond(at, x, w) / slope


def log_displacement(state: State, floor: float = 1e-3) -> Array:
    """Logarithm of the root mean square displacement over `floor` (m): smooth from rest to slide.

    log(1 + mean of u^2 / floor^2) / 2, which is 0 at rest and log(u / floor) for a mean square of u^2 far above
    floor^2. Ranks slides by their whole mass, where the largest displacement ranks them by one particle.
    Raises ValueError for a floor not above 0.
    """
    check.positive("floor", floor, "m")
    return 0.5 * jnp.log1p(jnp.mean(jnp.sum(state.displacement**2, axis=0)) / floor**2)


def column_height(scene: Scene, state: State, stations: Array, width: float) -> Array:
    """Height of the soil (m) above the base at `stations` (k,) along x, of a section or per metre of width.

    The soil's volume under a Gaussian of deviation `width` / 2 (m) about each station, over what that holds of a unit
    height: the surface where nothing overhangs, averaged over some `width`, and too low within it of the ends. With
    particles a width apart it ripples by 1.4 per cent, half a width apart not at all.
    Raises ValueError for stations that are not finite, a width not above 0, and in 3D where no walls stand at both ends
    of y.
    """
    check.finite("stations", stations, "m")
    check.positive("width", width, "m")
    x = diagnostics.position(scene, state)[0]
    sigma = width / 2
    share = jnp.exp(-0.5 * ((x - stations[:, None]) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return share @ (scene.particles.volume * state.volume_ratio) / _breadth(scene)


def _breadth(scene: Scene) -> float:
    """Width along y (m) between the walls at its ends; 1 of a section, whose volumes are per metre."""
    if scene.grid.dimension < 3:
        return 1.0
    ends = {wall.side: wall.index for wall in scene.walls if wall.axis == 1}
    if ends.keys() != {"low", "high"}:
        raise ValueError("the scene has no walls at both ends of y, so no width: give a section, or walls along y")
    return (ends["high"] - ends["low"]) * scene.grid.cell
