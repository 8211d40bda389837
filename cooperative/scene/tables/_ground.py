"""Tables of the ground: `[slope]`, `[ground]`, `[terrain]` and `[water]`."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import model_validator as validates

import jaxmpm as mpm
from cooperative.scene.tables._key import (
    Depth,
    Length,
    Line,
    Metres,
    Only,
    OrFile,
    OrTable,
    Pair,
    Part,
    Polygon,
    Raster,
    Rows,
    Within,
    key,
    table,
)
from cooperative.scene.tables._level import RandomLevel
from cooperative.scene.tables._varying import RandomField
from jaxmpm.soil import soil_limits
from jaxmpm.support.check import Invalid, Limit

_WALLS = "two numbers, the lower one first"


def _of_slope(size: str) -> Within:
    return Within(mpm.Slope.LIMITS[size])


@table
class SlopeTable(Part):
    """A simple slope, without layers and without water: draw a `[ground]` for these.

    x = 0 is its rear wall, z = 0 its base; the toe lies at x = `crest` + `height` * `run_per_rise`. Lengths are
    multiples of the spacing of both grids.
    """

    crest: Annotated[float, _of_slope("crest")] = key("Length of the level ground above.", 20.0)
    height: Annotated[float, _of_slope("height")] = key("Height of the slope.", 12.0)
    run_per_rise: Annotated[float, _of_slope("run_per_rise")] = key(
        "Cotangent of the slope's angle.", 2.0,
        synonyms="slope_ratio ratio angle slope_angle inclination cotangent",
    )  # fmt: skip
    toe: Annotated[float, _of_slope("toe")] = key("Length of the level ground below, on which a slide runs out.", 48.0)
    foundation: Annotated[float, _of_slope("foundation")] = key(
        "Depth of soil below the toe, down to rock.", 4.0, synonyms="base_thickness bedrock_depth"
    )
    width: Annotated[float, _of_slope("width")] | None = key(
        "Width along the slope.", 96.0, None, otherwise="none: a section in plane strain"
    )
    y_ends: Literal["fixed", "roller"] = key("What holds the ends of a slope of finite width.", "fixed", "fixed")


@table
class InterfaceTable(Part):
    """Strength of the contact of soil with the base."""

    friction: OrTable[Annotated[float, Within(soil_limits()["friction"])] | Literal["soil"], RandomField] = key(
        'Angle of friction. `"soil"`: that of the soil which lies on it at the start, 0 of undrained soil. A table, '
        "`[ground.interface.friction]` with the keys of `[strength]`: a random field, which "
        "`cross_correlation` calls `interface_friction`.",
        10.0,
        units="degrees",
    )
    cohesion: OrTable[Annotated[float, Within(soil_limits()["cohesion"])] | Literal["soil"], RandomField] = key(
        'Cohesion. `"soil"`: that of the soil, of undrained soil its strength, which slip takes as the strain of a '
        "shear band in that soil does, unless `slip_length` is given. Or a table, likewise, called "
        "`interface_cohesion`.",
        0.0,
        0.0,
        units="Pa",
    )
    residual_ratio: Annotated[float, Within(soil_limits()["residual_ratio"])] = key(
        "Share of tan(friction) and of cohesion that slip leaves. Below 1 give `slip_length` too.", 0.5, 1.0,
        synonyms="residual residual_strength",
    )  # fmt: skip
    slip_length: Annotated[float, Within(Limit(above=0, unit="m"))] | None = key(
        "Slip over which both fall to that share, linearly.", 0.3, None, units="m", otherwise="none: no softening",
        synonyms="slip_weakening_distance softening_length slip",
    )  # fmt: skip

    @validates(mode="after")
    def _at_nodes(self) -> Self:
        for name in ("friction", "cohesion"):
            field = getattr(self, name)
            if isinstance(field, RandomField) and field.sampled_at != "particles":
                rule = "is of particles; the field of a contact is taken at the nodes of the grid"
                raise Invalid((name, "sampled_at"), repr(field.sampled_at), rule, "leave it out")
        return self


CONTACT = key(
    "Strength of the contact of soil with the base or bedrock, on which soil can then slide. It stands for a joint, or "
    "for a weak seam on rock that is thinner than a cell. Strength reduction divides it too. "
    '`"soil"`: a contact with friction and cohesion of the soil. `"fixed"`: none, soil sticks to the nodes there.',
    {"friction": 10.0, "cohesion": 0.0},
    None,
    otherwise='`"soil"` on `bedrock`, `"fixed"` on the level base',
)
CONTACT_OF_BEDROCK = "Soil slides on it with the strength of the `interface`, or its own without one."


class _OnBase(Part):
    """Ground on a rigid base, or bedrock."""

    @property
    def contact(self) -> InterfaceTable | None:
        """Its interface, with the strength of the soil where bedrock has no other; None where soil sticks to it."""
        interface, bedrock = (getattr(self, name) for name in ("interface", "bedrock"))
        if isinstance(interface, InterfaceTable) or interface == "fixed" or (interface is None and bedrock is None):
            return interface if isinstance(interface, InterfaceTable) else None
        return InterfaceTable("soil", "soil")


@table
class GroundTable(_OnBase):
    """Ground that you draw, a section in plane strain, in place of `[slope]`.

    The distance of the walls is a multiple of both cells. A line is a list of points with rising x, `[[x, z], ...]`, or
    the name of a file beside the scene: a CSV whose headings name x and z, or a DXF drawing (extra `sections`), each in
    any unit of length. A drawing has one polyline or pieces that meet, or those in the layer named after `#`, as in
    `"section.dxf#GROUND"`; a closed outline gives the surface its upper edge.
    """

    surface: Line = key(
        "The surface, from wall to wall.", [[0, 12], [20, 12], [44, 0], [92, 0]], units="m",
        synonyms="points polyline profile coordinates",
    )  # fmt: skip
    base: Metres = key("Height of the rigid base.", -4.0, 0.0)
    origin: Metres | None = key(
        "Where x = 0 lies in the coordinates of the files. It is subtracted from x of files whose coordinates are "
        "those; all other numbers of the scene are counted from it.",
        685000.0,
        None,
        otherwise="`0.0`",
    )
    walls: Pair[Metres] | None = key(
        "Where the ground ends.", [0.0, 92.0], None, otherwise="the ends of the surface", allowed=_WALLS
    )
    toe: Metres | None = key(
        "x of the toe: a point beyond which the surface stops falling, along x or against it, or falls less steeply. "
        "In a valley the higher side is the slope, or that of the `crest`. Run-out is then counted from the toe and "
        "depth from the crest, and failures have modes, as in a `[slope]`.",
        54.0,
        None,
        otherwise="none: run-out from the rear of a slide to its front",
    )
    crest: Metres | None = key(
        "x of the slope's crest, from which its height is counted.", 30.0, None,
        otherwise="where the surface behind the toe is highest",
    )  # fmt: skip
    ends: Literal["roller", "fixed", "left fixed", "right fixed", "tied", "free field"] = key(
        "Boundary condition at the walls. With `left fixed` or `right fixed` the other wall is a roller. For a free "
        "face draw the surface down to the base, and on along the base. `tied` identifies both ends, of ground as high "
        "at both. `free field` has no walls: dashpots join the ends to columns of level ground and absorb the waves "
        "of an earthquake; the ground is level within a cell of each end.",
        "roller",
        "roller",
    )
    interface: OrTable[Literal["soil", "fixed"], InterfaceTable] | None = CONTACT
    bedrock: Line | None = key(
        f"Surface of rigid ground above the base, from wall to wall. {CONTACT_OF_BEDROCK} Rock crops out where "
        "the line follows the surface.",
        [[0, 0], [30, 0], [54, -3], [92, -3]],
        None,
        units="m",
        otherwise="none: the level base",
    )


@table
class TerrainTable(_OnBase):
    """Ground under a terrain model, in place of `[slope]`.

    Rasters are ESRI ASCII grids or GeoTIFFs in metres (extra `terrain`) beside the scene; `"hill.tif#2"` is the second
    band of one. One in degrees, in feet or in a projection whose metres are stretched is refused. Holes (NODATA) may
    lie outside `polygon` alone. A particle at the surface has the volume and mass of that part of its box which lies
    below the surface.
    """

    surface: Raster = key("File of the heights of the ground.", "terrain.asc", units="m")
    base: Metres = key("Height of the rigid base.", 80.0)
    bedrock: Raster | None = key(
        f"File of the heights of rigid ground above the base. {CONTACT_OF_BEDROCK} Rock crops out where it has the "
        "heights of the surface.",
        "bedrock.asc",
        None,
        units="m",
        otherwise="none: the level base",
    )
    interface: OrTable[Literal["soil", "fixed"], InterfaceTable] | None = CONTACT
    x: Pair[Metres] | None = key(
        "Walls along x, a multiple of both cells apart.", [0.0, 200.0], None,
        otherwise="the surface's ends, less what is no multiple of both cells",
        allowed=_WALLS,
    )  # fmt: skip
    y: Pair[Metres] | None = key(
        "Walls along y, likewise.", [0.0, 120.0], None, otherwise="the surface's ends", allowed=_WALLS
    )
    step: Length | None = key(
        "Step to which the surface's raster is resampled.", 2.0, None, otherwise="that of the surface"
    )
    origin: Pair[Metres] | None = key(
        "Where x = 0 and y = 0 lie in the projection of the surface's file; exported maps lie there. It is subtracted "
        "from files whose coordinates are those of the projection; all other numbers of the scene are counted from it.",
        [689000.0, 5334000.0],
        None,
        otherwise="`[0.0, 0.0]`",
        allowed="x and y",
    )
    ends: Literal["roller", "fixed"] = key(
        "Boundary condition at the walls; for a free face see `cut`.", "roller", "roller"
    )
    polygon: Annotated[OrFile[Polygon] | None, Only] = key(
        "Corners in plan of the part that is used; the rest is left out. Or a polygon of a GeoPackage, shapefile or "
        "GeoJSON.",
        [[20, 10], [180, 10], [180, 110], [20, 110]],
        None,
        otherwise="not used: all of the ground",
        allowed='three or more corners [x, y], or a file and its layer, "site.gpkg#part"',
    )
    depth: Length | None = key(
        "Depth below the surface down to which ground is used; the cut is fixed.", 15.0, None,
        otherwise="not used: down to the base",
    )  # fmt: skip
    cut: Literal["fixed", "free"] = key(
        "Boundary condition along the polygon; free: as if the soil around had been excavated.", "fixed", "fixed"
    )
    run_out_line: Annotated[OrFile[Rows] | None, Only] = key(
        "Line in plan along which run-out is measured, straight on beyond its ends. Or a line of such a file.",
        [[20, 60], [90, 60], [180, 80]],
        None,
        units="m",
        otherwise="along the mean displacement of the slide",
        allowed='two or more points [x, y], or a file and its layer, "site.gpkg#channel"',
    )

    @validates(mode="after")
    def _cut_somewhere(self) -> Self:
        if self.cut == "free" and self.polygon is None:
            remedy = "depth is always fixed, so leave it out"
            raise Invalid(("cut",), "'free'", "has no effect without polygon", remedy)
        return self


Surface = float | tuple[tuple[float, float], ...] | mpm.Raster
"""Level (m), points (x, z) m or heights (m) of a water table."""


@table
class Water(Part):
    """Water at rest in drawn ground (`[ground]`) or a terrain, and above it: one of these keys.

    `depth` follows the surface, down a face too; for a table some metres below the crest give `table` or `level`.
    Where these lie above the ground there is a pool, whose surface is level and whose pressure acts on the ground.
    """

    level: OrTable[Metres, RandomLevel] | None = key(
        "Height of the water, in the ground and above it (a pool); as a table, `[water.level]`, it is drawn with each "
        "sample.",
        3.0,
        None,
    )
    table: Line | None = key(
        "Of a section, the water table as a line from wall to wall; level where it lies above the ground.",
        [[0, 8], [44, 0], [92, 0]],
        None,
        units="m",
    )
    raster: Raster | None = key("Of a terrain, file of the heights of the water table.", "water.asc", None, units="m")
    depth: Depth | None = key(
        "Depth of the water table below the surface.", 2.0, None,
        remedy=", or a level for water that stands on the ground",
    )  # fmt: skip
    r_u: Annotated[float, Within(Limit(least=0, below=1))] | None = key(
        "Pore pressure over the weight of the soil above.", 0.25, None
    )

    @validates(mode="after")
    def _one(self) -> Self:
        if len(names := [key.name for key in fields(self) if getattr(self, key.name) is not None]) != 1:
            raise Invalid(
                (), None, f"has {' and '.join(names) or 'nothing'}",
                "give one of level, depth, r_u and, in a section, table, or in a terrain raster",
            )  # fmt: skip
        return self

    @property
    def random(self) -> RandomLevel | None:
        """Its level where that is drawn with each sample."""
        return self.level if isinstance(self.level, RandomLevel) else None

    def surface(self, shape: mpm.Ground) -> Surface | None:
        """Its table, at the mean of a random level; None of r_u.

        Args:
            shape: of the ground, a section or a terrain.
        """
        if self.depth is not None:
            return cast(Surface, cast(Any, shape).lowered(self.depth))
        level = self.level.mean if isinstance(self.level, RandomLevel) else self.level
        return next((value for value in (level, self.table, cast(Any, self.raster)) if value is not None), None)

    def raised(self, by: float, shape: mpm.Ground) -> Water:
        """Water whose table is by so much higher (m).

        Args:
            by: m.
            shape: of the ground.
        """
        surface = self.surface(shape)
        if self.random is not None:
            return Water(self.random.raised(by))
        if isinstance(surface, mpm.Raster):
            return Water(raster=replace(surface, heights=np.asarray(surface.heights) + by))
        if isinstance(surface, tuple):
            return Water(table=tuple((x, z + by) for x, z in surface))
        return self if surface is None else Water(surface + by)
