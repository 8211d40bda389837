"""Return to Mohr-Coulomb's pyramid in principal stresses, and the cutoff of tension."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxmpm.protocols import Component
from jaxmpm.tensors import safe_sqrt

SMALLEST = 1e-6
"""Least sine of friction in the position of the apex, which is then too far out to be reached."""


class PyramidLaw(NamedTuple):
    """Parameters of a return to the pyramid, per particle.

    Args:
        bulk: elastic bulk modulus (Pa).
        shear: elastic shear modulus (Pa).
        cohesion: Pa.
        friction: angle (radians).
        dilation: angle (radians).
        tension: largest principal stress (Pa); None without a cutoff.
    """

    bulk: Array
    shear: Array
    cohesion: Array
    friction: Array
    dilation: Array
    tension: Array | None = None


def principal_drop(x1: Array, x2: Array, x3: Array, law: PyramidLaw) -> tuple[Array, Array, Array, Array]:
    """Excess of the principal trial stresses over the pyramid, and the plastic shear strain.

    The pyramid consists of planes, so every set of active planes gives a return in closed form: the main plane, its two
    edges, the apex, and with a cutoff the tension planes and their edges with it. The right return satisfies all planes
    with multipliers of the right sign. The function takes the one that violates these conditions least, so it needs no
    tolerance, and the stress is continuous where regions meet.

    Sources: de Souza Neto, Peric and Owen (2008), doi:10.1002/9780470694626, Section 8.2; several active planes: Koiter
    (1953), doi:10.1090/qam/59769.

    Args:
        x1: largest trial stress (Pa), (N,).
        x2: middle one (Pa), (N,).
        x3: least one (Pa), (N,).
        law: parameters of the return.

    Returns:
        Three differences between trial stress and result (Pa), and the plastic shear strain.
    """
    bulk, shear, cohesion, friction, dilation, tension = law
    s, r = jnp.sin(friction), jnp.sin(dilation)
    a, b = bulk + 4 * shear / 3, bulk - 2 * shear / 3
    limit = 2 * cohesion * jnp.cos(friction)
    apex = cohesion * jnp.cos(friction) / jnp.maximum(s, SMALLEST)
    x = (x1, x2, x3)

    def beyond(y1: Array, y3: Array) -> Array:
        return y1 * (1 + s) - y3 * (1 - s) - limit

    def stress(m1: Component, m2: Component, m3: Component) -> tuple[Array, ...]:
        """Trial stress less the elastic stress of a plastic strain."""
        total = b * (m1 + m2 + m3)
        return tuple(xi - total - 2 * shear * m for xi, m in zip(x, (m1, m2, m3), strict=True))

    def strain(y: Sequence[Array]) -> tuple[Array, ...]:
        """Plastic strain between the trial stress and y."""
        d = [xi - yi for xi, yi in zip(x, y, strict=True)]
        total = sum(d) * b / (3 * bulk)
        return tuple((di - total) / (2 * shear) for di in d)

    # Each return: its stress, and its strains, which must not be negative.
    same = 4 * shear * (1 + s * r) + 4 * b * s * r
    along_23 = 2 * shear * (1 - s) * (1 - r) + 4 * b * s * r
    along_12 = 2 * shear * (1 + s) * (1 + r) + 4 * b * s * r
    f13, f23, f12 = beyond(x1, x3), beyond(x2, x3), beyond(x1, x2)
    main = f13 / same
    returns: list[tuple[Sequence[Array], Sequence[Array]]] = [(stress((1 + r) * main, 0, -(1 - r) * main), [main])]
    with_23 = [(same * f - along_23 * g) / (same**2 - along_23**2) for f, g in ((f13, f23), (f23, f13))]
    returns.append((stress((1 + r) * with_23[0], (1 + r) * with_23[1], -(1 - r) * sum(with_23)), with_23))
    with_12 = [(same * f - along_12 * g) / (same**2 - along_12**2) for f, g in ((f13, f12), (f12, f13))]
    returns.append((stress((1 + r) * sum(with_12), -(1 - r) * with_12[1], -(1 - r) * with_12[0]), with_12))
    e1, _, e3 = e = strain((apex, apex, apex))
    beyond_23, beyond_12 = (1 - r) * sum(e) + 2 * r * e3, (1 + r) * sum(e) - 2 * r * e1
    # Soil that contracts flows from its edges towards the apex, which so takes what one of them, not both, leaves.
    at_apex = jnp.where(r < 0, jnp.maximum(beyond_23, beyond_12), jnp.minimum(beyond_23, beyond_12))
    returns.append(((apex,) * 3, [at_apex]))
    if tension is not None:
        tension = jnp.minimum(tension, apex)
        returns += cut_off(
            x, tension, (tension * (1 + s) - limit) / (1 - s), a=a, b=b, r=r, stress=stress, strain=strain
        )

    def violation(y: Sequence[Array], multipliers: Sequence[Array]) -> Array:
        high, low = partial(largest, y), -largest([-yi for yi in y])
        terms = [beyond(high(), low), y[1] - y[0], y[2] - y[1], *(-2 * shear * m for m in multipliers)]
        return largest(terms if tension is None else [*terms, high() - tension])

    best: Sequence[Array] = returns[0][0]
    least = violation(*returns[0])
    for y, multipliers in returns[1:]:
        worse = violation(y, multipliers)
        better = worse < least
        best = tuple(jnp.where(better, new, old) for new, old in zip(y, best, strict=True))
        least = jnp.where(better, worse, least)
    elastic = f13 <= 0 if tension is None else (f13 <= 0) & (x1 <= tension)
    # A number that is NaN, such as that of the cutoff, makes every violation NaN, and reaches the stress.
    unknown = jnp.where(jnp.isnan(least), jnp.nan, 0)
    drop = [jnp.where(elastic, 0, xi - yi + unknown) for xi, yi in zip(x, best, strict=True)]
    m = sum(drop) / 3
    deviatoric = [(d - m) / (2 * shear) for d in drop]
    return drop[0], drop[1], drop[2], safe_sqrt(2 * (deviatoric[0] ** 2 + deviatoric[1] ** 2 + deviatoric[2] ** 2))


def largest(values: Sequence[Array]) -> Array:
    """Elementwise maximum of one or more arrays."""
    return reduce(jnp.maximum, values)


def cut_off(
    x: Sequence[Array],
    t: Array,
    low: Array,
    *,
    a: Array,
    b: Array,
    r: Array,
    stress: Callable[..., tuple[Array, ...]],
    strain: Callable[..., tuple[Array, ...]],
) -> list[tuple[Sequence[Array], Sequence[Array]]]:
    """Returns to the tension planes at t, alone and with the pyramid; they intersect it at the least stress `low`."""
    det = a * a - b * b
    one = (x[0] - t) / a
    two = [(a * (x[i] - t) - b * (x[1 - i] - t)) / det for i in (0, 1)]
    returns: list[tuple[Sequence[Array], Sequence[Array]]] = [
        (stress(one, 0, 0), [one]),
        (stress(*two, 0), two),
        ((t, t, t), list(strain((t, t, t)))),
    ]
    # One tension plane and the main plane: no strain along axis 2.
    first, third = ((a * d - b * c) / det for d, c in ((x[0] - t, x[2] - low), (x[2] - low, x[0] - t)))
    shearing = -third / (1 - r)
    returns.append((stress(first, 0, third), [shearing, first - (1 + r) * shearing]))
    # One tension plane on the edge where the two lesser stresses are equal.
    e = strain((t, low, low))
    pair = [-e[1] / (1 - r), -e[2] / (1 - r)]
    returns.append(((t, low, low), [*pair, e[0] - (1 + r) * sum(pair)]))
    # Two tension planes on the edge where the two greater stresses are equal; shear may go to either.
    e = strain((t, t, low))
    shearing = -e[2] / (1 - r)
    returns.append(((t, t, low), [shearing, e[0], e[1], e[0] + e[1] - (1 + r) * shearing]))
    return returns
