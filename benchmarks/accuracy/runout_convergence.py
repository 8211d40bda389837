"""Run-out, travel and deposit of slides against the cell: error against seconds.

Each slide runs on cells that are halved. `front_m` is the run-out of the sliding mass without loose grains, of sand the
point where its deposit is 5 % as thick as the column was high. `front_95_m` is that of 95 % of the soil that slid, both
from the toe or the edge of a column. `travel_m` is the displacement of the centre of the soil that slid.
`profile` is the area between the deposit's thickness and that on the finest cells, over the area that slid. Of each
case, `last_two_halvings` is the largest change of both run-outs in the last two halvings, over the finest one, and
`default_error` their error on the cell that a scene would have.
Finished rows stay in out/runout_convergence, and the next command goes on from there.

Sources of the column of sand: Lube et al. (2005), 10.1103/PhysRevE.72.041301; Lajeunesse et al. (2005),
10.1063/1.2087687.
"""

from __future__ import annotations

import math
import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.collapse import DEFAULTS, GRAVITY, Numerics, collapse
from benchmarks.measure import ROOT, Report, code_digest, stored_row
from benchmarks.sites import sites_retrogression, sites_terrain
from cooperative.measure import consequences
from cooperative.scene import Campaign, parse, to_toml
from jaxmpm import Face, Scene, Settle, State, reduced, solve

Row = dict[str, Any]
Tables = Mapping[str, Mapping[str, object]]
"""Keys of tables in place of a scene's."""

NONE: Tables = {}
SCENES = ROOT / "benchmarks" / "scenes"
STATION = 2.0
"""Width (m) of the stations at which thicknesses of deposits are compared."""


def measures(
    position: np.ndarray, displacement: np.ndarray, volume: np.ndarray, *, origin: float, half: float, slid: float
) -> Row:
    """Run-outs from x = `origin`, travel, and the thickness of the soil at stations, of a final state.

    Args:
        position: initial (d, N) m.
        displacement: from there (d, N) m.
        volume: (N,) m3, in a section m2.
        origin: x of the toe (m).
        half: half the spacing of particles along x (m).
        slid: displacement from which soil slides (m).
    """
    sliding = np.linalg.norm(displacement, axis=0) >= slid
    now, v = position[0] + displacement[0] + half, volume[sliding]
    order = np.argsort(now[sliding])
    share = np.cumsum(v[order]) / v.sum()
    mass = consequences(
        position, displacement, volume, Face(origin, 0.0, float(position[-1].max())),
        half_size=np.full(len(position), half), failure_displacement=slid, reach=6 * half,
    )  # fmt: skip
    thickness, _ = np.histogram(now - half, bins=np.arange(0.0, now.max() + STATION, STATION), weights=volume)
    return {
        "front_m": mass.runout,
        "front_95_m": float(now[sliding][order[np.searchsorted(share, 0.95)]]) - origin,
        "travel_m": float(np.linalg.norm((displacement[:, sliding] * v).sum(axis=1)) / v.sum()),
        "slid": float(v.sum()),
        "thickness": (thickness / STATION).round(4).tolist(),
    }


def on_cells(name: str, cell: float, changes: Tables) -> Campaign:
    """A scene on cells of this size (m), two particles along each axis, as its defaults have it.

    Args:
        name: of the scene.
        cell: edge of the cells (m).
        changes: keys of tables in place of the scene's.
    """
    tables = tomllib.loads((SCENES / f"{name}.toml").read_text())
    spacing = [cell / 2] * len(tables["refined"]["spacing"])
    for grid in ("rough", "refined"):
        tables[grid] = {"cell": cell, "spacing": spacing}
    for table, keys in changes.items():
        tables[table] |= keys
    return parse(to_toml(tables))


@dataclass(frozen=True)
class Slide:
    """A slide that has ended. origin: x of the toe (m). cell: m. slid: displacement from which soil slides (m)."""

    scene: Scene
    state: State
    origin: float
    cell: float
    slid: float

    def row(self) -> Row:
        """Its measures."""
        arrays = (self.scene.particles.position, self.state.displacement, self.scene.particles.volume)
        position, displacement, volume = (np.asarray(each, float) for each in arrays)
        row = measures(position, displacement, volume, origin=self.origin, half=self.cell / 4, slid=self.slid)
        return row | {"particles": volume.size}


