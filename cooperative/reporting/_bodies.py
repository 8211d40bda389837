"""Shapes of soil that has moved: boxes of particles in a section, the skin of the ground in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

MOST_FACES = 10_000
"""Of a skin: a report holds several, each at several times."""

SIDES = (
    ((1, 0, 0), ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1))),
    ((-1, 0, 0), ((0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1))),
    ((0, 1, 0), ((1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1))),
    ((0, -1, 0), ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1))),
    ((0, 0, 1), ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))),
)
"""Sides of a box but the lower one, on which the ground stands: the neighbour's step, and the corners in order as seen
from outside."""


@dataclass(frozen=True)
class Skin:
    """Outer faces of a body.

    Args:
        corners: (n, 3) m.
        faces: numbers of their corners (m, 4), in order as seen from outside.
        of: highest particle (m,) in the box of each face.
    """

    corners: np.ndarray
    faces: np.ndarray
    of: np.ndarray


@dataclass(frozen=True)
class Moving:
    """A body at several times.

    Args:
        corners: (T, n, 3) m at the T times (s) of those of the skin's faces (m, 4).
        magnitude: displacement of each corner (T, n) m.
    """

    faces: np.ndarray
    corners: np.ndarray
    magnitude: np.ndarray
    times: Sequence[float]


def skin(position: np.ndarray, size: np.ndarray | Sequence[float], *, most: int = MOST_FACES) -> Skin:
    """The skin of the boxes that particles fill.

    Args:
        position: (3, N) m.
        size: edges of the boxes (3,) m, e.g. the spacing of the particles; where they have more than `most` faces boxes
            are taken a half as large again, until they do not.
        most: number of faces.
    """
    edges, corner = np.asarray(size, float), position.min(axis=1, keepdims=True)
    while True:
        # A point in the middle of the first box.
        index = np.rint((position - corner) / edges[:, None]).astype(int) + 1
        number = np.full(index.max(axis=1) + 2, -1)
        upwards = np.argsort(position[2], kind="stable")
        number[tuple(index[:, upwards])] = upwards
        boxes = np.argwhere(number >= 0)
        faces, points = [], []
        for step, corners in SIDES:
            bare = boxes[number[tuple((boxes + np.array(step)).T)] < 0]
            faces.append(bare[:, None, :] + np.array(corners))
            points.append(number[tuple(bare.T)])
        if sum(map(len, faces)) <= most:
            lattice, order = np.unique(np.concatenate(faces).reshape(-1, 3), axis=0, return_inverse=True)
            return Skin(corner[:, 0] + (lattice - 1.5) * edges, order.reshape(-1, 4), np.concatenate(points))
        edges = edges * 1.5


def moving(position: np.ndarray, displacement: np.ndarray, times: Sequence[float], half_size: np.ndarray) -> Moving:
    """A slide at several times: the skin of the ground before, moved with its soil.

    Args:
        position: initial (3, N) m.
        displacement: (T, 3, N) m at the T times (s).
        times: of the displacements (s).
        half_size: half the particle spacing (3,) m.
    """
    surface = skin(position, 2 * half_size)
    # A corner goes with the particles that meet there, as in a section; where boxes are larger, with the nearest ones.
    from scipy.spatial import cKDTree  # loads what only bodies in 3D need

    away, near = cKDTree(position.T).query(surface.corners, k=min(8, position.shape[1]))
    meets = (away <= away[:, :1] * (1 + 1e-6))[None]
    steps = np.stack([(np.where(meets, step[:, near], 0).sum(axis=2) / meets.sum(axis=2)).T for step in displacement])
    return Moving(surface.faces, surface.corners + steps, np.linalg.norm(steps, axis=2), times)


def picture(body: Moving) -> Figure:
    """The body at its last time, seen from above the toe, coloured by how far its soil has moved."""
    corners, far = body.corners[-1], body.magnitude[-1]
    norm = Normalize(0.0, max(float(far.max()), 1e-6))
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    ax = figure.add_subplot(projection="3d")
    colours = matplotlib.colormaps["viridis"](norm(far[body.faces].mean(axis=1)))
    ax.add_collection3d(
        Poly3DCollection(corners[body.faces], facecolors=colours, shade=True, lw=0, antialiased=False, rasterized=True)
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set_box_aspect(high - low)
    ax.view_init(elev=25, azim=-60)
    scale = matplotlib.cm.ScalarMappable(norm, "viridis")
    figure.colorbar(scale, ax=ax, label="displacement [m]", shrink=0.7, pad=0.1)
    return figure
