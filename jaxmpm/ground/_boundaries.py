"""Lines of a section: its outline, and the boundaries of its layers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from jaxmpm.ground._base import check_bedrock
from jaxmpm.ground._layer import Layer, Line, check_ends, labels
from jaxmpm.ground._raster import Raster
from jaxmpm.laws import WaterTable
from jaxmpm.setup import RESOLVED, Discretisation, below
from jaxmpm.support import check
from jaxmpm.support.text import shown

Height = Callable[[np.ndarray], np.ndarray]
"""Function that gives heights (n,) m of a line at x (n,) m."""


FOOT = 1e-6
"""Largest distance of a toe from a point of the surface, as a share of the section's length."""


UPRIGHT = 1e-7
"""Largest distance by which an upright face turns back from rounding, as a share of a line's length."""


ON_STEP = 5e-10
"""Distance from an upright step within which a point lies on it, as a share of a line's length; `knots` are farther."""


TOUCHING = 0.01
"""Largest distance of two lines that touch, as a share of a particle's height."""


class Outline(NamedTuple):
    """What bounds a section.

    Args:
        points: of its surface (n, 2) m, x rising.
        walls: x of the left and the right wall (m).
        base: height of the level base (m).
        bedrock: points of the rigid ground above it (n, 2) m; None for none.
    """

    points: np.ndarray
    walls: tuple[float, float]
    base: float
    bedrock: np.ndarray | None = None

    def floor(self, x: np.ndarray) -> np.ndarray:
        """Height (n,) m of rigid ground at x (n,) m: of the bedrock, or of the base."""
        if self.bedrock is None:
            return np.full(np.shape(x), self.base)
        return height_of(self.bedrock, x)

    def heights(self, x: np.ndarray) -> np.ndarray:
        """Height (n,) m of the surface at x (n,) m."""
        return height_of(self.points, x)


def points_of(name: str, line: Line | Raster) -> np.ndarray:
    """The points (n, 2) of a line; ValueError for an invalid one."""
    if isinstance(line, Raster) or np.ndim(line) != 2 or np.shape(line)[0] < 2 or np.shape(line)[1] != 2:
        raise ValueError(f"{name} = {shown(line)}: give two points [x, z] or more")
    points = np.asarray(line, float)
    check.finite(name, points, "m")
    back = np.flatnonzero(-np.diff(points[:, 0]) > UPRIGHT * np.ptp(points[:, 0]))
    if back.size:
        (x0, z0), (x1, z1) = points[back[0] : back[0] + 2]
        raise ValueError(
            f"{name} turns back from ({x0:.10g}, {z0:g}) to ({x1:.10g}, {z1:g}) m: give points with x rising, without "
            "overhang"
        )
    points = np.column_stack([np.maximum.accumulate(points[:, 0]), points[:, 1]])
    # A point drawn twice has no slope.
    return points[np.r_[True, np.diff(points, axis=0).any(axis=1)]]