def of_scene(
    name: str, cell: float, *, reduction: float = 1.0, changes: Tables = NONE, numerics: Numerics = DEFAULTS
) -> Slide:
    """The slide of a scene's median soil.

    Args:
        name: of the scene.
        cell: edge of the cells (m).
        reduction: factor that divides the strength.
        changes: keys of tables in place of the scene's.
        numerics: numerical choices in place of the scene's.
    """
    campaign = on_cells(name, cell, changes)
    assert campaign.soil is not None
    choices = replace(campaign.grids["refined"], **numerics)
    scene, state = campaign.site.built(campaign.soil, choices, campaign.run.gravity, at_rest=True)
    ended = solve(reduced(scene, reduction), state, t_end=campaign.run.t_end, settle=Settle()).raise_if_failed()
    toe = campaign.site.shape.face.toe_x if campaign.site.shape.face else TOE
    return Slide(scene, ended.state, toe, cell, campaign.run.failure_displacement)


def half_slope(cell: float) -> Slide:
    """The published slope in 3D from one of its ends to its middle, a plane of symmetry, at R = 1.2.

    Args:
        cell: edge of the cells (m).
    """
    campaign = on_cells("slope", cell, {"slope": {"width": 48.0}})
    assert campaign.soil is not None
    scene, _ = campaign.site.built(campaign.soil, campaign.grids["refined"], campaign.run.gravity, at_rest=False)
    walls = tuple(replace(w, hold="roller") if (w.axis, w.side) == (1, "high") else w for w in scene.walls)
    scene = replace(scene, walls=walls)
    ended = solve(reduced(scene, 1.2), mpm.at_rest(scene), t_end=campaign.run.t_end, settle=Settle()).raise_if_failed()
    assert campaign.site.shape.face is not None
    return Slide(scene, ended.state, campaign.site.shape.face.toe_x, cell, campaign.run.failure_displacement)


TOE = 25.0
"""x of the toe (m) of the ground of the retrogressive slides, which gives none."""


def retrogression(cell: float, **soil: float) -> Row:
    """The slide of sensitive clay in its buoyant weight: how far it goes back and in how many slides, too.

    Args:
        cell: edge of the cells (m).
        soil: keys of [soil] beside the scene's.
    """
    row = sites_retrogression.slid(on_cells("sites/retrogression_5m_buoyant", cell, {"soil": soil}), "refined")
    names = {"front_m": "runout_m", "front_95_m": "runout_of_95_percent_m"}
    return {new: row[old] for new, old in names.items()} | {
        k: row[k] for k in ("retrogression_m", "slides", "particles")
    }


def clay_dam(cell: float, *, gap_memory: bool = True, numerics: Numerics = DEFAULTS) -> Slide:
    """A block of clay, 10 m long and 5 m high, beside a smooth wall; its base slides with a friction of 0.2.

    Args:
        cell: edge of the cells (m).
        gap_memory: as for `jaxmpm.Soil`.
        numerics: numerical choices in place of F-bar alone.
    """
    length, height, friction = 10.0, 5.0, 0.2
    soil = mpm.Soil(strength=10e3, unit_weight=20e3, young=1e7, poisson=0.3, tension_cutoff=0.0, gap_memory=gap_memory)
    choices = replace(mpm.Discretisation(cell, (cell / 2,) * 2, fbar=True), **numerics)
    scene, state = mpm.block(
        (length, height), soil, choices, domain=(6 * length, height + 2 * cell), corner=(0.0, 0.0),
        gravity=(0.0, -9.81), walls="roller", speed=float(np.sqrt(2 * 9.81 * height)),
    )  # fmt: skip
    walls = tuple(replace(w, hold="friction") if (w.axis, w.side) == (1, "low") else w for w in scene.walls)
    scene = replace(scene, walls=walls, wall_friction=jnp.asarray(friction, state.stress.dtype))
    ended = solve(scene, state, t_end=10.0, settle=Settle()).raise_if_failed()
    return Slide(scene, ended.state, length, cell, 0.5)


