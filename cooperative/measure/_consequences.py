"""What a landslide does: displacement, sliding depth, run-out, volume and area, from one final state.

The five measures are those of Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413. The
paper names them without formulae; the definitions used here are in `Consequences`. They integrate or take
edges of particle domains, not counts of particles, so that they do not depend on the sampling density.

A few grains that have come off the mass do not decide how far it went: clay has no friction, and a lone particle hovers
up to a cell above the ground, where its pressure grows as the overlap with the ground's nodes shrinks and its shear
stress cannot, so that it glides on for ever.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import shapely

from cooperative.measure._track import Track
from jaxmpm import Face
from jaxmpm.support.values import by_value

MEASURES = ("displacement", "depth", "runout", "volume", "area")
"""The five of the paper, by the names that they have in `Consequences`."""
EDGE = "the edge of the polygon"
"""What a slide reached that came to the cut around its ground."""

THICKNESSES = 3.0
"""Mean thicknesses of the ground that limit the size of a slope: a slide in thin soil is no deeper than the soil."""
FRONT_SHARE = 0.1
"""Thickness of the deposit at the front of the run-out, over that size."""

SMALLEST_SHARE = 0.01
"""Share of the sliding volume from which on soil that came off the rest is a mass of its own."""


@by_value
@dataclass(frozen=True)
class OpenGround:
    """Ground without a crest and a toe, a section or a terrain.

    Args:
        surface: height of its surface above each particle before the slide (N,) m.
        track: along which the run-out is measured, None for along the slide.
    """

    surface: np.ndarray
    track: Track | None = None


@dataclass(frozen=True)
class Consequences:
    """Consequences of one sample.

    The sliding soil is all that is displaced by `failure_displacement` or more, the sliding mass all of it but detached
    grains, see `consequences`.

    Args:
        displacement: R_d (m), the largest displacement of a particle of the sliding mass, of any where nothing slides;
            with a least volume that which so much soil has exceeded.
        depth: H (m), from crest level down to the deepest point of the sliding soil before it slid. Measured from the
            crest, it exceeds the slope height exactly if the slip surface passes below the toe. On `OpenGround`, from
            the surface above it, where that is most. At least 0: a particle may stick out of the surface that is
            interpolated between points.
        runout: L (m), horizontally from the toe to the front of the sliding mass, where it is `runout_thickness` thick;
            0 if it stays behind the toe or is nowhere so thick. On
            `OpenGround`, from the rear of the mass before it slid to its front after, along its mean displacement: the
            travel distance of Corominas (1996), Canadian Geotechnical Journal 33, 260-271. Where the ground has a
            track, along that instead, whichever way the mass went.
        volume: V, of the sliding soil (m3), in a section (m2), that is m3 per metre of width.
        area: S, plan area beyond the toe that the sliding mass overruns (m2): the run-out of each slice across the
            slope, times its width, summed. In a section (m), that is m2 per metre of width, it equals the run-out. On
            `OpenGround`, plan area of the mass at its end.
        displacement_any: largest displacement with detached grains (m).
        runout_foremost: run-out of the foremost soil of the mass, however thin (m).
        runout_any: run-out with detached grains (m).
    """

    displacement: float
    depth: float
    runout: float
    volume: float
    area: float
    displacement_any: float
    runout_foremost: float
    runout_any: float

    def as_row(self) -> dict[str, float]:
        """The measures by name, for a table row."""
        return asdict(self)


def size_of_slope(height: float, thickness: float) -> float:
    """Size of a slope (m), to which the sizes of its slides are compared.

    Args:
        height: of the slope, or the relief of ground without a toe (m).
        thickness: mean of the ground (m).
    """
    return min(height, THICKNESSES * thickness)


def front_thickness(size: float) -> float:
    """Thickness of the deposit (m) at the front of a run-out, where a user gives none.

    Args:
        size: of the slope (m), see `size_of_slope`.
    """
    return float(f"{FRONT_SHARE * size:.3g}")


def consequences(
    position: np.ndarray,
    displacement: np.ndarray,
    volume: np.ndarray,
    geometry: Face | OpenGround,
    *,
    half_size: np.ndarray,
    slice_width: float = 0.5,
    failure_displacement: float = 1.0,
    reach: float | None = None,
    least_volume: float | None = None,
    runout_thickness: float | None = None,
) -> Consequences:
    """Consequences of one final state.

    Args:
        position: initial particle positions (d, N) m, rows (x, y, z) or, in a section, (x, z).
        displacement: from there to the final state (d, N) m.
        volume: initial particle volumes (N,) m3; in a section per metre of width (m2).
        geometry: of the slope, or ground without a toe.
        half_size: half the initial particle spacing (d,) m. Edges of particle domains count rather than their centres,
            so that the answer is the same for finer sampling.
        slice_width: width of the slices across the slope in 3D (m); the area is that much too wide at most.
        failure_displacement: displacement from which soil counts as sliding (m); 1 m in the paper.
        reach: distance of two particles up to which they hang together (m). Sliding soil that hangs together with less
            than a hundredth of the sliding volume is detached grains. None counts none as detached.
        least_volume: of the soil whose displacement is measured (m3; in a section m2), see `exceeded`.
        runout_thickness: thickness of the deposit at the front of the run-out (m), the mean over two particles' width;
            0 for the foremost soil, None for a tenth of the slope's height, or of three mean thicknesses of the ground
            where that is less.

    Raises:
        ValueError: shapes do not fit, values are not finite, lengths are not positive.
    """
    position, displacement, volume, half = checked(position, displacement, volume, half_size)
    lengths = {"slice_width": slice_width, "failure_displacement": failure_displacement, "reach": reach}
    for name, value in lengths.items():
        if value is not None and not value > 0:
            raise ValueError(f"{name} = {value} is not positive: give metres above 0")
    if runout_thickness is None:
        runout_thickness = front_thickness(_size(position, volume, geometry, half))
    if not 0 <= runout_thickness < np.inf:
        raise ValueError(f"runout_thickness = {runout_thickness}: give metres from 0 on")
    if isinstance(geometry, OpenGround) and geometry.track is not None and len(position) != 3:
        raise ValueError("a track is a line in plan, for ground in 3D: leave it out in a section")

    magnitude = np.linalg.norm(displacement, axis=0)
    sliding = magnitude >= failure_displacement
    largest, exceeding = float(magnitude.max()), exceeded(magnitude, volume, least_volume)
    if not sliding.any():
        return Consequences(exceeding, 0.0, 0.0, 0.0, 0.0, largest, 0.0, 0.0)

    before, now, mass = _mass(position, displacement, volume, sliding, reach)
    if isinstance(geometry, Face):
        depth = geometry.crest_z - (before[-1].min() - half[-1])
        beyond = np.maximum(geometry.beyond(now[0]) + half[0], 0.0)
    else:
        depth = (geometry.surface[sliding] - before[-1]).max() + half[-1]
        beyond = np.maximum(_travelled(before, now, volume[sliding], mass, half, geometry.track), 0.0)
    if len(position) == 2:
        area = beyond[mass].max()
    elif isinstance(geometry, Face):
        area = _swept_area(now[1, mass], half[1], beyond[mass], slice_width)
    else:
        area = _covered(now[:, mass], half)
    deposit = beyond[mass & (_thickness(now, volume[sliding] * mass, half) >= runout_thickness)]
    return Consequences(
        displacement=float(magnitude[sliding][mass].max()) if least_volume is None else exceeding,
        depth=max(float(depth), 0.0),
        runout=float(deposit.max(initial=0.0)),
        volume=float(volume[sliding].sum()),
        area=float(area),
        displacement_any=largest,
        runout_foremost=float(beyond[mass].max()),
        runout_any=float(beyond.max()),
    )


def _size(position: np.ndarray, volume: np.ndarray, geometry: Face | OpenGround, half: np.ndarray) -> float:
    """Size of a slope (m), from its particles."""
    edges = 2 * half[:-1]
    plan = position[:-1] - position[:-1].min(axis=1, keepdims=True)
    columns = np.unique(np.rint(plan / edges[:, None]), axis=1).shape[1]
    height = geometry.height if isinstance(geometry, Face) else float(np.ptp(geometry.surface))
    return size_of_slope(height, float(volume.sum() / (columns * edges.prod())))


def exceeded(displacement: np.ndarray, volume: np.ndarray, least_volume: float | None) -> float:
    """Largest displacement that so much of the soil has reached, as `jaxmpm.diagnostics.exceeded_displacement`.

    As `jaxmpm.diagnostics.exceeded_displacement`, bit for bit.

    Args:
        displacement: of each particle (N,) m.
        volume: of each particle (N,).
        least_volume: of soil; None for a single particle.
    """
    if least_volume is None:
        return float(displacement.max())
    order = np.argsort(-displacement, kind="stable")
    last = np.searchsorted(np.cumsum(volume[order], dtype=float), least_volume - volume.min() / 2)
    return float(displacement[order][min(last, displacement.size - 1)])


def walls_reached(
    position: np.ndarray,
    displacement: np.ndarray,
    volume: np.ndarray,
    walls: Sequence[tuple[int, int, float]],
    *,
    half_size: np.ndarray,
    failure_displacement: float,
    within: float,
    reach: float | None = None,
    polygon: Sequence[Sequence[float]] | None = None,
) -> str:
    """The walls that the sliding mass has come to, or slid from.

    Empty where it reached none.

    Args:
        position: (d, N) m.
        displacement: (d, N) m.
        volume: (N,).
        walls: axis, side (-1 low, 1 high) and coordinate (m) of each.
        half_size: (d,) m.
        failure_displacement: from which soil counts as sliding (m).
        within: distance from a wall that counts as reached (m).
        reach: as for `consequences`.
        polygon: corners in plan (m) of the ground, whose edge is named `EDGE`.

    Returns:
        Their positions, as in "x = 0 m; x = 92 m"; empty where it reached none.
    """
    sliding = np.linalg.norm(displacement, axis=0) >= failure_displacement
    if not sliding.any():
        return ""
    before, now, mass = _mass(position, displacement, volume, sliding, reach)
    reached = []
    for axis, side, at in walls:
        farthest = max((side * where[axis, mass]).max() for where in (before, now)) + half_size[axis]
        if farthest > side * at - within:
            reached.append(f"{'xyz'[axis]} = {at:g} m")
    if polygon is not None:
        edge = shapely.LinearRing(polygon)
        apart = min(shapely.distance(edge, shapely.points(*where[:2, mass])).min() for where in (before, now))
        reached += [EDGE] if apart < within + half_size[:2].max() else []
    return "; ".join(reached)


def _travelled(
    before: np.ndarray, now: np.ndarray, volume: np.ndarray, mass: np.ndarray, half: np.ndarray, track: Track | None
) -> np.ndarray:
    """Distance (n,) m from the rear that the mass had before to the edge of each particle.

    Along the track or, without one, the mean displacement; 0 where that has no direction.
    """
    if track is not None:
        (start, along), (end, ahead) = track.along(before[:2]), track.along(now[:2])
        sign = 1 if ((end - start)[mass] @ volume[mass]) >= 0 else -1
        rear = (sign * start - half[:2] @ np.abs(along))[mass].min()
        return sign * end + half[:2] @ np.abs(ahead) - rear
    level = ((now - before)[:-1, mass] * volume[mass]).sum(axis=1)
    length = np.linalg.norm(level)
    if length == 0:
        return np.zeros(now.shape[1])
    along = level / length
    return along @ now[:-1] - (along @ before[:-1, mass]).min() + 2 * np.abs(along) @ half[:-1]


def _thickness(now: np.ndarray, volume: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Thickness (n,) m of the deposit where each particle lies.

    It is the mean over a square, in a section a length, as wide as two particles before they moved.

    Args:
        now: positions (d, n) m.
        volume: (n,) m3, in a section m2; 0 of soil that does not count.
        half: half the initial spacing (d,) m.
    """
    side = 4 * half[:-1]
    _, place = np.unique(np.floor(now[:-1] / side[:, None]), axis=1, return_inverse=True)
    place = place.ravel()
    return np.bincount(place, volume)[place] / side.prod()


