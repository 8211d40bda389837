"""A figure as SVG within the page that answers mouse and keyboard, each of its panels for itself: beside each other on
a screen, below each other on a phone.

What is drawn and where is read from matplotlib's figure, so that the file in `figures/` and the page show the same.
Colours are variables of the page's style sheet, so that they suit light and dark; lines differ by their dashes and
marks by their shapes too. The values go with each panel as JSON, for `_page.js` to tell.
"""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib import cbook
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection, LineCollection, PolyCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedFormatter, LogLocator, MaxNLocator
from matplotlib.transforms import Affine2D, IdentityTransform, Transform

WIDE, LEFT, RIGHT, TOP, BOTTOM = 420.0, 62.0, 12.0, 8.0, 40.0
"""Of a panel, in the units of its drawing: width, and margins for ticks and labels."""
RATIO = 0.58
"""Height by width of a panel whose axes have units of their own."""
PIXELS = 1200
"""Across a picture of particles."""
TICKS = 5
ROUND = MaxNLocator(TICKS, steps=[1, 2, 5, 10])
"""Where the ticks of an axis stand; `_page.js` takes the same steps."""
LEVELS = 65_534
"""Steps between nothing and the largest value of a map, as the page has it; the next number is for no value."""
COLOURS = {
    "#0072b2": "blue",
    "#d55e00": "orange",
    "#cc79a7": "pink",
    "#009e73": "green",
    "#56b4e9": "sky",
    "#5a5a5a": "grey",
    "#bbd5e8": "pale",
    "#000000": "ink",
}
"""Of figures, by their names in the style sheet; any other colour stands as it is."""
DASHES = {"-": "", "--": "7 4", "-.": "8 3 2 3", ":": "2 3"}
SYMBOLS = {r"\varphi": "φ", r"\psi": "ψ", r"\nu": "ν", r"\gamma": "γ", "^2": "²", "^3": "³"}


def panels(figure: Figure) -> list[str]:
    """Each panel of a figure as HTML, its colour scale below the last that shares it."""
    scales = {id(each.colorbar.ax) for ax in figure.axes for each in _mapped(ax) if each.colorbar is not None}
    shown = [ax for ax in figure.axes if ax.axison and id(ax) not in scales]
    return [_panel(ax) for ax in shown]


def linked(figure: Figure) -> bool:
    """Whether all panels show the same ground: what is pointed at in one is then told in all."""
    shown = [ax for ax in figure.axes if ax.axison and ax.get_xlabel()]
    return len(shown) > 1 and len({(ax.get_xlabel(), ax.get_xlim()) for ax in shown}) == 1


def plain(text: str) -> str:
    """A label without the signs of mathematics."""
    for said, sign in SYMBOLS.items():
        text = text.replace(said, sign)
    return text.replace("$", "")


