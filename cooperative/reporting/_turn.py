"""Bodies in three dimensions that the reader of a page turns: a canvas, a few lines of script, and nothing to fetch."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize, to_hex

MOST_FACES = 12_000
"""Of a body, so that it turns smoothly."""

HOW = "Drag it to turn it, or click on it and use the arrow keys; the wheel, or + and -, bring it nearer."

ROCK = (150, 150, 150)
"""Colour of values that are none."""

SIDES = (
    # The step to the neighbour, and the corners of the face there, in order as seen from outside.
    ((1, 0, 0), ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1))),
    ((-1, 0, 0), ((0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1))),
    ((0, 1, 0), ((1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1))),
    ((0, -1, 0), ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1))),
    ((0, 0, 1), ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))),
)
"""Sides of a box but the lower one, which nobody can turn up."""


@dataclass(frozen=True)
class Line:
    """A line over the body, one point makes a dot. points: (m, 3) m. name: written at its first point."""

    points: np.ndarray
    colour: str = "#333333"
    name: str = ""
    dashed: bool = False


@dataclass(frozen=True)
class Body:
    """What is drawn at a time.

    name: by which the reader chooses it. faces: corners (n, 4, 3) m, in order as seen from outside. colours: (n, 4)
    red, green, blue and alpha, 0 to 255. lines: over it. key: colours and what they stand for. scale: label, lowest and
    highest value and name of the colour map, where colours stand for values.
    """

    name: str
    faces: np.ndarray
    colours: np.ndarray
    lines: Sequence[Line] = ()
    key: Sequence[tuple[str, str]] = ()
    scale: tuple[str, float, float, str] | None = None


def skin(
    position: np.ndarray, size: np.ndarray | Sequence[float], *, most: int = MOST_FACES
) -> tuple[np.ndarray, np.ndarray]:
    """Outer faces of the boxes that points fill, corners (n, 4, 3) m, and the highest point (n,) in the box of each.

    position: (3, N) m. size: edges of the boxes (3,) m, e.g. the spacing of the particles; where they have more than
    `most` faces boxes are taken a half as large again, until they do not.
    """
    edges, corner = np.asarray(size, float), position.min(axis=1, keepdims=True)
    while True:
        # A point in the middle of the first box.
        place = np.rint((position - corner) / edges[:, None]).astype(int) + 1
        number = np.full(place.max(axis=1) + 2, -1)
        upwards = np.argsort(position[2], kind="stable")
        number[tuple(place[:, upwards])] = upwards
        boxes = np.argwhere(number >= 0)
        low = corner[:, 0] + (boxes - 1.5) * edges
        faces, points = [], []
        for step, corners in SIDES:
            bare = number[tuple((boxes + np.array(step)).T)] < 0
            faces.append(low[bare, None, :] + np.array(corners) * edges)
            points.append(number[tuple(boxes[bare].T)])
        if sum(map(len, faces)) <= most:
            return np.concatenate(faces), np.concatenate(points)
        edges = edges * 1.5


def coloured(values: np.ndarray, norm: Normalize, colours: str) -> np.ndarray:
    """Colours (n, 4), 0 to 255, of values (n,) on a colour map; nan is rock."""
    found = colormaps[colours](norm(np.nan_to_num(values)), bytes=True)
    found[np.isnan(values)] = (*ROCK, 255)
    return found


def turning(bodies: Sequence[Body], caption: str) -> str:
    """A figure of bodies, the first of them shown, that turns where `SCRIPT` stands once after it on the page.

    Its data are packed into it. Raises ValueError where there is nothing to show.
    """
    corners = np.concatenate([body.faces.reshape(-1, 3) for body in bodies])
    if not len(corners):
        raise ValueError("nothing to turn: give bodies with faces")
    low, high = corners.min(axis=0), corners.max(axis=0)
    packed = {"ends": [low.tolist(), high.tolist()], "bodies": [_packed(body) for body in bodies]}
    # No text of a scene can end the script.
    data = json.dumps(packed).replace("<", "\\u003c")
    group = f"turn-{zlib.crc32(data.encode()):08x}"
    choice = "".join(
        f'<label><input type="radio" name="{group}"{" checked" if not number else ""}> {escape(body.name)}</label> '
        for number, body in enumerate(bodies)
    )
    keys = "".join(
        f'<div class="key"{" hidden" if number else ""}>{_key(body)}</div>' for number, body in enumerate(bodies)
    )
    said = f"{caption} {HOW}"
    return (
        f'<figure class="turn">\n<div class="choice">{choice if len(bodies) > 1 else ""}</div>\n'
        f'<canvas tabindex="0" role="img" aria-label="{escape(caption)}"></canvas>\n{keys}\n'
        f"<figcaption>{escape(said)}</figcaption>\n<noscript>This picture needs JavaScript.</noscript>\n"
        f'<script type="application/json">{data}</script>\n</figure>'
    )


def _packed(body: Body) -> dict[str, object]:
    """A body as the script reads it: corners as 32-bit floats, then colours, packed."""
    packed = body.faces.astype("<f4").tobytes() + np.ascontiguousarray(body.colours, np.uint8).tobytes()
    lines = [
        {"points": np.asarray(line.points, float).round(3).tolist(), "colour": line.colour, "name": line.name}
        | {"dashed": line.dashed}
        for line in body.lines
    ]
    data = base64.b64encode(zlib.compress(packed, 9)).decode()
    return {"faces": len(body.faces), "data": data, "lines": lines}


def _key(body: Body) -> str:
    """What the colours of a body stand for."""
    said = "".join(
        f'<span class="swatch" style="background:{escape(colour)}"></span>{escape(name)} ' for colour, name in body.key
    )
    if body.scale is None:
        return said
    label, low, high, name = body.scale
    colours = ", ".join(to_hex(colour) for colour in colormaps[name](np.linspace(0, 1, 9)))
    return said + (
        f'{escape(label)}: {low:.3g} <span class="scale" style="background:linear-gradient(90deg, {colours})"></span> '
        f"{high:.3g}"
    )


SCRIPT = f"<script>\n{Path(__file__).with_name('_turn.js').read_text(encoding='utf-8')}</script>"
"""What turns all figures before it, once on a page."""
