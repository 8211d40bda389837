"""The critical slip surface of a section: circles over all of it, then surfaces of any shape."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from cooperative.safety._slices import Circle, Slices, Slip

ENDS = 12
"""Points of the surface at which circles of the first search begin and end."""
LEVEL = 0.15
"""Share of these points' density that level ground has, over that of a vertical face."""
SAGS = (0.08, 0.16, 0.27, 0.42)
"""Of these circles: largest distance from their chord, over its length."""
RISE = 0.2
"""Least difference of height of their ends, over that of the ground."""
COARSE, MIDDLE = 10, 20
"""Slices of a surface in the first search, and in later ones."""
BANDS, NEAR = 5, 1.2
"""Parts of the ground's height by which circles are a family, and largest factor of a family over the least."""
FAMILIES, EVALUATIONS = 3, 40
"""Families in which the critical circle is looked for, and evaluations in each."""
VERTICES, SWEEPS = 9, 14
"""Of a surface of any shape, and rounds in which each vertex moves."""
STEP, GROWN, SHRUNK = 0.06, 1.6, -0.5
"""First step of a vertex over the height of the ground, and factors after a better and a worse surface."""
BEYOND = 1e3
"""Stands for no factor in a search that takes finite numbers alone."""
STEEPEST, HOLLOW = math.radians(70.0), math.radians(0.5)
"""Largest angle of a surface to the horizontal, and largest turn of it downwards, on which no rigid mass slides."""
KNEES = 9
"""Points of a seam at which surfaces that follow it begin and end to do so."""
ACTIVE, PASSIVE = math.radians(60.0), math.radians(30.0)
"""Angles at which such a surface leaves a seam, upwards and downwards of it."""
SEAMS = 6
"""Of these surfaces: those with the least factors by Janbu's method, for which Spencer's is solved."""
WORSE = 1.3
"""Largest factor of a seam's surface, over that of the critical circle, from which the search goes on."""
NO_FACTOR = "has a factor of safety by limit equilibrium: is the ground level, or all of it rock?"


@dataclass(frozen=True)
class Critical:
    """Critical slip surfaces of a section.

    Args:
        slip: that of the least factor of safety, of any shape.
        circle: the critical circle.
        surfaces: number of surfaces that were tried.
    """

    slip: Slip
    circle: Slip
    surfaces: int


@dataclass
class _Trials:
    """Surfaces that were tried."""

    slices: Slices
    count: int = field(default=0)

    def factor(
        self,
        surface: Circle | np.ndarray | None,
        slices: int,
        method: Literal["bishop", "janbu", "spencer"] = "spencer",
    ) -> float:
        """Factor of safety of a surface; infinite where it has none."""
        if surface is None:
            return math.inf
        self.count += 1
        slip = replace(self.slices, slices=slices).slip(surface, method)
        return math.inf if slip is None else slip.factor


def critical_surface(slices: Slices) -> Critical:
    """The critical circle of a section, and the critical surface of any shape.

    Args:
        slices: the section.

    Returns:
        Both.

    Raises:
        ValueError: no surface has a factor of safety.
    """
    trials = _Trials(slices)
    circle = _critical_circle(trials)
    best = slices.slip(circle, slices.of_circles)
    if best is None:
        raise ValueError(f"no circle {NO_FACTOR}")
    # Clay slides as a rigid mass on a circle alone, unless a seam carries it.
    starts = [_vertices(best.points)] if slices.frictional else []
    along = sorted(_along_seams(slices), key=lambda surface: trials.factor(surface, COARSE, "janbu"))
    seams = [(trials.factor(surface, COARSE), surface) for surface in along[:SEAMS]]
    factor, surface = min(seams, key=lambda pair: pair[0], default=(math.inf, None))
    if surface is not None and factor < WORSE * best.factor:
        starts.append(_refined(surface))
    answers = [best, *(slices.slip(_any_shape(trials, start)) for start in starts)]
    least = min((slip for slip in answers if slip is not None), key=lambda slip: slip.factor)
    return Critical(least, best, trials.count)


