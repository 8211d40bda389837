"""The published slope: particle counts, factor of safety and run-out beside the published values.

Published: Jiang et al. (2024), Computers and Geotechnics 172, 106413: rough grid stable at R = 1.25 and failing
at 1.26, refined 1.14 and 1.15, run-out 14.17 m at the refined factor of safety.
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.measure import Report, scene_campaign
from cooperative.measure import consequences
from cooperative.scene import Campaign
from jaxmpm import PlasticStrain, QuadraticBSpline, Settle, Soil, factor_of_safety, reduced, solve

TRANSFERS: dict[str, dict[str, Any]] = {
    "gimp_flip": {},
    "spline_flip": {"kernel": QuadraticBSpline},
    "spline_apic": {"kernel": QuadraticBSpline, "apic": True, "flip": 0.0},
}
"""How a slide turns, at R = 1.5. FLIP loses the spin of what rotates and APIC keeps it (`stability`): both on the same
kernel, and GIMP, which APIC does not do with."""

PUBLISHED = {"rough": {"stable": 1.25, "fails": 1.26}, "refined": {"stable": 1.14, "fails": 1.15, "runout_m": 14.17}}


def particles(campaign: Campaign, grid: str) -> int:
    """Particles of a scene on one of its grids."""
    scene, _ = campaign.site.built(campaign.soil, campaign.grids[grid], campaign.run.gravity, at_rest=False)
    return scene.particles.mass.size


def row(
    campaign: Campaign,
    grid: str,
    measure: PlasticStrain,
    *,
    resolution: float = 0.01,
    reduction: float | None = None,
    **transfers: Any,
) -> dict[str, Any]:
    """Factor of safety of a scene without random field, and what a slide does: the first one that fails, or that at a
    reduction factor. transfers: fields of the grid's `Discretisation` in place of the scene's."""
    numerics = replace(campaign.grids[grid], **transfers)
    start = time.perf_counter()
    assert isinstance(campaign.soil, Soil)
    soil = replace(campaign.soil, plastic_strain=measure)
    scene, state = campaign.site.built(soil, numerics, campaign.run.gravity, at_rest=True)
    limit = campaign.run.failure_displacement
    result = factor_of_safety(
        scene, state, bracket=(1.0, 1.6), failure_displacement=limit, resolution=resolution, batch=4
    )
    weaker = reduced(scene, result.fails if reduction is None else reduction)
    slide = solve(weaker, state, t_end=campaign.run.t_end, rules=[Settle()]).raise_if_failed()
    position, face = np.asarray(scene.particles.position), campaign.site.shape.face
    assert face is not None
    done = consequences(
        position,
        np.asarray(slide.state.displacement),
        np.asarray(scene.particles.volume),
        face,
        half_size=np.asarray(numerics.spacing) / 2,
    )
    return {
        "grid": grid,
        "y_ends": "plane strain" if campaign.dimension == 2 else campaign.site.ends,
        "cell_m": numerics.cell,
        "plastic_strain": measure.value,
        "kernel": numerics.kernel.__name__,
        "update": "APIC" if numerics.apic else "FLIP",
        "stable_R": result.stable,
        "fails_R": result.fails,
        "slides_at_R": result.fails if reduction is None else reduction,
        "runout_m": round(done.runout, 2),
        "depth_m": round(done.depth, 2),
        "largest_displacement_m": round(done.displacement, 2),
        "published": PUBLISHED[grid],
        "seconds": round(time.perf_counter() - start, 1),
    }


def run(quick: bool) -> Report:
    """Counts of paper.toml; both grids and both measures of plastic strain of paper_section.toml, and three transfers;
    fixed y ends."""
    section = scene_campaign("paper_section")
    assert isinstance(section.soil, Soil)
    measures = [PlasticStrain.ENGINEERING] if quick else list(PlasticStrain)
    grids = ["rough"] if quick else ["rough", "refined"]
    rows = [row(section, grid, measure) for measure in measures for grid in grids]
    by_grid = {r["grid"]: r for r in rows if r["plastic_strain"] == section.soil.plastic_strain.value}
    values: dict[str, Any] = {"particles_rough": particles(scene_campaign("paper"), "rough")}
    if not quick:
        values["particles_refined"] = particles(scene_campaign("paper"), "refined")
    for grid, result in by_grid.items():
        values[f"fos_{grid}"] = result["fails_R"]
    if not quick:
        rows.append(row(scene_campaign("paper"), "rough", section.soil.plastic_strain, resolution=0.02))
        values["runout_refined_m"] = by_grid["refined"]["runout_m"]
    for grid, (name, transfers) in product(grids, TRANSFERS.items()):
        turned = row(section, grid, section.soil.plastic_strain, reduction=1.5, **transfers)
        rows.append(turned)
        values |= {f"fos_{grid}_{name}": turned["fails_R"], f"runout_{grid}_{name}_m": turned["runout_m"]}
    return Report(values, rows)
