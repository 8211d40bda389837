"""The critical slip surface of a section: circles over all of it, then surfaces of any shape.

Every step of the search computes a set of surfaces at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from cooperative.tools.safety._slices import Circle, Method, Slices, Slip, Surfaces

ENDS = 28
"""Points of the ground at which circles of the first search begin and end."""
LEVEL = 0.15
"""Share of these points' density that level ground has, over that of a vertical face."""
SAGS = (0.03, 0.06, 0.1, 0.15, 0.21, 0.28, 0.36, 0.45)
"""Of these circles: largest distance from their chord, over its length."""
RISE = 0.2
"""Least difference of height of their ends, over that of the ground."""
COARSE = 24
"""Slices of a surface in the first search; later ones have as many as the answer, whose factor is theirs."""
BANDS = 6
"""Parts of the ground's height by which circles are a family, in each of which the critical circle is looked for."""
VERTICES = 9
"""Of a surface of any shape."""
ROUNDS = 45
"""Steps towards a critical surface."""
PULLED = 0.95
"""Factor of a circle with more of its base in tension, over that of the admissible one, below which it decides."""
TURNS = 2
"""Times that a surface of any shape is sought anew, from the best one found."""
GROWN, SHRUNK = 1.3, 0.6
"""Factors on the size of a step after a better surface, and after none."""
STEEPEST, HOLLOW = math.radians(70.0), math.radians(0.5)
"""Largest angle of a surface to the horizontal, and largest turn of it downwards, on which no rigid mass slides."""
KNEES = 17
"""Points of a seam at which surfaces that follow it begin and end to do so."""
ACTIVE, PASSIVE = np.radians([45.0, 55.0, 65.0]), np.radians([20.0, 30.0, 40.0])
"""Angles at which such a surface leaves a seam, upwards and downwards of it."""
LEAST_PART = 0.01
"""Least width of a straight part of a surface, over that of the surface."""
RAY = 400
"""Points at which a line from a seam is held against the ground."""
STARTS = 2
"""Surfaces along seams from which the search for one of any shape goes on."""
NO_FACTOR = "has a factor of safety by limit equilibrium: is the ground level, or all of it rock?"

Factors = Callable[[np.ndarray], np.ndarray]
"""Factors of safety (n,) of surfaces of such numbers (n, numbers)."""


@dataclass(frozen=True)
class Critical:
    """Critical slip surfaces of a section.

    Args:
        slip: that of the least factor of safety, of any shape.
        circle: the critical circle; None where no circle has a factor.
        surfaces: number of surfaces that were tried.
    """

    slip: Slip
    circle: Slip | None
    surfaces: int


@dataclass
class _Trials:
    """Surfaces that were tried."""

    slices: Slices
    count: int = field(default=0)

    def circles(self, numbers: np.ndarray, method: Method, slices: int) -> np.ndarray:
        """Factors (n,) of circles by their ends along the ground (m) and sag (n, 3)."""
        return self._of(numbers, method, slices, lambda some, cut: _circles(cut, some)[:2])

    def along(self, numbers: np.ndarray, seam: np.ndarray, method: Method, slices: int) -> np.ndarray:
        """Factors (n,) of surfaces along a seam by where they leave it (m), and their angles there (n, 4)."""
        return self._of(numbers, method, slices, lambda some, cut: _along(cut, seam, some))

    def shapes(self, numbers: np.ndarray, method: Method, slices: int) -> np.ndarray:
        """Factors (n,) of surfaces by their ends along the ground and vertices between, as `_shapes` takes them."""
        return self._of(numbers, method, slices, lambda some, cut: _shapes(cut, some))

    def _of(
        self,
        numbers: np.ndarray,
        method: Method,
        slices: int,
        surfaces: Callable[[np.ndarray, Slices], tuple[Surfaces, np.ndarray]],
    ) -> np.ndarray:
        self.count += len(numbers)
        cut = self.slices if slices == self.slices.slices else replace(self.slices, slices=slices)
        made, there = surfaces(numbers, cut)
        return np.where(there, cut.factors(_only(made, there), method), math.inf)


def _only(surfaces: Surfaces, there: np.ndarray) -> Surfaces:
    """Surfaces, of which those that are none are points."""
    return replace(surfaces, x=np.where(there[:, None], surfaces.x, 0.0), z=np.where(there[:, None], surfaces.z, 0.0))