def _covered(now: np.ndarray, half: np.ndarray) -> float:
    """Plan area (m2) of the mass at now (3, n) m.

    It is counted in squares as wide as two particles, so that a mass that has spread has no holes.
    """
    side = 4 * half[:2].max()
    return float(len(np.unique(np.floor(now[:2] / side), axis=1).T) * side**2)


def _mass(
    position: np.ndarray, displacement: np.ndarray, volume: np.ndarray, sliding: np.ndarray, reach: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the sliding soil was and is (d, n) m, and what of it is not detached (n,) bool: at least the largest group.

    Groups are particles joined by chains whose links are at most `reach` long (m). Those with less than SMALLEST_SHARE
    of the volume are detached; none is without a reach.
    """
    before, now = position[:, sliding], (position + displacement)[:, sliding]
    count = now.shape[1]
    if reach is None:
        return before, now, np.ones(count, bool)
    share = np.bincount(group := _joined(now, reach), volume[sliding]) / volume[sliding].sum()
    return before, now, (share >= min(SMALLEST_SHARE, share.max()))[group]


def _joined(points: np.ndarray, reach: float) -> np.ndarray:
    """Number (n,) of the group of each point (d, n) m, joined by chains whose links are at most `reach` long (m).

    Points in boxes that share a face are joined without a look at their distance, which no such pair exceeds: that
    leaves few to search.
    """
    from scipy.sparse import coo_array  # these load what only slides need
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    def components(pairs: np.ndarray, count: int) -> np.ndarray:
        links = coo_array((np.ones(pairs.shape[1], bool), tuple(pairs)), shape=(count, count))
        return connected_components(links, directed=False)[1]

    d = len(points)
    edge = (1 - 1e-9) * reach / math.sqrt(d + 3)  # two boxes side by side have a diagonal of `reach`
    place = np.array([_without_gaps(np.floor(along / edge)) for along in points])
    shape = place.max(axis=1) + 2  # the box behind the last is empty
    boxes, group = np.unique(np.ravel_multi_index(tuple(place), tuple(shape)), return_inverse=True)
    ahead = boxes + np.array([math.prod(shape[axis + 1 :]) for axis in range(d)])[:, None]
    there = np.minimum(np.searchsorted(boxes, ahead), boxes.size - 1)
    _, behind = found = np.nonzero(boxes[there] == ahead)
    group = components(np.stack([behind, there[found]]), boxes.size)[group]
    rest = np.flatnonzero(group != np.bincount(group).argmax())
    if rest.size:
        near = cKDTree(points[:, rest].T).sparse_distance_matrix(cKDTree(points.T), reach, output_type="ndarray")
        group = components(np.stack([group[rest[near["i"]]], group[near["j"]]]), group.max() + 1)[group]
    return group


def _without_gaps(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers (n,) from 0 on, in the same order: those in succession stay so, other gaps become 2."""
    known, place = np.unique(numbers, return_inverse=True)
    return np.cumsum(np.minimum(np.diff(known, prepend=known[0]), 2)).astype(np.int64)[place]


def overlapped_slices(
    y: np.ndarray, half: float, *, origin: float, slice_width: float, slices: int
) -> tuple[np.ndarray, np.ndarray]:
    """First and last slice across the slope that particle domains [y - half, y + half] reach into, two (N,) of int.

    Slice i is [origin + i slice_width, origin + (i + 1) slice_width]. A domain that only touches a slice does not reach
    into it, so that splitting a domain reaches the same slices.
    """
    rounding = 1e-9
    first = np.floor((y - half - origin) / slice_width + rounding).astype(int)
    last = np.ceil((y + half - origin) / slice_width - rounding).astype(int) - 1
    return np.clip(first, 0, slices - 1), np.clip(np.maximum(last, first), 0, slices - 1)


def largest_per_slice(first: np.ndarray, last: np.ndarray, values: np.ndarray, slices: int) -> np.ndarray:
    """Largest of `values` (N,) among the particles that reach into each slice (slices,); 0 where none does."""
    largest = np.zeros(slices)
    for step in range(int((last - first).max(initial=0)) + 1):
        np.maximum.at(largest, np.minimum(first + step, last), values)
    return largest


def _swept_area(y: np.ndarray, half: float, beyond: np.ndarray, slice_width: float) -> float:
    """Sum over slices across y of the largest run-out of any particle domain that reaches into them (m2)."""
    origin = float(np.floor((y.min() - half) / slice_width)) * slice_width
    slices = int(np.ceil((y.max() + half - origin) / slice_width)) + 1
    first, last = overlapped_slices(y, half, origin=origin, slice_width=slice_width, slices=slices)
    return float(largest_per_slice(first, last, beyond, slices).sum() * slice_width)


def checked(*run: np.ndarray) -> list[np.ndarray]:
    """Position, displacement, volume and half_size of a run in double precision.

    Raises:
        ValueError: shapes that do not fit, and numbers that are not finite.
    """
    arrays = [np.asarray(values, dtype=float) for values in run]
    shape = arrays[0].shape
    if len(shape) != 2 or shape[0] not in (2, 3) or shape[1] == 0:
        raise ValueError(f"position has shape {shape}: give (2, N) in a section or (3, N) in 3D, N at least 1")
    names, shapes = ("position", "displacement", "volume", "half_size"), (shape, shape, shape[1:], shape[:1])
    for name, array, expected in zip(names, arrays, shapes, strict=True):
        if array.shape != expected:
            raise ValueError(f"{name} has shape {array.shape}: positions {shape} ask for {expected}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite: pass only samples whose lane did not fail")
    return arrays
