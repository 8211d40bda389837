"""What is allowed in a scene and seldom meant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from cooperative.estimate import Subset, SubsetPlan
from cooperative.scene._campaign import Campaign
from cooperative.scene.tables import RandomField
from jaxmpm import FrictionalSoil, Raster, ground
from jaxmpm.ground import as_section
from jaxmpm.support.text import shown

TOP = 0.95
"""Share of the height of the ground from which on an element at risk stands at the crest."""


def remarks(campaign: Campaign) -> Iterator[str]:
    """What a reader of a scene should know before it runs.

    Args:
        campaign: of the scene.

    Yields:
        Sentences.
    """
    shape = campaign.site.shape
    surface = getattr(shape, "surface", None)
    if isinstance(surface, Raster):
        lower, upper = np.array(shape.corner), np.array(shape.corner) + shape.extent
        for axis, ends, walls in zip("xy", surface.ends, zip(lower, upper, strict=True), strict=False):
            if 0 < ends[1] - walls[1] < 4 * campaign.rough.cell and ends[0] == walls[0]:
                yield (
                    f"the surface reaches from {axis} = {ends[0]:g} to {ends[1]:g} m, and the wall stands at "
                    f"{walls[1]:g} m, a multiple of the cells: the last {ends[1] - walls[1]:.3g} m are left out"
                )
    base, relief = shape.corner[-1] + shape.extent[-1] - ground.relief(shape), ground.relief(shape)
    for element in campaign.elements_at_risk:
        corners = np.array(element.corners, float).T
        if len(corners) == campaign.dimension - 1 and relief > 0:
            heights = shape.heights(*corners)
            if float(np.min(heights)) >= base + TOP * relief:
                yield (
                    f"{element.name} stands at the crest, at z = {np.min(heights):.4g} m of {base + relief:.4g} m"
                    f"; x = {shape.corner[0]:g} is the rear of the ground. No slide comes over it from above: what "
                    "counts there is whether its own ground is carried away, which has no loss"
                )
    fields = [
        item
        for random in (campaign.random, *(layer.random for layer in campaign.site.layers))
        for item in random.items()
    ]
    yield from _unresolved(fields, campaign.refined.cell)
    yield from _of_sizes(campaign)
    yield from _of_cuts(campaign)
    yield from _of_levels(campaign)
    yield from _of_dilation(campaign)
    yield from _of_gaps(campaign)
    yield from _of_ends(campaign)
    rows = {(name, *row): row for name, varies in fields for row in varies.boreholes or ()}
    points = np.array([row[:-1] for row in rows.values()], float).reshape(-1, campaign.dimension).T
    high = points[-1] > shape.heights(*points[:-1]) if rows else np.zeros(0, bool)
    above = [key for key, is_above in zip(rows, high, strict=True) if is_above]
    if above:
        yield (
            f"{len(above)} borehole values lie above the ground, such as that of {above[0][0]} at "
            f"{list(above[0][1:-1])} m: they condition the field there, is z an elevation in metres?"
        )


SMALL = 1e-3
"""Failure displacement, over the height of the slope, below which soil that stands moves as far as it settles."""

FEW = 4.0
"""Cells over the height of a slope below which the rough grid hardly knows a slide."""


def _of_sizes(campaign: Campaign) -> Iterator[str]:
    """A displacement that is none, a slope of few cells, and layers that share a name."""
    shape, run = campaign.site.shape, campaign.run
    relief = ground.relief(shape)
    if run.failure != "limit load" and 0 < run.failure_displacement < SMALL * relief:
        yield (
            f"failure_displacement = {run.failure_displacement:g} m, less than a thousandth of the slope's height of "
            f"{relief:.4g} m: soil that stands yields and settles so far, and counts as a failure; give "
            f"{10 * SMALL * relief:.2g} m or more"
        )
    if 0 < relief < FEW * campaign.rough.cell:
        yield (
            f"the slope is {relief:.4g} m high, {relief / campaign.rough.cell:.2g} cells of {campaign.rough.cell:g} m "
            f"of the rough grid, which hardly resolves a slide: give cells of at most {relief / FEW:.3g} m"
        )
    names = [layer.name for layer in campaign.site.layers]
    for name in dict.fromkeys(name for name in names if names.count(name) > 1):
        yield (
            f"{names.count(name)} layers are called {shown(name)}: messages, figures and tables do not tell them "
            "apart; give each its own name"
        )


LEVEL = 250
"""Samples of a level in each replicate of subset simulation, below which P_f comes out some 10 % too high or more."""


def _of_levels(campaign: Campaign) -> Iterator[str]:
    """Levels of subset simulation with few samples."""
    if not isinstance(campaign.estimator, Subset):
        return
    replicates = campaign.estimator.replicates or SubsetPlan.replicates
    per_replicate = campaign.plan.samples // replicates
    if per_replicate < LEVEL:
        yield (
            f"levels of {per_replicate} samples in each of {replicates} replicates: in trials P_f came out too high by "
            f"100 % with 20, 35 % with 50, 20 % with 100 and 9 % with {LEVEL}; give samples = "
            f"{LEVEL * replicates:,} or more"
        )


def _of_cuts(campaign: Campaign) -> Iterator[str]:
    """Trends that count from the top of a layer, where the surface has cut it."""
    site, shape = campaign.site, as_section(campaign.site.shape)
    if shape is None or not site.layers:
        return
    x, heights = shape.boundaries([part.layer for part in site.layers])
    for number, layer in enumerate(site.layers):
        names = [name for name, field in layer.random.items() if field.trend and field.trend_from == "layer"]
        cut = (heights[number] >= heights[0] - 1e-6) & (heights[number] > heights[number + 1] + 1e-6)
        falls = float(np.ptp(heights[0][cut])) if cut.any() else 0.0
        if names and layer.top is None and falls > OUTCROP * ground.relief(shape):
            first, last = x[cut][[0, -1]]
            yield (
                f"{layer.label} lies at the surface from x = {first:.4g} to {last:.4g} m, over {falls:.3g} m of "
                f"height, and the trend of its {names[0]} counts from there: if the slope is a cut, give the layer's "
                "top before it (top = its elevation)"
            )


OUTCROP = 0.1
"""Height over which a layer lies at the surface, over that of the ground, from which on a face cuts it."""


def _of_dilation(campaign: Campaign) -> Iterator[str]:
    """Soil that dilates for ever."""
    for soil in [layer.layer.soil for layer in campaign.site.layers] or [campaign.soil]:
        dilation = getattr(soil, "dilation", None)
        if dilation and dilation > 0 and getattr(soil, "softening_strain", None) is None:
            yield (
                f"dilation = {dilation:g} degrees without softening_strain: soil gains volume for as long as it "
                "shears, and in a long slide energy with it, with cell_average most; give softening_strain, by which "
                "dilation ends, or leave dilation out where run-out counts"
            )


def _of_ends(campaign: Campaign) -> Iterator[str]:
    """Runs that end before the soil has lost its strength, and deposits that no slide leaves."""
    last = campaign.run.last("refined")
    for soil in [layer.layer.soil for layer in campaign.site.layers] or [campaign.soil]:
        if (loss := getattr(soil, "loss_time", None)) and loss > last:
            yield (
                f"loss_time = {loss:g} s, beyond the {last:g} s at which runs end, when {100 * last / loss:.0f} % of "
                f"the loss has come: give t_end = {loss:g} or more"
            )
    if campaign.runout_thickness >= campaign.site.height:
        yield (
            f"runout_thickness = {campaign.runout_thickness:g} m, no less than the slope's height of "
            f"{campaign.site.height:.3g} m: no deposit is so thick, and run-outs are 0; give less, or leave it out"
        )


def _of_gaps(campaign: Campaign) -> Iterator[str]:
    """Soil with friction and without cohesion that forgets how far it has opened."""
    for soil in [layer.layer.soil for layer in campaign.site.layers] or [campaign.soil]:
        if isinstance(soil, FrictionalSoil) and soil.cohesion == 0 and soil.tension_cutoff is None:
            yield (
                f"cohesion = 0 with friction = {soil.friction:g} degrees and without tension_cutoff: soil that opens "
                "forgets its gap, and grains of a long slide are thrown out of the grid or outrun the time step; where "
                "run-out counts give tension_cutoff = 0, which takes no strength from soil without cohesion"
            )
            return


def _unresolved(fields: Iterable[tuple[str, RandomField]], cell: float) -> Iterator[str]:
    """Correlation lengths of less than two cells (m)."""
    lengths: dict[str, float] = {}
    for name, varies in fields:
        lengths[name] = min(lengths.get(name, math.inf), *varies.length)
    for name, length in lengths.items():
        if length < 2 * cell * (1 - 1e-9):
            yield (
                f"{name} has a correlation length of {length:g} m, less than two cells of {cell:g} m of the refined "
                f"grid, which does not resolve it: results change with the cell, give cells of at most {length / 2:g} m"
            )
