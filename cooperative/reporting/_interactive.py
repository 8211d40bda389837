"""Figures that a reader points at and bodies that turn, by Plotly (extra "interactive"), imported here alone."""

from __future__ import annotations

import gzip
import io
import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Picture

from cooperative.estimate import Exceedance
from cooperative.hazard import HazardMaps
from cooperative.reporting._bodies import Moving
from cooperative.reporting._charts import GREY, REFINED, ROUGH, SERIES, Curve, along, mapped, ranks, stairs_of

if TYPE_CHECKING:
    from plotly.graph_objects import Figure, Mesh3d, Scatter3d


BAND = "rgba(0, 114, 178, 0.2)"
LIMIT = {"color": GREY, "dash": "dot", "width": 1}
HIGH, ACROSS = 320, 3
"""Height of a panel (pixels), and panels beside each other."""
WIDE, DPI = 7.5, 120
"""Width from which a figure stands alone (inch), and the resolution of particles and maps within one."""


@dataclass(frozen=True)
class Drawn:
    """A figure of a report.

    Args:
        name: of its file.
        caption: what it shows, in sentences.
        figure: as matplotlib draws it.
        interactive: makes the same figure in Plotly, None where there is none.
    """

    name: str
    caption: str
    figure: Picture
    interactive: Callable[[], Figure] | None = None


def installed() -> bool:
    """Whether the extra is."""
    return find_spec("plotly") is not None


DRAW = """
const figures = document.querySelectorAll("script[type='application/json']");
async function draw() {
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (each) => each.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const text = await new Response(plain).text();
  document.head.append(Object.assign(document.createElement("script"), { text }));
  const config = { displaylogo: false, responsive: true };
  for (const each of figures)
    Plotly.newPlot(each.previousElementSibling, { ...JSON.parse(each.textContent), config });
}
draw().catch(() => {
  for (const each of figures)
    if (each.nextElementSibling?.matches("noscript"))
      each.previousElementSibling.outerHTML = each.nextElementSibling.textContent;
});
"""
"""Draws the figures of a page by Plotly; browsers that cannot unpack it show those for browsers without scripts."""


def any_interactive(parts: Iterable[Drawn]) -> bool:
    """Whether some of the figures of a page are drawn by its script.

    Args:
        parts: the figures.
    """
    return installed() and any(part.interactive is not None for part in parts)


def script() -> str:
    """Plotly's own script, packed, and what unpacks it and draws all figures before it on a page."""
    from plotly.offline import get_plotlyjs

    packed = b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()
    return f'<script type="text/plain" id="plotly">{packed}</script>\n<script>{DRAW}</script>'


def html(figure: Figure, name: str) -> str:
    """A figure as part of a page that ends with `script`.

    Args:
        figure: of Plotly.
        name: of its element.
    """
    element = f'<div id="{name}" class="plotly-graph-div" style="height: {figure.layout.height}px"></div>'
    return f'{element}\n<script type="application/json">{figure.to_json()}</script>'


def stairs(curves: Mapping[str, Exceedance], labels: Mapping[str, str], up: str) -> Figure:
    """Exceedance curves beside each other.

    Args:
        curves: by name.
        labels: of their axes, by their names.
        up: label of the other axis.
    """
    shown = [{name: stairs_of(values)} for name, values in curves.items()]
    return _stairs(shown, [labels[name] for name in curves], [up] * len(shown), ACROSS)


def profile(maps: HazardMaps, *, toe: float | None) -> Figure:
    """Hazard along a section: probabilities, expected thickness and arrival against x.

    Args:
        maps: of a section.
        toe: its x (m), None for none.
    """
    shown = along(maps)
    figure = _stairs([*shown.values()], ["x [m]"] * len(shown), [*shown], 1)
    return figure if toe is None else figure.add_vline(toe, line=LIMIT)


