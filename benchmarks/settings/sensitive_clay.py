"""What real clay has and the published one has not, one at a time: run-out of a slide in sensitive clay.

The slope of `benchmarks.sites.sites_retrogression` under water, by numbers that were measured elsewhere, none fitted: a
strength that grows with the rate of strain, and remoulding over a strain of 10 (Einav and Randolph 2005,
10.1002/nme.1350), and Bingham's viscosity: 2.5 Pa s are at the clay's liquid limit, where a power law through what was
measured ends (docs/soils.md). 400 Pa s is about what the artificial viscosity of smoothed particles acts as
(Monaghan 2005, 10.1088/0034-4885/68/8/R01). The publication has the slope 8 m high, too, of which its run-out is known
and its ground is not: here it is the same, larger, with a crest of 32 m. `runout_m` is where a tenth of the height of
the deposit is left, `runout_foremost_m` its foremost soil; of a slope that stands both are 0. A dam of the remoulded
clay stands beside theory (`benchmarks.settings.remoulded_clay`). Rows that have been made stay in out/sensitive_clay.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from benchmarks.accuracy import runout_slides
from benchmarks.accuracy.runout_slides import NONE, Tables, on_cells
from benchmarks.measure import ROOT, Report, code_digest, sources, stored_row
from benchmarks.settings import remoulded_clay
from benchmarks.settings.remoulded_clay import by_theory, of_dam
from benchmarks.sites import sites_retrogression
from benchmarks.sites.sites_retrogression import PUBLISHED, slid

SCENE = "retrogression_5m_buoyant"
CLAYS: dict[str, dict[str, float]] = {
    "as published": {},
    "rate effect of 0.1": {"rate_coefficient": 0.1},
    "remoulded by a strain of 10": {"strain_95": 10.0, "unusual": True},
    "viscosity of 2.5 Pa s": {"viscosity": 2.5},
    "viscosity of 400 Pa s": {"viscosity": 400.0},
}
HIGHER: Tables = {"ground": {"surface": [[0, 8], [32, 8], [40, 0], [125, 0]]}, "run": {"failure_displacement": 0.8}}
PUBLISHED_RUNOUT = {5: PUBLISHED["runout_m"], 8: 41.0}
COUNTED = ("cell_m", "runout_m", "runout_foremost_m", "retrogression_m", "slides")
CELLS = (0.5, 0.25, 0.125)


def row(height: int, clay: str, cell: float) -> dict[str, Any]:
    """The slide of the mean soil of a clay, of the slope 5 or 8 m high, on cells of this size (m)."""
    changes: Tables = {"soil": CLAYS[clay], **(HIGHER if height == 8 else NONE)}
    found = slid(on_cells(f"sites/{SCENE}", cell, changes), "refined")
    return {"height_m": height, "clay": clay, **{name: found[name] for name in COUNTED}}


def run(quick: bool) -> Report:
    """All clays; `quick` on the largest cells."""
    scene = sites_retrogression.SCENES / f"{SCENE}.toml"
    code = sources(row, remoulded_clay, runout_slides, sites_retrogression, scene)
    folder = ROOT / "out" / "sensitive_clay" / code_digest(*code)
    cells = CELLS[:1] if quick else CELLS
    slopes = [(5, clay) for clay in CLAYS] + [(8, "as published"), (8, "viscosity of 400 Pa s")]
    rows = [
        stored_row(folder, f"{height} {clay} {cell:g}", partial(row, height, clay, cell))
        for height, clay in slopes
        for cell in cells
    ]
    dams = [
        stored_row(folder, f"dam {viscosity} {cell:g}", partial(of_dam, cell, viscosity))
        for viscosity in (None, 400.0)
        for cell in cells
    ]
    dams += by_theory()
    last = {f"{one['height_m']}_m_{one['clay'].replace(' ', '_')}_runout_m": one["runout_m"] for one in rows}
    last |= {f"dam_{one['dam'].replace(', ', '_').replace(' ', '_')}_runout_m": one["runout_m"] for one in dams}
    published = {f"{height}_m_runout_published_m": front for height, front in PUBLISHED_RUNOUT.items()}
    return Report(last | published, rows + dams)