def height_of(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Heights (n,) m of a line, points (m, 2), at x (n,) m; on an upright step that of its upper end.

    So a line and its mirror image have the same heights, whichever way the step faces.
    """
    along, heights = points.T
    upright, rounding = np.flatnonzero(np.diff(along) == 0), ON_STEP * (along[-1] - along[0])
    result = np.interp(x, along, heights)
    for step in np.unique(along[upright]):
        on_step = np.abs(x - step) <= rounding
        result = np.where(on_step, heights[along == step][[0, -1]].max(), result)
    return result


def between_walls(points: np.ndarray, left: float, right: float) -> np.ndarray:
    """The part (m, 2) of a surface, points (n, 2) m, between walls at x (m); ValueError where it does not reach one."""
    for (x, z), wall, gap in ((points[0], left, points[0, 0] - left), (points[-1], right, right - points[-1, 0])):
        if gap > 0:
            raise ValueError(
                f"the surface ends at ({x:g}, {z:g}) m, {gap:g} m from the wall at x = {wall:g} m: draw it on"
            )
    # Of a vertical face along a wall the end on its inner side.
    x, z = points[::-1][np.unique(points[::-1, 0], return_index=True)[1]].T
    first = (left, np.interp(left, x, z))
    x, z = points[np.unique(points[:, 0], return_index=True)[1]].T
    last = (right, np.interp(right, x, z))
    return np.array([first, *points[(points[:, 0] > left) & (points[:, 0] < right)], last])


def bedrock_of(line: Line | Raster, surface: np.ndarray, walls: tuple[float, float], base: float) -> np.ndarray:
    """Points (n, 2) of bedrock under a surface, points (m, 2), between the walls and above the base (m).

    Raises:
        ValueError: If the line is invalid, ends before a wall, rises above the surface or falls below the base.
    """
    points = points_of("bedrock", line)
    if points[0, 0] > walls[0] or points[-1, 0] < walls[1]:
        raise ValueError(
            f"bedrock goes from ({points[0, 0]:g}, {points[0, 1]:g}) to ({points[-1, 0]:g}, {points[-1, 1]:g}) m: draw "
            f"it to the walls at x = {walls[0]:g} and {walls[1]:g} m"
        )
    x = np.unique(np.r_[points[:, 0], surface[:, 0], walls].clip(*walls))
    check_bedrock(x[None], height_of(points, x), height_of(surface, x), base)
    return points


def foot_of(points: np.ndarray, left: float, toe: float, right: float) -> tuple[float, tuple[Literal[1, -1], ...]]:
    """The foot of a slope at its toe.

    A foot is a point beyond which the surface falls less steeply, along x or against it; one in a valley is that of
    both sides.

    Args:
        points: of the surface (n, 2) m.
        left: wall (m).
        toe: x of the toe (m).
        right: wall (m).

    Returns:
        Elevation (m) of the foot, and the directions along x in which a slope falls to it, 1 or -1.

    Raises:
        ValueError: no foot is there, between the walls.
    """
    check.finite("toe", toe, "m")
    if not left < toe < right:
        raise ValueError(
            f"toe = {toe:g} m lies outside the ground, which reaches from x = {left:g} to {right:g} m: give the x at "
            "which the slope meets the ground before it"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = np.diff(points[:, 1]) / np.diff(points[:, 0])
    inner, before, after = points[1:-1], steep[:-1], steep[1:]
    feet = (before < after) & ((before < 0) | (after > 0)) & (inner[:, 0] > left) & (inner[:, 0] < right)
    inner, before, after = inner[feet], before[feet], after[feet]
    apart = np.abs(inner[:, 0] - toe)
    if not apart.size or apart.min() > FOOT * (right - left):
        there = ", ".join(f"{x:g}" for x in inner[np.argsort(apart)[:4], 0])
        raise ValueError(
            f"toe = {toe:g} m is no foot of a slope, a point of the surface beyond which it falls less steeply: "
            + (f"give x = {there} m" if there else "the surface has none between the walls, leave the toe out")
        )
    at = int(np.argmin(apart))
    sides: dict[Literal[1, -1], bool] = {1: before[at] < 0, -1: after[at] > 0}
    return float(inner[at, 1]), tuple(side for side, falls in sides.items() if falls)


def layering(outline: Outline, layers: Sequence[Layer], discretisation: Discretisation) -> list[Height]:
    """The upper boundaries of the layers, and the base; ValueError for layers too thin for particles."""
    dx, dz = discretisation.spacing
    tops = tops_of(outline, layers, dz)
    left, right = outline.walls
    columns = left + (np.arange(round((right - left) / dx)) + 0.5) * dx
    x = np.r_[left, columns, right]
    _refuse_thin(x, [np.maximum(top(x), outline.floor(x)) for top in tops], dz, labels(layers))
    return tops


def tops_of(outline: Outline, layers: Sequence[Layer], spacing: float) -> list[Height]:
    """The upper boundaries of the layers, and the base.

    Args:
        outline: of the section.
        layers: from the top down.
        spacing: of particles along z (m), a share of which is the largest distance of lines that touch; inf for no
            check.

    Returns:
        Functions of x.

    Raises:
        ValueError: If a line is invalid or crosses another.
    """
    ends = outline.walls
    check_ends(layers)
    tops: list[Height] = [outline.heights]
    x = knots(outline, layers)
    names = labels(layers)
    for number, layer in enumerate(layers[:-1]):
        name = f"bottom of {names[number]}"
        if layer.bottom is not None:
            points = points_of(name, layer.bottom)
            tops.append(_boundary(name, points, tops[-1], ends, touching=TOUCHING * spacing))
        elif layer.depth is not None:
            tops.append(_offset(tops[0], layer.depth))
        elif layer.thickness is not None:
            tops.append(_offset(tops[-1], layer.thickness))
        beyond = tops[-1](x) - tops[-2](x)
        worst = int(np.argmax(beyond))
        if beyond[worst] > TOUCHING * spacing:
            upper = f"the bottom of {names[number - 1]}" if number else "the surface"
            raise ValueError(
                f"the {name} crosses {upper}: at x = {x[worst]:g} m it is {beyond[worst]:g} m higher, at z = "
                f"{tops[-1](x)[worst]:g} m; draw it below, or end it where they meet"
            )
    return [*tops, outline.floor]


def knots(outline: Outline, layers: Sequence[Layer]) -> np.ndarray:
    """Positions x (n,) m just before and just after every point of the surface and of the layers' boundaries."""
    surface, (left, right), _, bedrock = outline
    lines = [
        points_of(f"bottom of {name}", layer.bottom)
        for name, layer in zip(labels(layers), layers, strict=True)
        if layer.bottom is not None
    ]
    if bedrock is not None:
        lines.append(bedrock)
    x = np.unique(np.concatenate([line[:, 0] for line in (surface, *lines)]).clip(left, right))
    step = 1e-9 * (right - left)
    return np.unique(np.concatenate([x - step, x + step]).clip(left, right))


def _offset(line: Height, down: float) -> Height:
    """The line moved down (m)."""
    return lambda x: line(x) - down


def _boundary(name: str, points: np.ndarray, above: Height, ends: tuple[float, float], touching: float) -> Height:
    """A layer's lower boundary; beyond its ends, which touch the one above or reach a wall, it is the one above."""
    for (x, z), short in ((points[0], points[0, 0] > ends[0]), (points[-1], points[-1, 0] < ends[1])):
        height = float(above(np.array([x]))[0])
        if short and abs(height - z) > touching:
            side = "below" if z < height else "above"
            raise ValueError(
                f"the {name} ends at ({x:g}, {z:g}) m, {abs(height - z):g} m {side} the boundary above it: draw it on "
                f"to the walls at x = {ends[0]:g} and {ends[1]:g} m, or to that one, to end its layer"
            )
    return lambda x: np.where((x < points[0, 0]) | (x > points[-1, 0]), above(x), height_of(points, x))


def layer_at(tops: Sequence[Height], position: np.ndarray, spacing: float) -> np.ndarray:
    """Layer of each particle of a section.

    Args:
        tops: of the layers from above, and the lower boundary of the last one; heights (m) over x (m).
        position: of the particles (2, N) m.
        spacing: of the particles along z (m).

    Returns:
        Number of the layer (N,) int, 0 for the uppermost.
    """
    x, z = np.asarray(position, float)
    layer = np.zeros(x.size, int)
    for top in tops[1:-1]:
        layer += below(z, top(x), RESOLVED * spacing)
    return layer


def _refuse_thin(x: np.ndarray, tops: Sequence[np.ndarray], spacing: float, names: Sequence[str]) -> None:
    """Raise ValueError for a layer thinner than a particle, except where it tapers to nothing.

    Args:
        x: of both walls and of the columns of particles between them (m).
        spacing: of particles along z (m).
        tops: heights (n,) m there of the layers' upper boundaries and of the base.
        names: of the layers.
    """
    for name, (top, bottom) in zip(names, pairwise(tops), strict=True):
        thickness = top - bottom
        size = np.where(thickness < spacing * (1 - RESOLVED), np.where(thickness > TOUCHING * spacing, 1, 0), 2)
        ends, size = size[[0, -1]], size[1:-1]
        changes = np.flatnonzero(np.diff(size)) + 1
        kinds = [int(run[0]) for run in np.split(size, changes)]
        # A wall where the layer has tapered to nothing counts as ground without it; another does not.
        beyond = np.where(ends == 0, 0, -1)
        for kind, before, after, start in zip(
            kinds, [beyond[0], *kinds], [*kinds[1:], beyond[1]], [0, *changes.tolist()], strict=False
        ):
            if kind == 1 and {before, after} != {0, 2}:
                at = start + 1
                raise ValueError(
                    f"{name} is {thickness[at]:g} m thick at ({x[at]:g}, {bottom[at]:g}) m, less than "
                    f"a particle of {spacing:g} m: take smaller particles, or draw it thicker"
                )
        if not (size == 2).any():
            raise ValueError(f"{name} holds no particle between the walls: draw it there, or leave it out")


def check_alike(
    outline: Outline, tops: Sequence[Height], table: WaterTable | None, spacing: float, names: Sequence[str]
) -> None:
    """Raise ValueError unless every line is as high at one wall as at the other, so that they can be tied."""
    ends = outline.walls
    lines = {f"top of {name}": top(np.array(ends)) for name, top in zip(names, tops, strict=False)}
    if table is not None:
        lines["water"] = np.interp(ends, table.x, table.z)
    for name, (left, right) in lines.items():
        if abs(left - right) > TOUCHING * spacing:
            raise ValueError(
                f"ends = 'tied', but the {name} is at {left:g} m at one wall and at {right:g} m at the other: draw the "
                "ground on until it is as high at both, or take rollers"
            )