def told(ax: Axes) -> str:
    """What a panel shows, in words: the ends of each curve, the range of each map."""
    title, across, up = (plain(each) for each in (ax.get_title(loc="left"), ax.get_xlabel(), ax.get_ylabel()))
    lines = [f"{title}, " if title else "", f"{up} against {across}."]
    for series in _series(ax):
        known = [(x, y) for x, y in zip(series["x"], series["y"], strict=True) if x is not None and y is not None]
        if not known:
            continue
        name = f"{series['name']}: " if series["name"] else ""
        if series["kind"] == "points" and len(known) > 1:
            heights = [y for _, y in known]
            lines.append(f" {name}{len(known)} points, {min(heights):.3g} to {max(heights):.3g}.")
        else:
            ends = dict.fromkeys([known[0], known[len(known) // 2], known[-1]])
            lines.append(f" {name}" + ", ".join(f"{y:.3g} at {x:.3g}" for x, y in ends) + ".")
    for each in _mapped(ax):
        values = np.ma.masked_invalid(np.ma.asarray(each.get_array()))
        if values.count():
            lines.append(f" Values from {values.min():.3g} to {values.max():.3g}.")
    return "".join(lines)


def _panel(ax: Axes) -> str:
    width, height = _size(ax)
    drawing = "".join(_content(ax, width, height))
    across, up = (_rich(label) for label in (ax.get_xlabel(), ax.get_ylabel()))
    middle = TOP + height / 2
    title = ax.get_title(loc="left")
    scale = "".join(_scale(each) for each in _mapped(ax) if each.colorbar is not None)
    picture = '<rect class="air" width="100%" height="100%"/>' if _mapped(ax) else ""
    data = {
        "x": _axis(ax, "x"),
        "y": _axis(ax, "y"),
        "equal": ax.get_aspect() == 1,
        "series": _series(ax),
        "maps": [_map(each) for each in ax.collections if isinstance(each, QuadMesh)],
    }
    return (
        f'<div class="panel" data-panel="{escape(json.dumps(data, separators=(",", ":")))}">\n'
        + (f'<p class="title">{escape(plain(title))}</p>\n' if title else "")
        + f'<svg class="chart" viewBox="0 0 {WIDE:g} {TOP + height + BOTTOM:.5g}" role="img" '
        f'aria-label="{escape(told(ax))}">\n'
        f'<g class="ticks">{_ticks(ax, width, height)}</g>\n'
        f'<svg class="plot" x="{LEFT:g}" y="{TOP:g}" width="{width:.5g}" height="{height:.5g}">{picture}{drawing}'
        '<g class="cursor"></g></svg>\n'
        f'<path class="frame" d="M{LEFT:g} {TOP:g}v{height:.5g}h{width:.5g}"/>\n'
        f'<text text-anchor="middle" x="{LEFT + width / 2:.5g}" y="{TOP + height + 34:.5g}">{across}</text>'
        f'<text text-anchor="middle" transform="translate(12 {middle:.5g}) rotate(-90)">{up}</text>\n'
        f"</svg>\n{scale}{_legend(ax)}{_table(ax)}</div>\n"
    )


def _size(ax: Axes) -> tuple[float, float]:
    """Width and height of a panel within its axes; ground is drawn in true scale."""
    width = WIDE - LEFT - RIGHT
    if ax.get_aspect() != 1:
        return width, RATIO * width
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    height = width * (high - low) / (right - left)
    return (width, height) if height < WIDE else (width * WIDE / height, WIDE)


def _content(ax: Axes, width: float, height: float) -> Iterator[str]:
    """Everything within the axes, from the lowest up: first what is stretched when the panel is zoomed, then what is
    only moved."""
    to_plot = ax.transAxes.inverted() + Affine2D().scale(width, -height).translate(0, height)
    artists: list[Artist] = [*ax.collections, *ax.patches, *ax.lines, *ax.texts]
    artists.sort(key=lambda each: each.get_zorder())
    stretched, moved = [], []
    for artist in artists:
        if isinstance(artist, Text):
            moved.append(_text(ax, artist, to_plot))
        elif isinstance(artist, Line2D):
            stretched.append(_line(artist, to_plot))
            moved += _marks(artist, to_plot)
        elif isinstance(artist, QuadMesh):
            stretched.append(_image(_cells(artist), width, height, box=_extent(artist, to_plot)))
        elif isinstance(artist, PolyCollection) and artist.get_array() is not None:
            stretched.append(_image(_particles(ax, artist, height / width), width, height))
        elif isinstance(artist, Patch | Collection):
            stretched += _areas(artist, to_plot)
        else:
            raise TypeError(f"the page cannot draw {type(artist).__name__}: add it to cooperative/reporting/_svg.py")
    yield f'<g class="zoomed">{"".join(stretched)}</g><g class="marks">{"".join(moved)}</g>'


def _line(line: Line2D, to_plot: Transform) -> str:
    style = line.get_linestyle()
    if style not in DASHES:
        return ""
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    if line.get_drawstyle() == "steps-post":
        x, y = cbook.pts_to_poststep(x, y)
    path = Path(np.stack([x, y], axis=1)).transformed(line.get_transform() + to_plot)
    dashes = f";stroke-dasharray:{DASHES[style]}" if DASHES[style] else ""
    return (
        f'<path d="{_d(path)}" style="fill:none;stroke:{_colour(line.get_color())};'
        f'stroke-width:{line.get_linewidth():g}{dashes}"/>'
    )


def _marks(line: Line2D, to_plot: Transform) -> Iterator[str]:
    marker = line.get_marker()
    if marker in ("None", "", " ", None):
        return
    shape, size = MarkerStyle(marker), line.get_markersize() * (0.6 if marker == "." else 1.0)
    d = _d(shape.get_path().transformed(shape.get_transform() + Affine2D().scale(size, -size)))
    edge, face = line.get_markeredgecolor(), line.get_markerfacecolor()
    filled = "none" if face == "none" or not shape.is_filled() else _colour(face)
    for x, y in (line.get_transform() + to_plot).transform(np.stack(line.get_data(), axis=1).astype(float)):
        if np.isfinite(x + y):
            yield (
                f'<path data-at="{x:.5g} {y:.5g}" transform="translate({x:.5g} {y:.5g})" d="{d}" '
                f'style="fill:{filled};stroke:{_colour(edge)}"/>'
            )


def _text(ax: Axes, text: Text, to_plot: Transform) -> str:
    if isinstance(text, Annotation):
        if text.xycoords not in ("data", "axes fraction"):
            raise TypeError(f"the page cannot place a note by {text.xycoords!r}: give 'data' or 'axes fraction'")
        at = (ax.transData if text.xycoords == "data" else ax.transAxes).transform(text.xy)
    else:
        at = text.get_transform().transform(text.get_position())
    x, y = to_plot.transform(at)
    anchor = {"left": "start", "center": "middle", "right": "end"}[text.get_horizontalalignment()]
    drop = {"top": 12, "center": 4, "bottom": -4, "baseline": 0}[text.get_verticalalignment()]
    colour = _colour(text.get_color())
    return (
        f'<g data-at="{x:.5g} {y:.5g}" transform="translate({x:.5g} {y:.5g})"><text text-anchor="{anchor}" '
        f'y="{drop}" style="fill:{colour}">{_rich(text.get_text())}</text></g>'
    )


def _areas(artist: Patch | Collection, to_plot: Transform) -> Iterator[str]:
    """Bars, bands and whiskers."""
    one = isinstance(artist, Patch)
    paths: Sequence[Path] = [artist.get_path()] if isinstance(artist, Patch) else artist.get_paths()
    faces: Any = [artist.get_facecolor()] if one else artist.get_facecolor()
    edges: Any = [artist.get_edgecolor()] if one else artist.get_edgecolor()
    widths: Any = np.atleast_1d(artist.get_linewidth())
    open_ended = isinstance(artist, LineCollection)
    for number, path in enumerate(paths):
        fill = "none" if open_ended or not len(faces) else _colour(faces[number % len(faces)])
        opacity = 1.0 if fill == "none" else to_rgba(faces[number % len(faces)])[3]
        edge = edges[number % len(edges)] if len(edges) else None
        wide = float(widths[number % len(widths)])
        stroke = "none" if edge is None or not wide else _colour(edge)
        yield (
            f'<path d="{_d(path.transformed(artist.get_transform() + to_plot))}" '
            f'style="fill:{fill};fill-opacity:{opacity:.3g};stroke:{stroke};stroke-width:{wide:g}"/>'
        )


def _d(path: Path) -> str:
    """A path as SVG has it."""
    letters = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C"}
    return "".join(
        "Z" if code == Path.CLOSEPOLY else letters[code] + " ".join(f"{value:.2f}" for value in corners)
        for corners, code in path.iter_segments(simplify=False)
    )


def _image(picture: bytes, width: float, height: float, *, box: tuple[float, ...] | None = None) -> str:
    x, y, wide, high = box or (0.0, 0.0, width, height)
    return (
        f'<image x="{x:.5g}" y="{y:.5g}" width="{wide:.5g}" height="{high:.5g}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{base64.b64encode(picture).decode()}"/>'
    )


def _cells(mesh: QuadMesh) -> bytes:
    """A pixel for each cell of a map, the upper row first; no colour where it has no value."""
    values: Any = np.ma.masked_invalid(np.ma.asarray(mesh.get_array()))
    return _png(mesh.cmap.with_extremes(bad=(0, 0, 0, 0))(mesh.norm(values))[::-1])


def _extent(mesh: QuadMesh, to_plot: Transform) -> tuple[float, ...]:
    corners = (mesh.get_transform() + to_plot).transform(np.asarray(mesh.get_coordinates())[[0, -1], [0, -1]])
    (x0, y0), (x1, y1) = corners
    return x0, y1, x1 - x0, y0 - y1


def _particles(ax: Axes, boxes: PolyCollection, ratio: float) -> bytes:
    """Particles as pixels, with nothing around them."""
    figure = Figure(figsize=(PIXELS / 100, PIXELS * ratio / 100), dpi=100)
    FigureCanvasAgg(figure)
    paper = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    paper.set_axis_off()
    drawn = PolyCollection(
        [path.vertices for path in boxes.get_paths()],
        array=boxes.get_array(), cmap=boxes.cmap, norm=boxes.norm, lw=0, antialiased=False,
    )  # fmt: skip
    paper.add_collection(drawn, autolim=False)
    paper.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
    kept = io.BytesIO()
    without: Any = {"Software": None}
    figure.savefig(kept, format="png", transparent=True, metadata=without)
    return kept.getvalue()


def _png(pixels: Any) -> bytes:
    kept = io.BytesIO()
    without: Any = {"Software": None}
    imsave(kept, pixels, format="png", metadata=without)
    return kept.getvalue()


def _scale(mappable: Any) -> str:
    """The colour scale of pictures and maps, with its ends and label."""
    low, high = float(mappable.norm.vmin or 0.0), float(mappable.norm.vmax or 0.0)
    bar = base64.b64encode(_png(mappable.cmap(np.linspace(0, 1, 256))[None])).decode()
    ax, width = mappable.colorbar.ax, WIDE - LEFT - RIGHT
    label = ax.get_ylabel() or ax.get_xlabel()
    marks = "".join(
        f'<text text-anchor="middle" x="{LEFT + width * (at - low) / (high - low):.5g}" y="24">{at:g}</text>'
        for at in _between(ROUND.tick_values(low, high), low, high)
        if high > low
    )
    return (
        f'<svg class="scale" viewBox="0 0 {WIDE:g} 44" role="img" '
        f'aria-label="{escape(f"colour scale: {plain(label)}, {low:.3g} to {high:.3g}")}">'
        f'<image x="{LEFT:g}" y="2" width="{width:g}" height="9" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{bar}"/>{marks}'
        f'<text text-anchor="middle" x="{LEFT + width / 2:g}" y="39">{_rich(label)}</text></svg>\n'
    )


def _ticks(ax: Axes, width: float, height: float) -> str:
    made = []
    for name in "xy":
        axis, (low, high) = _axis(ax, name), getattr(ax, f"get_{name}lim")()
        for at, said in axis["names"] or [[at, f"{at:g}"] for at in _places(axis["log"], low, high)]:
            share = np.log(at / low) / np.log(high / low) if axis["log"] else (at - low) / (high - low)
            if name == "x":
                x = LEFT + share * width
                made.append(f'<path d="M{x:.5g} {TOP + height:.5g}v4"/>')
                made += [
                    f'<text text-anchor="middle" x="{x:.5g}" y="{TOP + height + 17 + 13 * row:g}">{escape(line)}</text>'
                    for row, line in enumerate(said.split("\n"))
                ]
            else:
                y = TOP + (1 - share) * height
                made.append(f'<path d="M{LEFT:g} {y:.5g}h-4"/>')
                made.append(f'<text text-anchor="end" x="{LEFT - 7:g}" y="{y + 4:.5g}">{escape(said)}</text>')
    return "".join(made)


def _places(log: bool, low: float, high: float) -> list[float]:
    decades = LogLocator(numticks=TICKS + 2).tick_values(low, high) if log else []
    found = _between(decades, low, high)
    return found if len(found) > 1 else _between(ROUND.tick_values(low, high), low, high)


def _between(places: Sequence[float], low: float, high: float) -> list[float]:
    """Those within the axis, without the dust of a division."""
    dust = 1e-9 * abs(high - low)
    return [0.0 if abs(at) < dust else float(at) for at in places if low - dust <= at <= high + dust]


def _axis(ax: Axes, name: str) -> dict[str, Any]:
    """Label, ends, whether logarithmic, and names of its places where it has such instead of numbers."""
    axis = getattr(ax, f"{name}axis")
    formatter = axis.get_major_formatter()
    names = []
    if isinstance(formatter, FixedFormatter):
        places = axis.get_majorticklocs().tolist()
        names = [[at, plain(said)] for at, said in zip(places, formatter.seq, strict=True)]
    ends = getattr(ax, f"get_{name}lim")()
    return {
        "label": plain(getattr(ax, f"get_{name}label")()),
        "ends": [float(end) for end in ends],
        "log": getattr(ax, f"get_{name}scale")() == "log",
        "names": names,
    }


def _series(ax: Axes) -> list[dict[str, Any]]:
    """Values of what has a label, with the limits that follow it: lines whose gid is "low" and "high"."""
    found: list[dict[str, Any]] = []
    for line in ax.lines:
        x, y = (_numbers(values) for values in line.get_data())
        limit = str(line.get_gid())
        if limit in ("low", "high"):
            # Limits of a height stand above and below it, those of a length beside it.
            found[-1][limit] = x if y == found[-1]["y"] and x != found[-1]["x"] else y
        elif not str(line.get_label()).startswith("_") and line.get_transform() == ax.transData:
            drawn = len(x) > 1 and line.get_linestyle() in DASHES
            kind = "points" if not drawn else "step" if line.get_drawstyle() == "steps-post" else "curve"
            found.append({"name": plain(str(line.get_label())), "kind": kind, "x": x, "y": y})
    return found


def _numbers(values: Any) -> list[float | None]:
    """Five figures of each, none where there is no number."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in np.asarray(values, float)]


def _map(mesh: QuadMesh) -> dict[str, Any]:
    """Values of a map, row by row from the lowest, in steps of its largest."""
    values: Any = np.ma.filled(np.ma.asarray(mesh.get_array(), float), np.nan)
    top = float(np.nanmax(values, initial=0.0)) or 1.0
    steps = np.where(np.isfinite(values), np.rint(np.nan_to_num(values) / top * LEVELS), LEVELS + 1).astype("<u2")
    edges = np.asarray(mesh.get_coordinates())
    unit = mesh.colorbar.ax.get_ylabel() if mesh.colorbar is not None else ""
    return {
        "left": float(edges[0, 0, 0]), "right": float(edges[0, -1, 0]),
        "low": float(edges[0, 0, 1]), "high": float(edges[-1, 0, 1]),
        "shape": list(values.shape), "top": top, "unit": plain(unit).strip("[]").replace("-", ""),
        "values": base64.b64encode(steps.tobytes()).decode(),
    }  # fmt: skip


def _mapped(ax: Axes) -> list[Any]:
    """What has a colour scale."""
    return [each for each in ax.collections if each.get_array() is not None]


def _legend(ax: Axes) -> str:
    if ax.get_legend() is None:
        return ""
    items = []
    for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
        sample = ""
        if isinstance(handle, Line2D):
            look: dict[str, Any] = {
                "color": handle.get_color(), "lw": handle.get_linewidth(), "ls": handle.get_linestyle(),
                "marker": handle.get_marker(), "ms": handle.get_markersize(),
                "mfc": handle.get_markerfacecolor(), "mec": handle.get_markeredgecolor(),
            }  # fmt: skip
            sample = _line(Line2D([2.0, 26.0], [6.0, 6.0], **look), IdentityTransform())
            sample += "".join(_marks(Line2D([14.0], [6.0], **look), IdentityTransform()))
        items.append(
            f'<li><svg class="key" viewBox="0 0 28 12" aria-hidden="true">{sample}</svg> {_rich_html(label)}</li>'
        )
    return f'<ul class="legend">{"".join(items)}</ul>\n'


def _table(ax: Axes) -> str:
    """The values of curves with limits, to be opened."""
    bounded = [each for each in _series(ax) if "low" in each and each["kind"] != "points"]
    rows = [
        [each["name"], *values]
        for each in bounded
        for values in zip(each["x"], each["y"], each["low"], each["high"], strict=True)
    ]
    if not rows:
        return ""
    heads = ["curve", plain(ax.get_xlabel()), plain(ax.get_ylabel()), "lower limit", "upper limit"]
    several = len(bounded) > 1
    body = "".join("<tr>" + "".join(_cell(value) for value in (row if several else row[1:])) + "</tr>" for row in rows)
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in (heads if several else heads[1:]))
    return (
        f'<details><summary>values</summary><div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div></details>\n"
    )


def _cell(value: str | float | None) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f'<td class="number">{"–" if value is None else f"{value:.4g}"}</td>'


def _colour(colour: Any) -> str:
    code = to_hex(colour)
    return f"var(--{COLOURS[code]})" if code in COLOURS else code


def _rich(text: str) -> str:
    """A label for SVG, with what stands below the line set so."""
    return re.sub(
        r"_(\w)", r'<tspan dy="3" font-size="80%">\1</tspan><tspan dy="-3">&#8203;</tspan>', _escaped_math(text)
    )


def _rich_html(text: str) -> str:
    return re.sub(r"_(\w)", r"<sub>\1</sub>", _escaped_math(text))


def _escaped_math(text: str) -> str:
    """Only what stands between dollars may hold a sign for below the line."""
    parts = text.split("$")
    return "".join(
        escape(plain(part)) if number % 2 else escape(part).replace("_", "&#95;") for number, part in enumerate(parts)
    )