def _stairs(panels: Sequence[Mapping[str, Curve]], across: Sequence[str], up: Sequence[str], columns: int) -> Figure:
    """Panels of curves of which the first has the band of its interval."""
    figure = _tiled([""] * len(panels), columns)
    for number, curves in enumerate(panels):
        here = _panel(number, columns)
        for at, (name, (x, value, low, high)) in enumerate(curves.items()):
            line = {"shape": "hv", "color": SERIES[at % len(SERIES)]}
            thin: dict[str, object] = {"x": x, "line": line | {"width": 0.5}, "hoverinfo": "skip", "showlegend": False}
            if not at:
                figure.add_scatter(y=low, mode="lines", **thin, **here)
                figure.add_scatter(y=high, mode="lines", fill="tonexty", fillcolor=BAND, **thin, **here)
            hover = "%{y:.3g} (%{customdata[0]:.3g} to %{customdata[1]:.3g})"
            figure.add_scatter(
                x=x, y=value, mode="lines", line=line, name=name, showlegend=len(curves) > 1,
                customdata=np.stack([low, high], axis=1), hovertemplate=hover, **here,
            )  # fmt: skip
        _label(figure, across[number], up[number], here)
        figure.update_yaxes(rangemode="tozero", **here)
    return figure.update_layout(hovermode="x unified")


