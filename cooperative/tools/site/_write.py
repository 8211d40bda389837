"""What a site's estimates are written as: tables of a scene with the files that they name, a table, a figure, words.

Sources: stiffness: Duncan and Buchignani (1976), An Engineering Manual for Settlement Studies (500 s_u), and
Schmertmann (1970), doi:10.1061/JSFEAQ.0001418 (2.5 q_c); horizontal scales of fluctuation of cone resistance: Phoon and
Kulhawy (1999), doi:10.1139/t99-038, Table 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cooperative.reporting import save
from cooperative.scene import toml_value
from cooperative.scene.tables import CORRELATIONS
from cooperative.tools.site._assumed import Assumed
from cooperative.tools.site._estimate import SiteEstimate, SiteLayerFit, marginal_of
from cooperative.tools.site._figure import site_figure
from cooperative.tools.site._scene import scene_lines, surface_beside
from jaxmpm import read_raster
from jaxmpm.support import check
from jaxmpm.support.files import write_aside
from jaxmpm.support.text import csv_text
from kl.estimation import Interval

SCALES = (3.0, 48.0, 80.0)
"""Horizontal scales of fluctuation (m) of cone resistance: least, mean and largest of Phoon and Kulhawy (1999)."""


def write_site(site: SiteEstimate, folder: Path, surface: Path | None = None) -> list[Path]:
    """Write `site.toml`, the files that it names, `estimates.csv` and `soundings.png`; with a surface `scene.toml`.

    Args:
        site: the estimates.
        folder: to write to; made if it is missing.
        surface: file of the heights of the ground, for a whole scene, which is copied to the folder unless it lies
            there; None for none.

    Returns:
        What was written.
    """
    head = [] if surface is None else list(scene_lines(site, surface, folder))
    site = site if surface is None else _below(site, surface)
    copies = {} if surface is None else surface_beside(surface, folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for path, data in copies.items():
        write_aside(path, data)
        written.append(path)
    for layer in _drawn(site):
        if not layer.conditioning.size:
            continue
        path = folder / _file(layer)
        write_aside(path, _rows(layer).encode())
        written.append(path)
    texts = {"site.toml": "\n".join(_toml(site)) + "\n", "estimates.csv": _estimates(site)}
    section = site.assumed.section
    if section is not None and section.beside and section.path.parent.resolve() != folder.resolve():
        check.warn(
            f"scene.toml is not written, since {section.path} names files beside it, {', '.join(section.beside[:3])}: "
            "give its folder as --out, or append site.toml to it"
        )
    elif section is not None:
        texts["scene.toml"] = f"{section.text.rstrip()}\n\n{texts['site.toml']}"
    if surface is not None:
        texts["scene.toml"] = "\n".join(head) + texts["site.toml"]
    for name, text in texts.items():
        write_aside(folder / name, text.encode())
        written.append(folder / name)
    picture = folder / "soundings.png"
    save(site_figure(site.layers), picture)
    return [*written, picture]


def _file(layer: SiteLayerFit) -> str:
    return f"{layer.name.replace(' ', '_')}_{layer.parameter}.csv"


def _rows(layer: SiteLayerFit) -> str:
    """The values that condition the field, a row for each."""
    axes = ["x [m]", "z [m]"] if len(layer.points) == 2 else ["x [m]", "y [m]", "z [m]"]
    unit = "Pa" if layer.parameter == "strength" else "deg"
    rows = [[*(f"{at:.3f}" for at in layer.points[:, k]), f"{layer.values[k]:.5g}"] for k in layer.conditioning]
    return csv_text([[*axes, f"{layer.parameter} [{unit}]"], *rows])


def _toml(site: SiteEstimate) -> Iterator[str]:
    """The tables of a scene."""
    yield f"# Layers of {len(site.soundings)} soundings, for a scene with [ground] or [terrain], in its elevations."
    yield "# Look at each boundary and at young, poisson and cohesion, which are no results of the soundings."
    layers, section = _drawn(site), site.assumed.section
    for number, layer in enumerate(layers, 1):
        fit = layer.fit
        yield ""
        yield from (f"# {remark}" for remark in layer.remarks)
        yield "[[layer]]"
        yield f"name = {toml_value(layer.name)}"
        if number < len(layers):
            level = f"[[-1e5, {layer.bottom:.2f}], [1e5, {layer.bottom:.2f}]]"
            yield f"bottom = {level if section is None else section.bottom(layer.bottom)}"
        yield f"unit_weight = {site.assumed.unit_weight:g}    # N/m3"
        source = "500 s_u" if layer.parameter == "strength" else "2.5 q_c"
        yield f"young = {layer.young:.2g}    # Pa, {source}, a guess"
        yield f"poisson = {0.45 if layer.parameter == 'strength' else 0.3}    # a guess"
        if layer.parameter == "friction":
            yield "cohesion = 1e3    # Pa, a guess"
        yield ""
        yield f"[layer.{layer.parameter}]    # 95 % intervals in estimates.csv"
        yield f"mean = {fit.mean.value:.4g}    # at {layer.top:.2f} m"
        yield f"mean_error = {layer.mean_error:.3g}"
        if layer.scatter:
            yield f"factor_cov = {layer.scatter:.3g}    # of N_kt, for all readings and the field alike"
        yield f"cov = {fit.cov.value:.3g}"
        yield f"cov_error = {fit.cov.error:.2g}"
        yield f"marginal = {toml_value(marginal_of(layer.parameter, site.assumed))}"
        if fit.trend is not None:
            yield f"trend = {fit.trend.value:.3g}    # per metre below {layer.top:.2f} m"
            yield f"trend_from = {layer.top:.2f}"
        yield from (f"# {name} length: {why}" for name, why in fit.unknown.items())
        horizontal, others = _horizontal(layer, site.assumed)
        if len(others) > 1:
            yield f"# Sweep the horizontal length over {others}."
        lengths = [horizontal] * (len(layer.points) - 1) + [fit.vertical.value]
        yield f"length = [{', '.join(f'{length:.3g}' for length in lengths)}]"
        yield f"correlation = {toml_value(site.assumed.correlation)}"
        yield "energy = 0.95"
        if layer.conditioning.size:
            yield f"boreholes = {toml_value(_file(layer))}"
            yield f"borehole_error = {layer.error:.2g}"


def _below(site: SiteEstimate, surface: Path) -> SiteEstimate:
    """The site without what conditions its fields above the surface of a terrain."""
    raster, origin = read_raster(surface), np.array(site.assumed.origin)
    layers, above = [], 0
    for layer in site.layers:
        *place, z = layer.points[:, layer.conditioning]
        used = z <= raster.at(*(np.array(place) + origin[:, None])) + SURVEYED
        above += int((~used).sum())
        layers.append(replace(layer, conditioning=layer.conditioning[used]))
    if above:
        check.warn(f"{above} values above the surface of {surface} do not condition the field")
    return replace(site, layers=tuple(layers))


def _drawn(site: SiteEstimate) -> list[SiteLayerFit]:
    """The layers that have ground in the section, all without one."""
    section, (*upper, last) = site.assumed.section, site.layers
    return [*(layer for layer in upper if section is None or section.holds(layer.bottom)), last]


def _horizontal(layer: SiteLayerFit, assumed: Assumed) -> tuple[float, list[float]]:
    """The horizontal length (m) of a layer, and those to sweep where it is unknown.

    An interval bounds them; without one they are published scales of fluctuation.
    """
    estimated = layer.fit.horizontal
    if estimated is not None and "horizontal" not in layer.fit.unknown:
        return estimated.value, []
    least, mean, most = (scale / CORRELATIONS[assumed.correlation].fluctuation for scale in SCALES)
    if estimated is not None:
        least, most = max(least, estimated.low), min(most, estimated.high)
        least, most = (least, most) if least < most else (estimated.low, estimated.high)
        mean = min(max(mean, least), most)
    return mean, list(dict.fromkeys(float(f"{length:.2g}") for length in (least, mean, most)))


SURVEYED = 0.5
"""Height (m) above a terrain model up to which a reading is at its surface: elevations differ by survey."""
COLUMNS = ("layer", "top [m]", "bottom [m]", "parameter", "values", "quantity", "value", "low", "high", "remark")


def _estimates(site: SiteEstimate) -> str:
    """The table of estimates as CSV."""
    rows: list[Sequence[object]] = [COLUMNS]
    for layer in site.layers:
        start = (layer.name, f"{layer.top:.2f}", f"{layer.bottom:.2f}", layer.parameter, layer.values.size)
        for name, interval, remark in _quantities(layer):
            numbers = ("", "", "") if interval is None else tuple(f"{number:.4g}" for number in interval[:3])
            rows.append([*start, name, *numbers, remark])
    return csv_text(rows)


def _quantities(layer: SiteLayerFit) -> Iterator[tuple[str, Interval | None, str]]:
    """Name, estimate with interval, and remark of each estimate of a layer."""
    fit = layer.fit
    unit = "Pa" if layer.parameter == "strength" else "degrees"
    yield f"mean at the top [{unit}]", layer.mean, "with the scatter of N_kt" if layer.scatter else ""
    if fit.trend is not None:
        yield f"trend [{unit}/m]", fit.trend, ""
    yield "cov", fit.cov, ""
    yield "vertical length [m]", fit.vertical, fit.unknown.get("vertical", "")
    yield "horizontal length [m]", fit.horizontal, fit.unknown.get("horizontal", "")
    yield "nugget", fit.nugget, "share of the variance"


def words(site: SiteEstimate) -> str:
    """The estimates as lines of text.

    Args:
        site: the estimates.
    """
    lines = []
    for layer in site.layers:
        lines.append(
            f"{layer.name}: {layer.top:.2f} to {layer.bottom:.2f} m, {layer.parameter} of {layer.values.size} values"
        )
        for name, interval, remark in _quantities(layer):
            numbers = (
                "unknown" if interval is None else f"{interval.value:.4g} ({interval.low:.4g} to {interval.high:.4g})"
            )
            lines.append(f"  {name:<22} {numbers}{'; ' if remark else ''}{remark}")
        lines += [f"  {remark}" for remark in layer.remarks]
    return "\n".join(lines)
