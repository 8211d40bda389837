"""Smooth measures of a slide, for derivatives; each gives its distance from the exact measure."""

from __future__ import annotations

import warnings
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.support import check
from jaxmpm.types import Scene, State

HALVINGS = 50
"""Bisection steps of a quantile: more than float64 has digits."""

HARDLY = 0.1
"""Displacement of soil at the front, over the largest, below which it has hardly moved."""


def soft_largest_displacement(state: State, width: float = 0.1) -> Array:
    """Smooth largest displacement: width * log of the sum of exp(u / width) over the particles.

    It exceeds the largest displacement by at most width * log(N): 0.8 m for 2000 particles and 0.1 m at rest, where all
    are equal, and by width * log(n) where n particles share the largest. The exact measure,
    `diagnostics.largest_displacement`, has the derivative of the single particle that leads.

    Args:
        state: of one lane.
        width: m, above 0.

    Returns:
        () m.

    Raises:
        ValueError: If the width is not above 0.
    """
    check.positive("width", width, "m")
    return width * jax.nn.logsumexp(diagnostics.displacement(state) / width)


def front(scene: Scene, state: State, share: float = 0.01, width: float = 0.5) -> Array:
    """Largest x beyond which a share of all mass lies, a smooth quantile; for slides see `runout`.

    It solves mass share of (1 + tanh((x - front) / width)) / 2 = share by bisection, and differentiates that equation.
    It lies behind the foremost particle; for particles spread over much more than `width` the error is of second order
    in it. Ground ahead of a slide counts, although it never moves. If the soil beyond the front has moved less than a
    tenth of the largest displacement there is a warning, unless the state is traced.

    Args:
        scene: of the state.
        state: of one lane.
        share: of the mass, between 0 and 1/2.
        width: of the smoothing (m), above 0.

    Returns:
        () m.

    Raises:
        ValueError: If share or width are out of range.
    """
    check.between("share", share, 0.0, 0.5)
    check.positive("width", width, "m")
    x, displacement = diagnostics.position(scene, state)[0], diagnostics.displacement(state)
    at = _foremost(x, scene.particles.mass, share, width)
    if not check.is_traced(scene, state):
        beyond = np.asarray(displacement)[np.asarray(x) >= float(at)]
        if beyond.size and beyond.mean() < HARDLY * float(jnp.max(displacement)):
            warnings.warn(
                f"the front at {float(at):.3g} m is of soil that has moved {beyond.mean():.2g} m, the slide up to "
                f"{float(jnp.max(displacement)):.2g} m: it is the ground ahead of the slide, use objectives.runout",
                stacklevel=2,
            )
    return at


def runout(
    scene: Scene,
    state: State,
    toe: float,
    *,
    moved: float = 1.0,
    share: float = 0.02,
    width: float = 0.25,
    downhill: Literal[1, -1] = 1,
) -> Array:
    """Smooth run-out: distance beyond the toe at which the foremost share of the sliding soil begins.

    A particle counts by its mass times a smooth step in its displacement u: 0 up to moved / 2, 1/2 at `moved` and 1
    from 3 moved / 2. So ground that never moved does not count. The quantile is that of `front`, minus its offset for
    soil at a single point. So it is 0 if nothing slides and negative if the slide stays behind the toe. It lies behind
    the exact run-out, that of the foremost particle's edge, by the length of the `share` of the slide and some 2
    `width`.

    Args:
        scene: of the state.
        state: of one lane.
        toe: x (m).
        moved: displacement of sliding soil (m), above 0.
        share: of the sliding soil, between 0 and 1/2.
        width: of the smoothing (m), above 0.
        downhill: direction along x in which the slope falls to its toe.

    Returns:
        () m.

    Raises:
        ValueError: If the toe is not finite, or another argument is out of range.
    """
    check.finite("toe", toe, "m")
    check.between("share", share, 0.0, 0.5)
    for name, length in (("moved", moved), ("width", width)):
        check.positive(name, length, "m")
    if downhill not in (1, -1):
        raise ValueError(f"downhill = {downhill!r}: give 1 for a slope that falls along x, -1 for one that rises")
    rise = jnp.clip(diagnostics.displacement(state) / moved - 0.5, 0.0, 1.0)
    mass, x = scene.particles.mass, downhill * diagnostics.position(scene, state)[0]
    # A grain at the toe gives run-out 0 without a slide; a slide of one particle outweighs it a thousand times.
    weight = jnp.append(mass * rise**3 * (10 - 15 * rise + 6 * rise**2), 1e-3 * jnp.mean(mass))
    ahead = width * np.arctanh(1 - 2 * share)
    toe = downhill * toe
    return _foremost(jnp.append(x, jnp.asarray(toe, x.dtype)), weight, share, width) - toe - ahead


