"""Tables of the ground: `[slope]`, `[ground]`, `[terrain]` and `[water]`."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import MinLen
from pydantic import Strict

from cooperative.scene.tables._key import Depth, FromZero, Length, Line, Metres, Pair, Raster, Rows, Table, Within, key
from jaxmpm import Limit, soil_limits

_WALLS = "two numbers, the lower one first"


class Slope(Table):
    """A simple slope. Lengths are multiples of the spacing of both grids."""

    crest: Length = key("Length of the level ground above.", 20.0)
    height: Length = key("Height of the slope.", 12.0)
    run_per_rise: FromZero = key(
        "Cotangent of the slope's angle.", 2.0,
        synonyms="slope_ratio ratio angle slope_angle inclination cotangent",
    )  # fmt: skip
    toe: Length = key("Length of the level ground below, on which a slide runs out.", 48.0)
    foundation: Depth = key("Depth of soil below the toe, down to rock.", 4.0, synonyms="base_thickness bedrock_depth")
    width: Length | None = key("Width along the slope.", 96.0, None, otherwise="none: a section in plane strain")
    y_ends: Literal["fixed", "roller"] = key("What holds the ends of a slope of finite width.", "fixed", "fixed")


class Interface(Table):
    """Strength of the contact of soil with the base."""

    friction: Annotated[float, Within(soil_limits()["friction"])] = key("Angle of friction.", 10.0)
    cohesion: Annotated[float, Within(soil_limits()["cohesion"])] = key("Cohesion.", 0.0, 0.0)


class Ground(Table):
    """Ground that you draw, a section in plane strain, in the place of `[slope]`. Lines are points `[[x, z], ...]` with
    x rising, or name a file beside the scene: points as CSV, or a DXF drawing in metres with one polyline, or with one
    in the layer that stands after `#`, as in `"section.dxf#GROUND"` (extra `sections`). The distance of the walls is a
    multiple of both cells."""

    surface: Line = key(
        "The surface, from wall to wall.", [[0, 12], [20, 12], [44, 0], [92, 0]], units="m",
        synonyms="points polyline profile coordinates",
    )  # fmt: skip
    base: Metres = key("Height of the rigid base.", -4.0, 0.0)
    walls: Pair[Metres] | None = key(
        "Where the ground ends.", [0.0, 92.0], None, otherwise="the ends of the surface", allowed=_WALLS
    )
    toe: Metres | None = key(
        "x of the toe of a slope, a point of the surface at which it stops falling along x or falls less steeply. "
        "Run-out is then counted beyond it, depth below the crest, and failures have modes, as of a `[slope]`.",
        54.0,
        None,
        otherwise="none: run-out from the rear of a slide to its front",
    )
    crest: Metres | None = key(
        "x of the slope's crest, from which its height is counted.", 30.0, None,
        otherwise="where the surface before the toe is highest",
    )  # fmt: skip
    ends: Literal["roller", "fixed", "left fixed", "right fixed"] = key(
        "What holds the ground at its walls, the other one of two on a roller. For a free face draw the surface down "
        "to the base, and on along it.",
        "roller",
        "roller",
    )
    interface: Interface | None = key(
        "Strength of the contact of soil with the base, on which soil then slides: of a joint, or a weak seam on rock "
        "too thin for the cells. They do not vary, and strength reduction divides them too.",
        {"friction": 10.0, "cohesion": 0.0},
        None,
        otherwise="none: soil sticks to the base",
    )


class Terrain(Table):
    """Ground under a terrain model, in the place of `[slope]`. Rasters are ESRI ASCII grids or GeoTIFFs in metres
    beside the scene. Boxes that the surface cuts keep their share of volume and mass."""

    surface: Raster = key("File of the heights of the ground.", "terrain.asc", units="m")
    base: Metres = key("Height of the rigid base.", 80.0)
    x: Pair[Metres] | None = key(
        "Walls along x, a multiple of both cells apart.", [0.0, 200.0], None, otherwise="the surface's ends",
        allowed=_WALLS,
    )  # fmt: skip
    y: Pair[Metres] | None = key(
        "Walls along y, likewise.", [0.0, 120.0], None, otherwise="the surface's ends", allowed=_WALLS
    )
    step: Length | None = key(
        "Step to which the surface's raster is resampled.", 2.0, None, otherwise="that of the surface"
    )
    origin: Pair[Metres] | None = key(
        "Where x = 0 and y = 0 lie in the projection of the surface's file; exported maps lie there. Give heights "
        "from a corner: single precision takes no coordinates of millions of metres.",
        [689000.0, 5334000.0],
        None,
        otherwise="`[0.0, 0.0]`",
        allowed="x and y",
    )
    ends: Literal["roller", "fixed"] = key(
        "What holds the ground at its walls; for a free face see `cut`.", "roller", "roller"
    )
    polygon: Annotated[tuple[Pair[Metres], ...], Strict(False), MinLen(3)] | None = key(
        "Corners in plan of the part that is kept; what lies around it is left out.",
        [[20, 10], [180, 10], [180, 110], [20, 110]],
        None,
        otherwise="not used: all is kept",
        allowed="three or more corners [x, y]",
    )
    depth: Length | None = key(
        "Depth below the surface down to which ground is kept; the cut stands still.", 15.0, None,
        otherwise="not used: kept down to the base",
    )  # fmt: skip
    cut: Literal["fixed", "free"] = key(
        "What holds the ground along its polygon: free is as if the soil around had been dug away.", "fixed", "fixed"
    )
    run_out_line: Rows | None = key(
        "Line in plan along which run-out is measured, straight on beyond its ends.",
        [[20, 60], [90, 60], [180, 80]],
        None,
        units="m",
        otherwise="along the mean displacement of the slide",
        allowed="two or more points [x, y]",
    )


class Water(Table):
    """Water in the drawn ground, and above it: one of these keys."""

    level: Metres | None = key("Height of the water, in the ground and above it.", 3.0, None)
    table: Line | None = key(
        "Of a section, height of the water as a line from wall to wall.", [[0, 8], [44, 0], [92, 0]], None, units="m"
    )
    raster: Raster | None = key("Of a terrain, file of the heights of the water table.", "water.asc", None, units="m")
    depth: Depth | None = key(
        "Depth of the water table below the surface.", 2.0, None,
        remedy=", or a level for water that stands on the ground",
    )  # fmt: skip
    r_u: Annotated[float, Within(Limit(least=0, below=1))] | None = key(
        "Pore pressure over the weight of the soil above.", 0.25, None
    )