def critical_surface(slices: Slices) -> Critical:
    """The critical circle of a section, and the critical surface of any shape.

    A mirror image has the same. Spencer's method gives the factors; where it has no admissible answer, Bishop's does
    for circles and Janbu's for surfaces along a seam.

    Args:
        slices: the section.

    Returns:
        Both.

    Raises:
        ValueError: no surface has a factor of safety.
    """
    middle = (slices.x[0] + slices.x[-1]) / 2
    # One of both images is searched: that with more ground on the left.
    if np.trapezoid((slices.heights[0] - slices.floor) * (slices.x - middle), slices.x) > 0:
        found = critical_surface_of(slices.mirrored())
        circle = None if found.circle is None else found.circle.mirrored()
        slip = circle if circle is not None and found.slip is found.circle else found.slip.mirrored()
        return Critical(slip, circle, found.surfaces)
    return critical_surface_of(slices)


def critical_surface_of(slices: Slices) -> Critical:
    """As `critical_surface`, of this image."""
    trials = _Trials(slices)
    if not slices.relief > 0:
        raise ValueError(f"no surface {NO_FACTOR}")
    circle = _critical_circle(trials)
    if slices.frictional:
        others = _Trials(replace(slices, tension=1.0))
        pulled = _critical_circle(others)
        trials.count += others.count
        if pulled is not None and (circle is None or pulled.factor < PULLED * circle.factor):
            circle = replace(pulled, pulled=True)
    starts, seams = [], []
    # Clay slides as a rigid mass on a circle alone, unless a seam carries it.
    if circle is not None and slices.frictional:
        starts.append(_evenly(circle.points))
    for seam in slices.seams:
        found = _critical_along(trials, seam)
        if found is not None:
            seams.append(found)
    seams.sort(key=lambda found: found[0].factor)
    starts += [_refined(vertices) for slip, vertices in seams[:STARTS] if slip.method == "spencer"]
    shapes = (_any_shape(trials, start) for start in starts)
    answers = [slip for slip in (circle, *(slip for slip, _ in seams), *shapes) if slip is not None]
    if not answers:
        raise ValueError(f"no surface {NO_FACTOR}")
    # Janbu's level forces between slices understate the factor: his stands for a seam without another answer.
    rigorous = [slip for slip in answers if slip.method != "janbu"]
    slip = min(rigorous or answers, key=lambda slip: slip.factor)
    return Critical(slip, circle, trials.count)


def first_circles(slices: Slices) -> np.ndarray:
    """The circles over all of the ground from which the search for the critical one begins.

    Args:
        slices: the section.

    Returns:
        Ends along the ground (m) and sag of each (n, 3).
    """
    ends, along = _ends(slices), slices.along
    height = np.interp(ends, along, slices.heights[0])
    first, last = np.triu_indices(ENDS, 1)
    pairs = np.abs(height[first] - height[last]) > RISE * slices.relief
    first, last = ends[first[pairs]], ends[last[pairs]]
    return np.stack([np.repeat(first, len(SAGS)), np.repeat(last, len(SAGS)), np.tile(SAGS, len(first))], axis=1)


def factors_of_circles(slices: Slices, numbers: np.ndarray) -> np.ndarray:
    """Factors of safety (n,) of such circles by Bishop's method in COARSE slices; infinite where one has none.

    Args:
        slices: the section.
        numbers: of the circles, as `first_circles` gives them (n, 3).
    """
    return _Trials(slices).circles(numbers, "bishop", COARSE)