def _critical_circle(trials: _Trials) -> Circle:
    """The circle of the least factor, from a search over all of the ground; ValueError where none has one."""
    shape = trials.slices.shape
    if not shape.relief > 0:
        raise ValueError(f"no circle {NO_FACTOR}")
    ends = _ends(trials.slices)
    tried = []
    for a, b in combinations(ends, 2):
        if abs(np.diff(shape.heights(np.array([a, b])))[0]) > RISE * shape.relief:
            for sag in SAGS:
                circle = _circle(shape.heights, np.array([a, b]), sag)
                factor = trials.factor(circle, COARSE, "bishop")
                if circle is not None and factor < math.inf:
                    tried.append((factor, circle.z - circle.radius, np.array([a, b, sag])))
    if not tried:
        raise ValueError(f"no circle {NO_FACTOR}")
    # Circles of one depth are a family: the search for the best of one does not lead to another.
    depths = np.linspace(shape.base, shape.base + shape.extent[-1], BANDS + 1)[:-1]
    families: dict[int, tuple[float, np.ndarray]] = {}
    for factor, depth, numbers in sorted(tried, key=lambda each: each[0]):
        families.setdefault(int(np.searchsorted(depths, depth)), (factor, numbers))
    starts = [numbers for factor, numbers in families.values() if factor < NEAR * min(tried, key=lambda t: t[0])[0]]
    polished = partial(_polished, trials)
    factor, best = min((polished(start, 0.5, EVALUATIONS, "bishop") for start in starts[:FAMILIES]), key=lambda p: p[0])
    if factor == math.inf:
        raise ValueError(f"no circle {NO_FACTOR}")
    if trials.slices.frictional:  # on clay alone both methods agree
        best = min((factor, best), polished(best, 0.15, EVALUATIONS // 2, "spencer"), key=lambda p: p[0])[1]
    circle = _circle(shape.heights, best[:2], best[2])
    assert circle is not None
    return circle


def _polished(
    trials: _Trials, start: np.ndarray, step: float, evaluations: int, method: Literal["bishop", "spencer"]
) -> tuple[float, np.ndarray]:
    """The least factor by Spencer's method of a circle near the start, and its ends (m) and sag.

    step: of the ends, over the height of the ground. method: of the search.
    """
    heights, first = trials.slices.shape.heights, step * trials.slices.shape.relief

    def factor(at: np.ndarray) -> float:
        return min(trials.factor(_circle(heights, at[:2], at[2]), MIDDLE, method), BEYOND)

    corners = start + np.array([(0, 0, 0), (-first, 0, 0), (0, first, 0), (0, 0, 0.16 * step)])
    answer = minimize(
        factor, start, method="Nelder-Mead",
        options={"initial_simplex": corners, "maxfev": evaluations, "xatol": 1e-3 * first, "fatol": 2e-4},
    )  # fmt: skip
    circle = _circle(heights, answer.x[:2], answer.x[2])
    return trials.factor(circle, MIDDLE, trials.slices.of_circles), answer.x


def _ends(slices: Slices) -> np.ndarray:
    """Points x (m) of the surface, denser where it falls, and on the level ground beside."""
    left, right = slices.shape.outline().walls
    x = np.linspace(left, right, 2001)
    z = slices.shape.heights(x)
    steep = np.abs(np.diff(z)) / np.diff(x)
    # Level ground is denser near a slope, from which no surface ends far.
    middle = (x[1:] + x[:-1]) / 2
    falls = middle[steep > 0.5 * steep.max()]
    distance = np.abs(middle[:, None] - falls[:: max(1, len(falls) // 50)]).min(axis=1)
    density = np.maximum(steep / max(steep.max(), 1e-9), LEVEL * 4 / (1 + (distance / slices.shape.relief) ** 2))
    total = np.r_[0, np.cumsum(density)]
    return np.interp(np.linspace(0, total[-1], ENDS + 2)[1:-1], total, x)


def _circle(heights: Callable[[np.ndarray], np.ndarray], ends: np.ndarray, sag: float) -> Circle | None:
    """The circle through two points of the surface whose distance from their chord is `sag` of its length."""
    if not ends[0] < ends[1] or not 0.01 < sag < 0.9:
        return None
    first, last = (np.array([x, z]) for x, z in zip(ends, heights(ends), strict=True))
    chord = last - first
    length = float(np.hypot(*chord))
    radius = length * (1 / (8 * sag) + sag / 2)
    up = np.array([-chord[1], chord[0]]) / length
    centre = (first + last) / 2 + up * (radius - sag * length)
    return Circle(float(centre[0]), float(centre[1]), radius)


def _vertices(points: np.ndarray) -> np.ndarray:
    """Vertices (n, 2) m of a surface, evenly along it."""
    along = np.r_[0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    at = np.linspace(0, along[-1], VERTICES)
    return np.stack([np.interp(at, along, coordinate) for coordinate in points.T], axis=1)


def _refined(points: np.ndarray) -> np.ndarray:
    """The same surface of straight parts with vertices between, in the longest parts."""
    while len(points) < VERTICES:
        longest = int(np.argmax(np.hypot(*np.diff(points, axis=0).T)))
        points = np.insert(points, longest + 1, points[longest : longest + 2].mean(axis=0), axis=0)
    return points


def _along_seams(slices: Slices) -> Iterator[np.ndarray]:
    """Surfaces (4, 2) m that follow a seam, or a joint at the base, and leave it by a wedge at both ends."""
    shape = slices.shape
    for seam in slices.seams:
        knees = np.linspace(seam[0, 0], seam[-1, 0], KNEES)
        z = np.interp(knees, *seam.T)
        for a, b in combinations(range(KNEES), 2):
            falls = shape.heights(knees[[a]])[0] >= shape.heights(knees[[b]])[0]
            angles = (ACTIVE, PASSIVE) if falls else (PASSIVE, ACTIVE)
            start = _daylight(slices, knees[a], z[a], -1 / math.tan(angles[0]))
            end = _daylight(slices, knees[b], z[b], 1 / math.tan(angles[1]))
            if start is not None and end is not None:
                yield np.array([start, (knees[a], z[a]), (knees[b], z[b]), end])


def _daylight(slices: Slices, x: float, z: float, run: float) -> tuple[float, float] | None:
    """Where a line from a point (m) upwards, with so much run per rise, meets the ground; None beyond its walls."""
    top = slices.shape.corner[-1] + slices.shape.extent[-1]
    up = np.linspace(0, 2 * (top - z), 401)
    along = x + run * up
    left, right = slices.shape.outline().walls
    out = np.flatnonzero(z + up >= slices.shape.heights(along))
    if not out.size or not left < along[out[0]] < right:
        return None
    at = float(along[out[0]])
    return at, float(slices.shape.heights(np.array([at]))[0])


def _any_shape(trials: _Trials, start: np.ndarray) -> np.ndarray:
    """The vertices (n, 2) m of a surface of the least factor near the start, by moving one after the other.

    The ends move along the ground, the others up and down. Source: Rosenbrock (1960), 10.1093/comjnl/3.3.175, along
    fixed axes.
    """
    shape = trials.slices.shape
    left, right = shape.outline().walls
    fractions = (start[:, 0] - start[0, 0]) / (start[-1, 0] - start[0, 0])
    numbers = np.r_[start[0, 0], start[1:-1, 1], start[-1, 0]]

    def surface(at: np.ndarray) -> np.ndarray | None:
        if not left <= at[0] < at[-1] <= right:
            return None
        x = at[0] + fractions * (at[-1] - at[0])
        ground = shape.heights(x)
        z = np.r_[ground[0], at[1:-1], ground[-1]]
        angles = np.arctan2(np.diff(z), np.diff(x))
        inside = (z[1:-1] < ground[1:-1]).all() and (z >= shape.base).all()
        smooth = (np.abs(angles) < STEEPEST).all() and (np.diff(angles) > -HOLLOW).all()
        return np.stack([x, z], axis=1) if inside and smooth else None

    least = trials.factor(surface(numbers), MIDDLE)
    steps = np.full(numbers.size, STEP * shape.relief)
    for _ in range(SWEEPS):
        for k in range(numbers.size):
            changed = numbers.copy()
            changed[k] += steps[k]
            factor = trials.factor(surface(changed), MIDDLE)
            better = factor < least
            steps[k] *= GROWN if better else SHRUNK
            if better:
                numbers, least = changed, factor
    answer = surface(numbers)
    return start if answer is None else answer