def _foremost(x: Array, weight: Array, share: float, width: float) -> Array:
    """Position beyond which the foremost `share` of the weight (N,) at x (N,) lies, differentiable in both."""
    w = weight / jnp.sum(weight)

    def beyond(at: Array, x: Array, w: Array) -> Array:
        return jnp.sum(w * 0.5 * (1 + jnp.tanh((x - at) / width))) - share

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        right = beyond(middle, *fixed) > 0
        return jnp.where(right, middle, low), jnp.where(right, high, middle)

    fixed = jax.lax.stop_gradient((x, w))
    # Beyond these ends all of the weight would lie on one side if it were at a single point.
    reach = width * jnp.arctanh(1 - 2 * share)
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.min(fixed[0]) - reach, jnp.max(fixed[0]) + reach))
    at = jax.lax.stop_gradient((low + high) / 2)
    # One Newton step, exact at the solution, carries the derivative of the implicit equation.
    slope = jax.lax.stop_gradient(jax.grad(beyond)(at, *fixed))
    return at - beyond(at, x, w) / slope


def log_displacement(state: State, floor: float = 1e-3) -> Array:
    """Logarithm of the root mean square displacement over a floor: smooth from rest to slide.

    It is log(1 + mean of u^2 / floor^2) / 2, which is 0 at rest and log(u / floor) for a mean square of u^2 far above
    floor^2. It ranks slides by their whole mass, whereas the largest displacement ranks them by one particle.

    Args:
        state: of one lane.
        floor: m, above 0.

    Returns:
        ().

    Raises:
        ValueError: If the floor is not above 0.
    """
    check.positive("floor", floor, "m")
    return 0.5 * jnp.log1p(jnp.mean(jnp.sum(state.displacement**2, axis=0)) / floor**2)


def column_height(scene: Scene, state: State, stations: Array, width: float) -> Array:
    """Height of the soil above the base at stations along x, of a section or per metre of width.

    It is the soil's volume under a Gaussian of deviation `width` / 2 about each station, over that of a unit height:
    the surface where nothing overhangs, averaged over about `width`, and too low within `width` of the ends. Particles
    a width apart give a ripple of 1.4 %, half a width apart none.

    Args:
        scene: of the state; in 3D with walls at both ends of y.
        state: of one lane.
        stations: (k,) x (m).
        width: m, above 0.

    Returns:
        (k,) m.

    Raises:
        ValueError: If a station is not finite, the width is not above 0, or in 3D walls along y are missing.
    """
    check.finite("stations", stations, "m")
    check.positive("width", width, "m")
    x = diagnostics.position(scene, state)[0]
    sigma = width / 2
    share = jnp.exp(-0.5 * ((x - stations[:, None]) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return share @ (scene.particles.volume * state.volume_ratio) / _breadth(scene)


def _breadth(scene: Scene) -> float:
    """Width along y (m) between the walls at its ends; 1 for a section, whose volumes are per metre."""
    if scene.grid.dimension < 3:
        return 1.0
    ends = {wall.side: wall.index for wall in scene.boundary.walls if wall.axis == 1}
    if ends.keys() != {"low", "high"}:
        raise ValueError("the scene has no walls at both ends of y, so no width: give a section, or walls along y")
    return (ends["high"] - ends["low"]) * scene.grid.cell
