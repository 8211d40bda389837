"""The average of the volumetric strain over cells in soil with friction: fronts by cell, with it and without.

The slope is that of the published method's own example, MPM3D-F90's `Slopefail`: 20 m high, 45 degrees, 15 m of
foundation, E = 70 MPa, and the cone whose tangent is 0.3545 with an intercept of 9.74 kPa, which in plane strain is
soil of 20.8 degrees and 10.4 kPa. It slides for 8 s from its stress at rest, on the coarsest cells also from none, as
the example does. `front_m` is where the deposit is a tenth of the height thick, `foremost_m` its foremost soil, both
beyond the toe; `retreat_m` how far behind the crest soil has moved by half a metre. `cutoff` is whether tension is cut
off at 0, else at the apex of the cone as in the example. A slide that breaks off has no lengths. Without dilation and
cutoff the coarsest cells are held against the finest, with the average and without. Finished rows stay in
out/averaged_friction.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.runout_slides import thick_front
from benchmarks.measure import ROOT, Report, code_digest, sources, stored_row
from jaxmpm.laws import DruckerPrager

SHAPE = mpm.Slope(crest=30.0, height=20.0, run_per_rise=1.0, toe=60.0, foundation=15.0)
TANGENT, INTERCEPT = 0.3545, 9.74e3
"""Of the cone: sine of the friction in plane strain, and cohesion times its cosine (Pa)."""
SECONDS = 8.0
CELLS = (1.0, 0.5, 0.25)
FASTEST = 40.0
"""Speed (m/s) that the time step allows for, twice that of a fall from the crest: associated soil throws some."""
MOVED = 0.5


def soil(*, associated: bool, cutoff: bool) -> mpm.FrictionalSoil:
    """The example's soil.

    Args:
        associated: whether the dilation is the friction, else none.
        cutoff: whether tension is cut off at 0, else at the apex.
    """
    phi = math.asin(TANGENT)
    return mpm.FrictionalSoil(
        INTERCEPT / math.cos(phi),
        math.degrees(phi),
        dilation=math.degrees(phi) if associated else 0.0,
        unit_weight=2100 * 9.81,
        young=7e7,
        law=DruckerPrager,
        tension_cutoff=0.0 if cutoff else None,
    )


def slid(cell: float, *, average: bool, associated: bool, cutoff: bool, at_rest: bool = True) -> dict[str, Any]:
    """The slide on cells of this size (m).

    Args:
        cell: m.
        average: whether the volumetric strain is averaged over cells.
        associated: whether the dilation is the friction.
        cutoff: whether tension is cut off at 0.
        at_rest: whether it starts from its stress at rest, else from none.
    """
    choices = mpm.Discretisation(cell, (cell / 2,) * 2, cfl=0.9, cell_average=average, air=5.0)
    scene, state = mpm.slope(SHAPE, soil(associated=associated, cutoff=cutoff), choices, at_rest=at_rest, speed=FASTEST)
    ended = mpm.solve(scene, state, t_end=SECONDS)
    if ended.broke_off:
        return {
            "front_m": None,
            "foremost_m": None,
            "retreat_m": None,
            "status": mpm.Status(int(ended.state.status)).name,
        }
    position, moved, volume = (
        np.asarray(array, float)
        for array in (scene.particles.position, ended.state.displacement, scene.particles.volume)
    )
    x, above = (position + moved)[0], (position + moved)[1] > SHAPE.foundation
    behind = position[0][(np.linalg.norm(moved, axis=0) >= MOVED) & (position[1] > SHAPE.foundation)].min()
    return {
        "front_m": round(thick_front(x[above], volume[above], SHAPE.height / 10, 1.0) - SHAPE.toe_x, 2),
        "foremost_m": round(float(x[above].max()) + cell / 4 - SHAPE.toe_x, 2),
        "retreat_m": round(SHAPE.crest - float(behind) + cell / 4, 2),
        "status": mpm.Status(int(ended.state.status)).name,
    }


def run(quick: bool) -> Report:
    """All slides; `quick` on the coarsest cells."""
    folder = ROOT / "out" / "averaged_friction" / code_digest(*sources(run, thick_front))
    cases: list[dict[str, Any]] = [
        {"cell": cell, "average": average, "associated": associated, "cutoff": cutoff, "at_rest": at_rest}
        for cell in (CELLS[:1] if quick else CELLS)
        for cutoff in (False, True)
        for associated in (False, True)
        for at_rest in ((True, False) if cell == CELLS[0] else (True,))
        for average in (False, True)
    ]
    rows = [
        case | stored_row(folder, " ".join(f"{value:g}" for value in case.values()), partial(slid, **case))
        for case in cases
    ]
    values = {
        f"front_{name}_coarse_over_{judge}_finest": over_finest(rows, average, judging)
        for name, average in NAMES.items()
        for judge, judging in NAMES.items()
    }
    return Report(values, rows)


NAMES = {"averaged": True, "local": False}


def over_finest(rows: list[dict[str, Any]], average: bool, judging: bool) -> float | None:
    """Front on the coarsest cells over that on the finest, both averaged or not, without dilation and cutoff."""
    plain = [row for row in rows if row["at_rest"] and not row["associated"] and not row["cutoff"]]
    coarse = next(row["front_m"] for row in plain if row["average"] is average)
    finest = next(row["front_m"] for row in reversed(plain) if row["average"] is judging)
    return None if coarse is None or finest is None else coarse / finest