def _critical_circle(trials: _Trials) -> Slip | None:
    """The circle of the least factor, from a search over all of the ground; None where none has one."""
    slices, relief = trials.slices, trials.slices.relief
    tried = first_circles(slices)
    factors = trials.circles(tried, "bishop", COARSE)
    if not np.isfinite(factors).any():
        return None
    # Circles of one depth are a family: the search for the best of one does not lead to another.
    surfaces, *_ = _circles(replace(slices, slices=COARSE), tried)
    depth = np.maximum(surfaces.z, slices.rigid(surfaces.x)).min(axis=1)
    bottom = slices.floor.min()
    family = np.clip(((depth - bottom) / (slices.heights[0].max() - bottom) * BANDS).astype(int), 0, BANDS - 1)
    order = np.argsort(factors)
    best = [
        next((k for k in order if family[k] == number and np.isfinite(factors[k])), None) for number in range(BANDS)
    ]
    starts = tried[[k for k in best if k is not None]]
    steps = np.array([0.25 * relief, 0.25 * relief, 0.05])

    def polished(starts: np.ndarray, steps: np.ndarray, method: Method) -> tuple[np.ndarray, np.ndarray]:
        return _descend(lambda numbers: trials.circles(numbers, method, slices.slices), starts, steps)

    starts, _ = polished(starts, steps, "bishop")
    methods: list[Method] = ["bishop"]
    if slices.frictional:  # in clay alone the moments give Spencer's factor
        methods = ["spencer", "bishop"]
        rigorous, values = polished(starts, steps / 4, "spencer")
        starts = np.where(np.isfinite(values)[:, None], rigorous, starts)
    found = [slip for start in starts if (slip := _circle_of(trials, start, methods)) is not None]
    return min(found, key=lambda slip: slip.factor, default=None)


def _circle_of(trials: _Trials, numbers: np.ndarray, methods: list[Method]) -> Slip | None:
    """A circle's factor by the first of these methods that has one."""
    surfaces, there, radii = _circles(trials.slices, numbers[None])
    assert surfaces.centres is not None
    for method in methods:
        [slip] = trials.slices.slips(_only(surfaces, there), method)
        if slip is not None:
            x, z = surfaces.centres[0].tolist()
            return replace(slip, circle=Circle(x, z, float(radii[0])))
    return None