def column(aspect: float, cell: float, *, gap_memory: bool = True, numerics: Numerics = DEFAULTS) -> Slide:
    """A column of dry sand, 1 m wide.

    Args:
        aspect: height over width.
        cell: edge of the cells (m).
        gap_memory: as for `jaxmpm.FrictionalSoil`.
        numerics: numerical choices in place of those of `collapse`.
    """
    scene, final = collapse(aspect, round(1 / cell), gap_memory=gap_memory, numerics=numerics)
    return Slide(scene, final, 1.0, cell, 0.05)


def sand(aspect: float, cell: float) -> Row:
    """A column of dry sand: lengths over its width.

    Its front is where the deposit is `THICK`. `grains_m` is that of the farthest grains that lie together, the end of a
    film that a continuum has and sand has not. FLIP with the damping that the settings recommend, since APIC loses
    energy on coarse cells.

    Args:
        aspect: height over width.
        cell: edge of the cells over the width.
    """
    rate = math.sqrt(GRAVITY / aspect) / 3
    slide = column(aspect, cell, numerics={"flip": 1.0, "apic": False, "pic_damping": rate})
    row = slide.row()
    x = np.asarray((slide.scene.particles.position + slide.state.displacement)[0], float)
    thick = thick_front(x, np.asarray(slide.scene.particles.volume, float), THICK * aspect, 1 / 8) - 1
    return {"front_m": thick, "front_95_m": row["front_95_m"], "grains_m": row["front_m"], "particles": x.size}


THICK = 0.05
"""Thickness of the deposit at its front, over the height of the column.

With grains of a hundredth of the column's height these are five. On a rough base a layer of a few grains stays where a
thicker one flows (Pouliquen 1999, doi:10.1063/1.869928). The friction of the model knows no grains, so that a film runs
on ahead of its deposit, the thinner and the farther the smaller the cell.
"""


def thick_front(x: np.ndarray, volume: np.ndarray, least: float, station: float) -> float:
    """Farthest x (m) at which the soil is `least` (m) thick.

    Args:
        x: of the particles (N,) m, from 0 on.
        volume: (N,) m2.
        least: thickness (m).
        station: width of the stations (m) whose mean thickness counts, interpolated between their middles.
    """
    thickness = np.histogram(x, bins=np.arange(0.0, x.max() + 2 * station, station), weights=volume)[0] / station
    last = int(np.flatnonzero(thickness >= least)[-1])
    share = (thickness[last] - least) / (thickness[last] - thickness[last + 1])
    return float((last + 0.5 + share) * station)


def terrain(cell: float) -> Row:
    """A slide over real terrain, whose slip surface is a contact."""
    row = sites_terrain.slide(cell, contact=True)
    return {"front_m": row["runout_m"], "travel_m": row["travel_m"], "particles": row["particles"]}


@dataclass(frozen=True)
class Case:
    """A slide. cells: halved (m). default: the one that a scene would have. run: the row on cells of a size. obstacle:
    what is known to forbid convergence."""

    cells: tuple[float, ...]
    default: float
    run: Callable[[float], Row]
    obstacle: str | None = None


LONG_TOE: Tables = {"slope": {"toe": 80.0}}
SHORTER: Tables = {"ground": {"surface": [[0, 5], [20, 5], [25, 0], [105, 0]]}}
"""Ground on which float32 resolves the finest particles."""

