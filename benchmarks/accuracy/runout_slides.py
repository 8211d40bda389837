"""Slides whose run-out is measured against the cell: sections, half a slope, clay, columns of sand, terrain.

Sources of the column of sand: Lube et al. (2005), 10.1103/PhysRevE.72.041301; Lajeunesse et al. (2005),
10.1063/1.2087687.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.collapse import DEFAULTS, GRAVITY, Criterion, Numerics, collapse
from benchmarks.measure import ROOT, Source
from benchmarks.sites import sites_retrogression, sites_terrain
from cooperative.measure import consequences
from cooperative.scene import Campaign, parse, to_toml
from jaxmpm import Face, Scene, Settle, State, reduced, solve
from jaxmpm.laws import MohrCoulomb

Row = dict[str, Any]
Tables = Mapping[str, Mapping[str, object]]
"""Keys of tables in place of a scene's."""

NONE: Tables = {}
LONG_TOE: Tables = {"slope": {"toe": 80.0}}
SCENES = ROOT / "benchmarks" / "scenes"
SLIDES: tuple[Source, ...] = (
    Path(__file__),
    collapse,
    sites_retrogression,
    sites_terrain,
    *(SCENES / f"{name}.toml" for name in ("section", "slope")),
    *sorted((SCENES / "sites").glob("retrogression_5m*.toml")),
)
"""What slides are made of, for `benchmarks.measure.sources`."""
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

    Raises:
        ValueError: nothing slides.
    """
    distance = np.linalg.norm(displacement, axis=0)
    sliding = distance >= slid
    if not sliding.any():
        raise ValueError(f"the largest displacement is {distance.max():.3g} m, below {slid:g} m: take a finer cell")
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
        "foremost_m": mass.runout_foremost,
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
        position, displacement, volume = (np.asarray(array, float) for array in arrays)
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
    ended = solve(reduced(scene, reduction), state, t_end=campaign.run.t_end, rules=[Settle()]).raise_if_failed()
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
    walls = tuple(replace(w, hold="roller") if (w.axis, w.side) == (1, "high") else w for w in scene.boundary.walls)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls))
    ended = solve(reduced(scene, 1.2), mpm.at_rest(scene), t_end=campaign.run.t_end, rules=[Settle()]).raise_if_failed()
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
    names = {"front_m": "runout_m", "foremost_m": "runout_foremost_m", "front_95_m": "runout_of_95_percent_m"}
    return {new: row[old] for new, old in names.items()} | {
        k: row[k] for k in ("retrogression_m", "slides", "particles")
    }


def clay_dam(cell: float, *, gap_memory: bool = True, numerics: Numerics = DEFAULTS) -> Slide:
    """A block of clay, 10 m long and 5 m high, beside a smooth wall; its base slides with a friction of 0.2.

    Args:
        cell: edge of the cells (m).
        gap_memory: as for `jaxmpm.Soil`.
        numerics: numerical choices in place of the average over cells alone.
    """
    length, height, friction = 10.0, 5.0, 0.2
    soil = mpm.Soil(strength=10e3, unit_weight=20e3, young=1e7, poisson=0.3, tension_cutoff=0.0, gap_memory=gap_memory)
    choices = replace(mpm.Discretisation(cell, (cell / 2,) * 2, cell_average=True), **numerics)
    scene, state = mpm.block(
        (length, height), soil, choices, domain=(6 * length, height + 2 * cell), corner=(0.0, 0.0),
        gravity=(0.0, -9.81), walls="roller", speed=float(np.sqrt(2 * 9.81 * height)),
    )  # fmt: skip
    walls = tuple(replace(w, hold="friction") if (w.axis, w.side) == (1, "low") else w for w in scene.boundary.walls)
    coefficient = jnp.asarray(friction, state.stress.dtype)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls, friction=coefficient))
    ended = solve(scene, state, t_end=10.0, rules=[Settle()]).raise_if_failed()
    return Slide(scene, ended.state, length, cell, 0.5)


def column(
    aspect: float,
    cell: float,
    *,
    criterion: Criterion = MohrCoulomb,
    gap_memory: bool = True,
    numerics: Numerics = DEFAULTS,
    start: int = 0,
) -> Slide:
    """A column of dry sand, 1 m wide.

    Args:
        aspect: height over width.
        cell: edge of the cells (m).
        criterion: class of the law.
        gap_memory: as for `jaxmpm.FrictionalSoil`.
        numerics: numerical choices in place of those of `collapse`.
        start: as for `collapse`.
    """
    scene, final = collapse(
        aspect, round(1 / cell), criterion=criterion, gap_memory=gap_memory, numerics=numerics, start=start
    )
    return Slide(scene, final, 1.0, cell, 0.05)


def sand(aspect: float, cell: float, *, criterion: Criterion = MohrCoulomb, start: int = 0) -> Row:
    """A column of dry sand: lengths over its width.

    Its front is where the deposit is `THICK`. Its foremost soil, the farthest grains that lie together, is the end of a
    film that a continuum has and sand has not. The scheme, USL, and the damping by XPIC(2) are those that the settings
    recommend for sand. APIC loses energy on coarse cells. With MUSL the waves that the flow sends into the heap stay,
    and sand that rings creeps.

    Args:
        aspect: height over width.
        cell: edge of the cells over the width.
        criterion: class of the law.
        start: as for `collapse`.
    """
    rate = math.sqrt(GRAVITY / aspect)
    choices: Numerics = {"scheme": mpm.Scheme.USL, "flip": 1.0, "apic": False, "pic_damping": rate, "xpic": 2}
    slide = column(aspect, cell, criterion=criterion, numerics=choices, start=start)
    row = slide.row()
    x = np.asarray((slide.scene.particles.position + slide.state.displacement)[0], float)
    thick = thick_front(x, np.asarray(slide.scene.particles.volume, float), THICK * aspect, 1 / 8) - 1
    return {"front_m": thick, "front_95_m": row["front_95_m"], "foremost_m": row["foremost_m"], "particles": x.size}


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
    fronts = {"front_m": row["runout_m"], "foremost_m": row["runout_foremost_m"]}
    return fronts | {"travel_m": row["travel_m"], "particles": row["particles"]}