def _descend(factors: Factors, starts: np.ndarray, steps: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (n, d) of least factors near starts (n, d), and these factors (n,), each start for itself.

    Every round tries a step both ways along each number, and in directions that are drawn anew, then goes further where
    that was better. A start without a factor stays. steps: (d,) the first. seed: of the directions.
    """
    rng = np.random.default_rng(seed)
    count, size = starts.shape
    at, least = starts.copy(), factors(starts)
    step = np.ones(count)
    axes = np.concatenate([np.eye(size), -np.eye(size)])
    for _ in range(ROUNDS):
        normal = rng.normal(size=(size, size)) / math.sqrt(size)
        moves = np.concatenate([axes, normal, -normal]) * steps
        tried = at[:, None] + step[:, None, None] * moves
        values = factors(tried.reshape(-1, size)).reshape(count, -1)
        best = values.argmin(axis=1)
        # All single steps that were better, together.
        better = np.where((values < least[:, None])[:, :, None], tried - at[:, None], 0)[:, : 2 * size].sum(axis=1)
        single = np.take_along_axis(tried, best[:, None, None], 1)[:, 0]
        more = np.concatenate([at + better, at + 2 * (single - at)])
        values = np.stack([values.min(axis=1), *factors(more).reshape(2, count)])
        choices = np.stack([single, *more.reshape(2, count, size)])
        best, improved = values.argmin(axis=0), values.min(axis=0) < least
        at = np.where(improved[:, None], choices[best, np.arange(count)], at)
        least = np.minimum(least, values.min(axis=0))
        step *= np.where(improved, GROWN, SHRUNK)
        if (step < 1e-3).all():
            break
    return at, least


def _on_ground(slices: Slices, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X and z (...) m of points so far along the ground (...) m."""
    return np.interp(along, slices.along, slices.x), np.interp(along, slices.along, slices.heights[0])


def _ends(slices: Slices) -> np.ndarray:
    """Points (n,) m along the ground, denser where it falls, and on the level ground beside."""
    arc = slices.along
    along = np.linspace(0, arc[-1], 4001)
    x, z = _on_ground(slices, along)
    steep = np.abs(np.diff(z)) / np.diff(along)
    # Level ground is denser near a slope, from which no surface ends far.
    middle = (x[1:] + x[:-1]) / 2
    falls = middle[steep > 0.5 * steep.max()]
    distance = np.abs(middle[:, None] - falls[:: max(1, len(falls) // 50)]).min(axis=1)
    density = np.maximum(steep / max(steep.max(), 1e-9), LEVEL * 4 / (1 + (distance / slices.relief) ** 2))
    total = np.r_[0, np.cumsum(density)]
    return np.interp(np.linspace(0, total[-1], ENDS + 2)[1:-1], total, along)


def _circles(slices: Slices, numbers: np.ndarray) -> tuple[Surfaces, np.ndarray, np.ndarray]:
    """Surfaces on circles, whether each is one, and their radii (n,) m.

    numbers: ends along the ground (m), and the distance of the circle from their chord over its length (n, 3).
    """
    (first, last), sag = numbers[:, :2].T, np.clip(numbers[:, 2], 1e-3, 0.9)
    (x0, z0), (x1, z1) = _on_ground(slices, first), _on_ground(slices, last)
    arc = slices.along[-1]
    there = (first >= 0) & (last <= arc) & (x1 > x0 + ROUNDING_OF_ENDS) & (numbers[:, 2] > 0.01) & (numbers[:, 2] < 0.9)
    x1 = np.maximum(x1, x0 + ROUNDING_OF_ENDS)
    length = np.hypot(x1 - x0, z1 - z0)
    radius = length * (1 / (8 * sag) + sag / 2)
    up = (radius - sag * length) / length
    centres = np.stack([(x0 + x1) / 2 - up * (z1 - z0), (z0 + z1) / 2 + up * (x1 - x0)], axis=1)
    # An end above the centre would lie on the upper half of the circle.
    there &= np.maximum(z0, z1) <= centres[:, 1]
    return slices.circles(np.stack([x0, x1], axis=1), centres, radius), there, radius


ROUNDING_OF_ENDS = 1e-3
"""Least distance of the ends of a surface (m)."""


def _evenly(points: np.ndarray) -> np.ndarray:
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


def _critical_along(trials: _Trials, seam: np.ndarray) -> tuple[Slip, np.ndarray] | None:
    """The surface of least factor that follows a seam and leaves it by a wedge at both ends, and its vertices (n, 2) m.

    None where none has a factor.
    """
    slices = trials.slices
    knees = np.linspace(seam[0, 0], seam[-1, 0], KNEES)
    a, b = (knees[pair] for pair in np.triu_indices(KNEES, 1))
    falls = slices.ground(a) >= slices.ground(b)
    angles = np.array([(active, passive) for active in ACTIVE for passive in PASSIVE])
    up, down = (np.tile(array, len(a)) for array in angles.T)
    a, b, falls = (np.repeat(array, len(angles)) for array in (a, b, falls))
    numbers = np.stack([a, b, np.where(falls, up, down), np.where(falls, down, up)], axis=1)
    apart = (seam[-1, 0] - seam[0, 0]) / KNEES
    steps = np.array([apart / 2, apart / 2, 0.1, 0.1])
    methods: tuple[Method, ...] = ("spencer", "janbu")
    for method in methods:
        factors = trials.along(numbers, seam, method, COARSE)
        order = np.argsort(factors)[:STARTS]
        starts = numbers[order[np.isfinite(factors[order])]]
        if not len(starts):
            continue
        at, values = _descend(partial(trials.along, seam=seam, method=method, slices=slices.slices), starts, steps)
        best = at[[values.argmin()]]
        surfaces, there = _along(slices, seam, best)
        [slip] = slices.slips(_only(surfaces, there), method)
        if slip is not None:
            leaves = best[0, :2]
            return slip, np.concatenate(
                [slip.points[:1], np.stack([leaves, np.interp(leaves, *seam.T)], axis=1), slip.points[-1:]]
            )
    return None


def _along(slices: Slices, seam: np.ndarray, numbers: np.ndarray) -> tuple[Surfaces, np.ndarray]:
    """Surfaces that follow a seam between two points, and beyond them rise to the ground at two angles.

    numbers: x of these points (m), and the angles (n, 4). Returns the surfaces, and whether each is one.
    """
    a, b, left, right = numbers.T
    there = (a >= seam[0, 0]) & (b <= seam[-1, 0]) & (a < b)
    there &= (np.minimum(left, right) > 0) & (np.maximum(left, right) < STEEPEST)
    left, right = np.clip(left, 0.01, STEEPEST), np.clip(right, 0.01, STEEPEST)
    first = _daylight(slices, seam, a, -1 / np.tan(left))
    last = _daylight(slices, seam, b, 1 / np.tan(right))
    there &= np.isfinite(first) & np.isfinite(last)
    x = slices.edges(np.where(there, first, 0), np.where(there, last, 1), numbers[:, :2])
    line = np.interp(x, *seam.T)
    # Below rigid ground a surface follows that.
    z = np.where(line <= slices.rigid(x) + ROUNDING_OF_ENDS, slices.heights[-1].min() - slices.relief, line)
    for knee, angle, side in ((a, left, -1), (b, right, 1)):
        away = side * (x - knee[:, None])
        wedge = np.interp(knee, *seam.T)[:, None] + np.tan(angle)[:, None] * away
        z = np.where(away >= 0, np.maximum(wedge, z), z)
    return Surfaces(x, np.minimum(z, slices.ground(x))), there


def _daylight(slices: Slices, seam: np.ndarray, x: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Where lines from a seam upwards, with so much run per rise, meet the ground (n,) m; nan beyond its ends."""
    z = np.interp(x, *seam.T)[:, None]
    rise = (slices.heights[0].max() - z + 1e-3 * slices.relief) * np.linspace(0, 1, RAY)
    at = x[:, None] + run[:, None] * rise
    above = z + rise - slices.ground(at)
    out = np.maximum((above >= 0).argmax(axis=1), 1)
    rows = np.arange(len(x))
    before, after = above[rows, out - 1], above[rows, out]
    share = np.clip(before / np.where(before == after, 1, before - after), 0, 1)
    met = at[rows, out - 1] + share * (at[rows, out] - at[rows, out - 1])
    inside = (above >= 0).any(axis=1) & (met > slices.x[0]) & (met < slices.x[-1])
    return np.where(inside, met, np.nan)


def _any_shape(trials: _Trials, start: np.ndarray) -> Slip | None:
    """The surface of the least factor near a start of vertices (n, 2) m, by Spencer's method; None without one.

    The ends move along the ground, the vertices between them both ways, and no surface goes below the floor.
    """
    slices = trials.slices
    arc, span = slices.along, start[-1, 0] - start[0, 0]
    ends = np.interp(start[[0, -1], 0], slices.x, arc)
    numbers = np.concatenate([ends, start[1:-1, 1], (start[1:-1, 0] - start[0, 0]) / span])
    heights = np.full(len(start), 0.06 * slices.relief)
    steps = np.concatenate([heights, np.full(len(start) - 2, 0.2 / len(start))])
    at = numbers[None]
    for turn in range(TURNS):
        at, _ = _descend(partial(trials.shapes, method="spencer", slices=slices.slices), at, steps, seed=turn)
    surfaces, there = _shapes(slices, at)
    return slices.slips(_only(surfaces, there), "spencer")[0]


def _shapes(slices: Slices, numbers: np.ndarray) -> tuple[Surfaces, np.ndarray]:
    """Surfaces of straight parts, and whether each is one.

    numbers: ends along the ground (m), heights of the vertices between (m), and parts of the span at which they are
    (n, 2 vertices - 2).
    """
    inner = numbers.shape[1] // 2 - 1
    (x0, z0), (x1, z1) = _on_ground(slices, numbers[:, 0]), _on_ground(slices, numbers[:, 1])
    there = (numbers[:, 0] >= 0) & (numbers[:, 1] <= slices.along[-1]) & (x1 > x0 + ROUNDING_OF_ENDS)
    shares = numbers[:, 2 + inner :]
    there &= (np.diff(shares, axis=1, prepend=0, append=1) > LEAST_PART).all(axis=1)
    shares = np.where(there[:, None], shares, np.linspace(0, 1, inner + 2)[1:-1])
    between = x0[:, None] + shares * np.where(there, x1 - x0, 1.0)[:, None]
    x = np.concatenate([x0[:, None], between, np.where(there, x1, x0 + 1.0)[:, None]], axis=1)
    z = np.concatenate([z0[:, None], numbers[:, 2 : 2 + inner], z1[:, None]], axis=1)
    angles = np.arctan2(np.diff(z), np.diff(x))
    there &= (z[:, 1:-1] < slices.ground(between)).all(axis=1) & (np.abs(angles) < STEEPEST).all(axis=1)
    there &= (np.diff(angles) > -HOLLOW).all(axis=1)
    z = np.maximum(z, slices.rigid(x))
    edges = slices.edges(x[:, 0], x[:, -1], between)
    slopes = np.diff(z) / np.diff(x)
    line = z[:, :1] + slopes[:, :1] * (edges - x[:, :1])
    for k in range(1, slopes.shape[1]):
        line += (slopes[:, k] - slopes[:, k - 1])[:, None] * np.maximum(edges - x[:, k : k + 1], 0)
    return Surfaces(edges, line), there