BLOCKS = "whether one block more lets go moves the front by metres"
CASES = {
    "section_1.2": Case(
        (2, 1, 0.5, 0.25, 0.125), 1.0, lambda c: of_scene("section", c, reduction=1.2, changes=LONG_TOE).row()
    ),
    "section_1.4": Case(
        (2, 1, 0.5, 0.25), 1.0, lambda c: of_scene("section", c, reduction=1.4, changes=LONG_TOE).row()
    ),
    "sand_1": Case((1 / 16, 1 / 32, 1 / 64, 1 / 128), 1 / 32, partial(sand, 1.0)),
    "sand_2": Case((1 / 16, 1 / 32, 1 / 64, 1 / 128), 1 / 32, partial(sand, 2.0)),
    "clay_dam": Case((1, 0.5, 0.25, 0.125), 0.5, lambda c: clay_dam(c).row()),
    "retrogression": Case(
        (1, 0.5, 0.25, 0.125), 0.25, lambda c: of_scene("sites/retrogression_5m", c, changes=SHORTER).row()
    ),
    "retrogression_buoyant": Case((1, 0.5, 0.25, 0.125), 0.25, retrogression, BLOCKS),
    # Of remoulded clay: the largest measured by Locat and Demers (1988), and their range extended to the liquid limit.
    "retrogression_buoyant_0.2": Case((1, 0.5, 0.25, 0.125), 0.25, partial(retrogression, viscosity=0.2), BLOCKS),
    "retrogression_buoyant_2.5": Case((1, 0.5, 0.25, 0.125), 0.25, partial(retrogression, viscosity=2.5), BLOCKS),
    # Of smoothed particles 0.1 m apart, by an artificial viscosity of 0.1: Monaghan (2005), 10.1088/0034-4885/68/8/R01.
    "retrogression_buoyant_400": Case((1, 0.5, 0.25), 0.25, partial(retrogression, viscosity=400.0), BLOCKS),
    "terrain": Case((24, 12, 6, 3), 12.0, terrain),
    "slope_3d_1.2": Case((4, 2, 1), 2.0, lambda c: half_slope(c).row()),
}
RUN_OUTS = ("front_m", "front_95_m")


def timed(case: Case, cell: float) -> Row:
    """A row with its seconds, compilation included."""
    start = time.perf_counter()
    return {"cell_m": cell} | case.run(cell) | {"seconds": round(time.perf_counter() - start, 1)}


def compared(rows: list[Row], case: Case) -> dict[str, float]:
    """Changes of run-outs in the last two halvings, and their error on the default cell, over the finest."""
    names = [name for name in RUN_OUTS if name in rows[-1]]
    finest = rows[-1]
    steps = list(zip(rows[-3:-1], rows[-2:], strict=True))
    default = next(row for row in rows if row["cell_m"] == case.default)
    return {
        "last_two_halvings": max(abs(b[n] - a[n]) / abs(finest[n]) for a, b in steps for n in names),
        "default_error": max(abs(default[n] / finest[n] - 1) for n in names),
    }


def with_profiles(rows: list[Row]) -> list[Row]:
    """The rows with `profile` in place of thicknesses."""
    if "thickness" not in rows[-1]:
        return rows
    finest, answer = np.array(rows[-1]["thickness"]), []
    for row in rows:
        own = np.array(row["thickness"])
        both = [np.pad(each, (0, max(own.size, finest.size) - each.size)) for each in (own, finest)]
        apart = float(np.abs(both[0] - both[1]).sum() * STATION / 2 / rows[-1]["slid"])
        answer.append({k: v for k, v in row.items() if k != "thickness"} | {"profile": round(apart, 4)})
    return answer


def _row(folder: Path, name: str, case: Case, cell: float) -> Row:
    """A row that an earlier command left, or one made now."""
    return stored_row(folder, f"{name} {cell:g}", partial(timed, case, cell))


def run(quick: bool) -> Report:
    """All cases; `quick` the first three cells of the columns of sand."""
    folder = ROOT / "out" / "runout_convergence" / code_digest()
    values: dict[str, Any] = {}
    table: list[Row] = []
    for name, case in CASES.items():
        if quick and not name.startswith("sand"):
            continue
        cells = tuple(4 * cell for cell in case.cells[:3]) if quick else case.cells
        tried = replace(case, cells=cells, default=cells[1]) if quick else case
        rows = [_row(folder, name, tried, cell) if not quick else timed(tried, cell) for cell in cells]
        values |= {f"{name}_{key}": round(value, 4) for key, value in compared(rows, tried).items()}
        table += [{"case": name} | row for row in with_profiles(rows)]
    free = [name for name, case in CASES.items() if case.obstacle is None and f"{name}_default_error" in values]
    for key, named in (("last_two_halvings", "last_two_halvings_max"), ("default_error", "default_cell_error_max")):
        values[named] = max(values[f"{name}_{key}"] for name in free)
    return Report(values, table)