def plan_maps(maps: HazardMaps, *, toe: float | None) -> Figure:
    """Hazard in plan, one panel for each map; all are zoomed together.

    Args:
        maps: in plan.
        toe: its x (m).
    """
    shown = list(mapped(maps))
    titles = [f"{title}, up to {top:.3g} {unit.strip('-')}" for title, unit, _, top in shown]
    figure = _tiled(titles, ACROSS, shared_xaxes="all", shared_yaxes="all")
    x, y = ((edges[1:] + edges[:-1]) / 2 for edges in maps.edges)
    for number, (_, unit, values, top) in enumerate(shown):
        here, hover = _panel(number, ACROSS), "x %{x:.4g} m, y %{y:.4g} m: %{z:.3g} " + unit.strip("-")
        heights = values.T.astype(np.float32)
        colours = {"zmin": 0.0, "zmax": top, "colorscale": "Cividis", "showscale": False}
        figure.add_heatmap(x=x, y=y, z=heights, hovertemplate=f"{hover}<extra></extra>", **colours, **here)
        _label(figure, "x [m]", "y [m]", here)
    if toe is not None:
        figure.add_vline(toe, line=LIMIT | {"color": "white"})
    high = 110 + round(HIGH * np.ptp(y) / np.ptp(x))
    return figure.update_layout(height=high * -(-len(shown) // ACROSS))


def ranked(displacements: Mapping[str, np.ndarray], failure_displacement: float) -> Figure:
    """Largest displacement of every sample by its rank on the rough grid.

    Args:
        displacements: number of each "sample" (N,), and its largest displacement on each grid (N,) m, nan where it has
            none.
        failure_displacement: drawn as a line (m).
    """
    figure, rank = _tiled([""], 1), ranks(displacements["rough"])
    for grid, colour, symbol in (("rough", ROUGH, "circle"), ("refined", REFINED, "triangle-up-open")):
        _points(figure, rank, displacements[grid], displacements["sample"], f"{grid} grid", colour, symbol)
    figure.add_hline(failure_displacement, line=LIMIT).update_layout(legend={"orientation": "h", "y": 1.1})
    _label(figure, "rank on the rough grid [-]", "largest displacement $R_d$ [m]", {})
    return figure.update_yaxes(type="log")


def grids(displacements: Mapping[str, np.ndarray], failure_displacement: float) -> Figure:
    """Refined against rough displacement of every sample, as `ranked` takes them."""
    figure = _tiled([""], 1)
    _points(figure, displacements["rough"], displacements["refined"], displacements["sample"], "", ROUGH, "circle-open")
    figure.add_hline(failure_displacement, line=LIMIT).add_vline(failure_displacement, line=LIMIT)
    _label(figure, "$R_d$ on the rough grid [m]", "$R_d$ on the refined grid [m]", {})
    return figure.update_xaxes(type="log").update_yaxes(type="log")


def _points(
    figure: Figure, x: np.ndarray, y: np.ndarray, numbers: np.ndarray, name: str, colour: str, symbol: str
) -> None:
    """Samples, each of which gives its number."""
    figure.add_scatter(
        x=x, y=y, customdata=numbers, name=name, showlegend=bool(name), mode="markers",
        marker={"color": colour, "symbol": symbol, "size": 7},
        hovertemplate="sample %{customdata}: %{x:.3g}, %{y:.3g}<extra></extra>",
    )  # fmt: skip


def _tiled(titles: Sequence[str], columns: int, **how: str) -> Figure:
    """A figure with a panel for each title, so many beside each other."""
    from plotly.subplots import make_subplots

    columns = min(columns, len(titles))
    rows = -(-len(titles) // columns)
    figure = make_subplots(rows, columns, subplot_titles=titles, **how)
    figure.update_annotations(font_size=13)
    margin = {"l": 60, "r": 10, "t": 40, "b": 50}
    return figure.update_layout(template="plotly_white", height=60 + HIGH * rows, margin=margin)


def _panel(number: int, columns: int) -> dict[str, int]:
    return {"row": number // columns + 1, "col": number % columns + 1}


def _label(figure: Figure, across: str, up: str, here: Mapping[str, int]) -> None:
    """Labels of a panel's axes, their mathematics as Plotly has it."""
    across, up = (re.sub(r"\$(\w)(?:_(\w))?\$", _set, label) for label in (across, up))
    figure.update_xaxes(title_text=across, **here).update_yaxes(title_text=up, **here)


def _set(symbol: re.Match[str]) -> str:
    name, below = symbol.groups()
    return f"<i>{name}</i>" + (f"<sub>{below}</sub>" if below else "")


def mesh(
    corners: np.ndarray,
    faces: np.ndarray,
    *,
    of_corners: np.ndarray | None = None,
    of_faces: np.ndarray | None = None,
    **options: object,
) -> Mesh3d:
    """Faces between corners, two triangles each, coloured by a value of each corner or face.

    Args:
        corners: (n, 3) m.
        faces: numbers of their corners (m, 4).
        of_corners: values (n,).
        of_faces: values (m,).
        **options: other options of Plotly's mesh.
    """
    from plotly.graph_objects import Mesh3d

    used, numbers = np.unique(faces, return_inverse=True)
    x, y, z = corners[used].T.astype(np.float32)
    i, j, k = numbers.reshape(-1, 4)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).T
    if of_corners is not None:
        options["intensity"] = of_corners[used].astype(np.float32)
    if of_faces is not None:
        options |= {"intensity": np.repeat(of_faces, 2).astype(np.float32), "intensitymode": "cell"}
    light = {"ambient": 0.6, "diffuse": 0.7, "specular": 0.05}
    return Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, flatshading=True, lighting=light, **options)


def scene(meshes: Sequence[Mesh3d | Scatter3d], **how: object) -> Figure:
    """Bodies and lines that turn together, in true scale."""
    from plotly.graph_objects import Figure

    axes = {f"{axis}axis": {"title": {"text": f"{axis} [m]"}} for axis in "xyz"}
    seen = {"aspectmode": "data", "camera": {"eye": {"x": 1.0, "y": -1.7, "z": 1.1}}, **axes}
    margin = {"l": 0, "r": 0, "t": 40, "b": 20}
    layout = {"scene": seen, "height": 2 * HIGH, "margin": margin, "template": "plotly_white"}
    return Figure(meshes, layout=layout | how)


def line(points: np.ndarray, name: str, colour: str = "#333333", *, dashed: bool = False) -> Scatter3d:
    """A named line (m, 3) m, one point makes a mark."""
    from plotly.graph_objects import Scatter3d

    x, y, z = points.T
    line = {"color": colour, "width": 4, "dash": "dash" if dashed else "solid"}
    mode = "lines" if len(points) > 1 else "markers"
    return Scatter3d(x=x, y=y, z=z, mode=mode, line=line, marker={"color": colour, "size": 5}, name=name)


def chosen(bodies: Mapping[str, Sequence[Mesh3d]], beside: Sequence[Scatter3d]) -> Figure:
    """Bodies of which the reader chooses one, the first at the beginning, and what stands beside each."""
    of = [name for name, body in bodies.items() for _ in body]
    meshes = [mesh.update(visible=name == of[0]) for name, body in bodies.items() for mesh in body]
    buttons = [
        {
            "label": name,
            "method": "restyle",
            "args": [{"visible": [*(mesh_name == name for mesh_name in of), *[True] * len(beside)]}],
        }
        for name in bodies
    ]
    menu = {"buttons": buttons, "type": "buttons", "direction": "right", "x": 0, "xanchor": "left", "y": 1.08}
    return scene([*meshes, *beside], updatemenus=[menu], legend={"x": 0, "y": 0.95})


def turning(body: Moving) -> Figure:
    """A slide that turns, its times on a slider."""
    scale = {"title": {"text": "displacement [m]"}}
    most = max(float(body.magnitude.max()), 1e-6)
    meshes = [
        mesh(
            corners, body.faces, of_corners=magnitude, hovertemplate="%{intensity:.3g} m<extra></extra>",
            cmin=0.0, cmax=most, colorscale="Viridis", colorbar=scale,
        )
        for corners, magnitude in zip(body.corners, body.magnitude, strict=True)
    ]  # fmt: skip
    names = [f"t = {time:.3g} s" for time in body.times]
    how = {"mode": "immediate", "frame": {"duration": 0, "redraw": True}}
    steps = [{"label": name, "method": "animate", "args": [[name], how]} for name in names]
    last = len(names) - 1
    figure = scene([meshes[last]], sliders=[{"active": last, "steps": steps, "pad": {"l": 40, "r": 40}}])
    figure.frames = [
        {"name": name, "data": [{key: mesh[key] for key in ("type", "x", "y", "z", "intensity")}]}
        for name, mesh in zip(names, meshes, strict=True)
    ]
    return figure


def figures(parts: Iterable[Drawn]) -> str:
    """Figures as HTML, narrow ones beside each other where there is room; nothing for none.

    Args:
        parts: the figures.
    """
    shown = "\n".join(map(figure, parts))
    return f'<div class="figures">\n{shown}\n</div>' if shown else ""


def figure(part: Drawn) -> str:
    """A figure as matplotlib draws it; where Plotly is installed and the browser runs scripts, its interactive form."""
    shown = _inlined(part)
    if part.interactive is not None and installed():
        shown = f"{html(part.interactive(), part.name)}\n<noscript>{shown}</noscript>"
    wide = " wide" if part.figure.get_figwidth() > WIDE else ""
    return (
        f'<figure class="drawn{wide}" aria-labelledby="of-{part.name}">\n{shown}\n'
        f'<figcaption id="of-{part.name}">{escape(part.caption)}</figcaption>\n</figure>'
    )


def _inlined(part: Drawn) -> str:
    """A figure as an SVG element, whose ids no other element of the page has."""
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": part.name}):
        part.figure.savefig(file, format="svg", dpi=DPI, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    drawing = file.getvalue().decode()
    # Its style sheet would apply to all elements of the page; the page's own has what it needs.
    drawing = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", drawing[drawing.find("<svg") :], flags=re.S)
    drawing = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{part.name}-", drawing)
    return drawing.replace("<svg ", f'<svg role="img" aria-labelledby="of-{part.name}" ', 1)
