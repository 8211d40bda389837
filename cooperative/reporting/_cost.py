"""What a campaign will cost, in words for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from cooperative.runs import Cost, reach_of, warnings_of
from cooperative.scene import Campaign
from jaxmpm import ground


def words_of_cost(scene: Campaign, cost: Cost) -> Iterator[str]:
    """A campaign's cost in words.

    Args:
        scene: the campaign.
        cost: of it.

    Yields:
        Lines.
    """
    unit = "m3" if scene.dimension == 3 else "m2"
    yield scene.name
    shape = scene.site.shape
    yield f"  ground         {' x '.join(f'{edge:g}' for edge in shape.extent)} m, {ground.volume(shape):.4g} {unit}"
    for layer, thickness in zip(scene.site.layers, scene.site.thicknesses, strict=True):
        rock = ", rock" if layer.rock and layer.name != "rock" else ""
        cells = {grid: thickness.metres / scene.grids[grid].cell for grid in scene.grids}
        few = [grid for grid in scene.grids if thickness.too_thin(scene.grids[grid].cell)]
        yield (
            f"  layer          {layer.name}{rock}, {thickness.metres:.3g} m thick: "
            + ", ".join(f"{count:.2g} {grid} cells" for grid, count in cells.items())
            + (f"; a weak layer, too strong on the {' and the '.join(few)} grid" if few else "")
        )
    reach = reach_of(scene)
    if reach is not None:
        yield (
            f"  beyond the toe {reach.ground:g} m of ground; all soil above the toe, with mean residual strength and "
            f"losses at its base alone, would run {reach.slide:.0f} m"
        )
    for grid, size in cost.sizes.items():
        most = "at most " if grid == "refined" else ""
        runs = f"{most}{cost.runs[grid]:,} runs" if scene.varies else "a run"
        here = f", {cost.step[grid] * 1e3:.3g} ms each here" if cost.step else ""
        yield (
            f"  {grid + ' grid':<14} {size.particles:,.0f} particles, {size.nodes:,.0f} nodes; {runs} of "
            f"{size.steps:,.0f} steps{here}"
        )
    if not scene.varies:
        yield "  random         nothing: `jaxmpm slide` and `jaxmpm fos` take this scene, `jaxmpm run` does not"
    yield from (f"  WARNING        {remark}" for remark in warnings_of(scene))
    yield f"  memory         {cost.memory / 1e9:.2g} GB for all grids in one process"
    if not cost.step:
        yield "  time           not measured: add --measure, which tries a run of each grid for some seconds"
        return
    hours = {grid: cost.hours(grid) for grid in cost.sizes}
    estimates = ", ".join(f"{hours[grid]:.3g} on the {grid} grid" for grid in hours)
    yield f"  time           at most {sum(hours.values()):.3g} hours of one core, {estimates}; many runs end sooner"
