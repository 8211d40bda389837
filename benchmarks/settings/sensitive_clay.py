"""What real clay has and the published one has not, one at a time: run-out of a slide in sensitive clay.

The slope of `benchmarks.sites.sites_retrogression` under water, by numbers that were measured elsewhere, none fitted: a
strength that grows with the rate of strain, and remoulding over a strain of 10 (Einav and Randolph 2005,
10.1002/nme.1350), and Bingham's viscosity: 2.5 Pa s are at the clay's liquid limit, where a power law through what was
measured ends (docs/soils.md). 400 Pa s is about what the artificial viscosity of smoothed particles acts as
(Monaghan 2005, 10.1088/0034-4885/68/8/R01). `runout_m` is where a tenth of the height of the deposit is left,
`runout_foremost_m` its foremost soil; of a slope that stands both are 0. Rows that have been made stay in
out/sensitive_clay.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from benchmarks.measure import ROOT, Report, code_digest, stored_row
from benchmarks.sites.sites_retrogression import PUBLISHED, SCENES, slid
from cooperative.scene import parse, read_scene

SCENE = "retrogression_5m_buoyant"
CLAYS: dict[str, dict[str, float]] = {
    "as published": {},
    "rate effect of 0.1": {"rate_coefficient": 0.1},
    "remoulded by a strain of 10": {"strain_95": 10.0},
    "viscosity of 2.5 Pa s": {"viscosity": 2.5},
    "viscosity of 400 Pa s": {"viscosity": 400.0},
}
FINEST = "half of the refined cell"
COUNTED = ("cell_m", "runout_m", "runout_foremost_m", "retrogression_m", "slides")


def row(clay: str, grid: str) -> dict[str, Any]:
    """The slide of the mean soil of a clay, on one of the scene's grids, or on cells half as large as the refined."""
    campaign = parse(read_scene(SCENES / f"{SCENE}.toml"))
    if grid == FINEST:
        refined = campaign.refined
        halved = replace(refined, cell=refined.cell / 2, spacing=tuple(edge / 2 for edge in refined.spacing))
        campaign, grid = replace(campaign, refined=halved), "refined"
    found = slid(replace(campaign, soil=replace(campaign.soil, **CLAYS[clay])), grid)
    return {"clay": clay, **{name: found[name] for name in COUNTED}}


def run(quick: bool) -> Report:
    """All clays; `quick` on the rough grid."""
    folder = ROOT / "out" / "sensitive_clay" / code_digest((SCENES / f"{SCENE}.toml").read_text())
    grids = ("rough",) if quick else ("rough", "refined", FINEST)
    rows = [stored_row(folder, f"{clay} {grid}", partial(row, clay, grid)) for clay in CLAYS for grid in grids]
    last = {one["clay"]: one["runout_m"] for one in rows}
    values = {f"{clay.replace(' ', '_')}_runout_m": last[clay] for clay in CLAYS}
    return Report(values | {"runout_published_m": PUBLISHED["runout_m"]}, rows)
