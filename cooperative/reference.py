"""Every key of a scene: docs/scenes.md, and the JSON schema that goes along for editors
(`python -m cooperative.reference`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cooperative.estimate import SubsetPlan
from cooperative.scene import (
    EXPOSED,
    HAZARD,
    LINE,
    LISTS,
    NAMED,
    NAMES,
    OPTIONAL,
    RASTER,
    REQUIRED,
    ROWS,
    SCHEMA,
    SECTIONS,
    SITES,
    UNSAID,
    Key,
    Table,
)
from foundation.files import write_aside

NUMBERS, WHOLE_NUMBERS = frozenset[float], frozenset[int]
"""Kinds of keys: a list of different numbers, and of whole ones."""
SWEEP = {name: Key(NUMBERS, None) for name in ("lx", "ly", "lz", "cov")} | {"k_t": Key(WHOLE_NUMBERS, None)}
KEYS: Mapping[str, Mapping[str, Key]] = {**SECTIONS, "hazard": HAZARD, "exposed": EXPOSED, "sweep": SWEEP}
"""The keys of every table that a scene may have."""
SEVERAL = (*LISTS, "exposed")
"""Tables of which there may be several."""
STORED = ("calibration", "defaults", "estimator", "field_modes", "files", "limit_load")
"""Tables that a campaign writes into the scene that it keeps."""


@dataclass(frozen=True)
class Meaning:
    """What a key means: words, a unit, an example. default: what stands in its place, in words, where that is no value.
    allowed: its range in words, where that has no ends. above, least, below, most: ends of a number, open or closed."""

    words: str
    example: str
    unit: str = "-"
    default: str = ""
    allowed: str = ""
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None

    def range(self) -> str:
        """The range of a number in words, empty where it has no ends."""
        low = [f"above {self.above:g}"] if self.above is not None else []
        low += [f"{self.least:g} or more"] if self.least is not None else []
        high = [f"below {self.below:g}"] if self.below is not None else []
        high += [f"up to {self.most:g}"] if self.most is not None else []
        return ", ".join(low + high)


TABLES = {
    "slope": "A simple slope. Lengths are multiples of the spacing of both grids.",
    "ground": (
        "Ground that you draw, a section in plane strain, in the place of `[slope]`. Lines are points `[[x, z], ...]` "
        "with x rising, or name a file beside the scene: points as CSV, or a DXF drawing in metres with one polyline, "
        'or with one in the layer that stands after `#`, as in `"section.dxf#GROUND"` (extra `sections`). The distance '
        "of the walls is a multiple of both cells."
    ),
    "terrain": (
        "Ground under a terrain model, in the place of `[slope]`. Rasters are ESRI ASCII grids or GeoTIFFs in metres "
        "beside the scene. Boxes that the surface cuts keep their share of volume and mass."
    ),
    "layer": (
        "Layers of the drawn ground, `[[layer]]` for each, from the top down; the last has no lower boundary. Each "
        "may have any key of `[soil]`, and of a parameter that varies a table, such as `[layer.strength]`, with its "
        "own `mean`, `cov`, `marginal`, `lower`, `upper` and `trend`; what it leaves out is that of `[soil]` and "
        "`[strength]`. Its random field goes through all layers, unless a layer gives a `length` of its own: then its "
        "field stops at it, independent of all others, with a `correlation`, `energy`, `bedding` and so on that may be "
        "its own too."
    ),
    "water": "Water in the drawn ground, and above it: one of these keys.",
    "soil": (
        "The soil: undrained, with a strength that does not depend on pressure, or with cohesion and friction. A "
        "parameter that varies is a table in place of a number, such as `[soil.cohesion]`, with the keys of "
        "`[strength]`. A number that betrays another unit is refused, see `unusual`."
    ),
    "strength": (
        "The random field of undrained shear strength, in short for `[soil.strength]`. Every parameter that varies has "
        "these keys, in its own unit. Values within 4 deviations have to be such as the soil may have."
    ),
    "cross_correlation": (
        "Parameters that vary together; those that no such table names vary independently. They need the same "
        "`length`, `correlation`, `bedding`, `energy` and `nataf`."
    ),
    "rough": "The grid of the screening, on which every sample runs.",
    "refined": "The grid of the audit, on which ranked samples run. Keys as in `[rough]`.",
    "run": "How each sample runs.",
    "campaign": "How many samples, and how the failure probability is estimated.",
    "hazard": (
        "What is kept of each refined slide for maps: with this table, or `[[exposed]]`, the largest thickness, the "
        "largest speed and the arrival of the soil in each column of cells. Both may be left out."
    ),
    "exposed": "A place that a slide may reach, one table for each, with one of `at`, `between` and `polygon`.",
    "sweep": (
        "Values of parameters, of which each is changed alone while the others stay as the scene has them: then the "
        "scene is many campaigns, and `jaxmpm sweep` runs it. It needs a table `[strength]`, "
        '`coefficients = "latin hypercube"` and an estimator other than `"subset"`. One key at least.'
    ),
}
_LENGTH: dict[str, Any] = {"unit": "m", "above": 0}
_WALLS: dict[str, Any] = {"unit": "m", "allowed": "two numbers, the lower one first"}
_CORNERS = "three points or more"
_GRID = {
    "cell": Meaning("Edge of a cell of the background grid.", "2.0", **_LENGTH),
    "spacing": Meaning("Distance of the particles along each axis, at most a cell.", "[1.0, 1.0]", **_LENGTH),
    "kernel": Meaning("Shape function of a particle.", '"gimp"'),
    "scheme": Meaning("When the stress is updated within a step.", '"musl"'),
    "cfl": Meaning("Time step over the time in which a wave crosses a cell.", "0.9", above=0, most=1),
    "flip": Meaning("Share of FLIP in the update of velocities; the rest is PIC.", "1.0", least=0, most=1),
    "apic": Meaning("Affine transfers instead of the blend of FLIP and PIC.", "false"),
    "damping": Meaning("Damping of the velocity.", "0.0", unit="1/s", least=0),
    "fbar": Meaning(
        "F-bar, the cure of volumetric locking.",
        "true",
        default="`true`; `false` where soil has friction, or with `cell_average`",
    ),
    "cell_average": Meaning(
        "Volumetric strain averaged over each cell: the cure where soil has friction.",
        "true",
        default="`true` where soil has friction, else `false`",
    ),
    "internal_length": Meaning(
        "Length over which plastic strain is averaged.",
        "2.0",
        **_LENGTH,
        default='0.4 of `softening_length`; `"none"` where that is less than cells resolve, or soil does not soften',
    ),
    "air": Meaning(
        "Height of the grid above the highest ground; a run whose soil is thrown higher breaks off.",
        "6.0",
        **_LENGTH,
        default="a cell",
    ),
}
MEANINGS = {
    "slope": {
        "crest": Meaning("Length of the level ground above.", "20.0", **_LENGTH),
        "height": Meaning("Height of the slope.", "12.0", **_LENGTH),
        "run_per_rise": Meaning("Cotangent of the slope's angle.", "2.0", least=0),
        "toe": Meaning("Length of the level ground below, on which a slide runs out.", "48.0", **_LENGTH),
        "foundation": Meaning("Depth of soil below the toe, down to rock.", "4.0", unit="m", least=0),
        "width": Meaning("Width along the slope.", "96.0", **_LENGTH, default="none: a section in plane strain"),
        "y_ends": Meaning("What holds the ends of a slope of finite width.", '"fixed"'),
    },
    "ground": {
        "surface": Meaning("The surface, from wall to wall.", "[[0, 12], [20, 12], [44, 0], [92, 0]]", unit="m"),
        "base": Meaning("Height of the rigid base.", "-4.0", unit="m"),
        "walls": Meaning("Where the ground ends.", "[0.0, 92.0]", **_WALLS, default="the ends of the surface"),
        "toe": Meaning(
            "x of the toe of a slope, a point of the surface at which it stops falling along x or falls less steeply. "
            "Run-out is then counted beyond it, depth below the crest, and failures have modes, as of a `[slope]`.",
            "54.0",
            unit="m",
            default="none: run-out from the rear of a slide to its front",
        ),
        "crest": Meaning(
            "x of the slope's crest, from which its height is counted.",
            "30.0",
            unit="m",
            default="where the surface before the toe is highest",
        ),
        "ends": Meaning(
            "What holds the ground at its walls, the other one of two on a roller. For a free face draw the surface "
            "down to the base, and on along it.",
            '"roller"',
        ),
        "interface": Meaning(
            "Strength of the contact of soil with the base, on which soil then slides: of a joint, or a weak seam on "
            "rock too thin for the cells. `friction` in degrees, `cohesion` in Pa; they do not vary, and strength "
            "reduction divides them too.",
            "{ friction = 10.0, cohesion = 0.0 }",
            default="none: soil sticks to the base",
            allowed="a table, its friction from 0 to 60, its cohesion 0 or more",
        ),
    },
    "terrain": {
        "surface": Meaning("File of the heights of the ground.", '"terrain.asc"', unit="m"),
        "base": Meaning("Height of the rigid base.", "80.0", unit="m"),
        "x": Meaning(
            "Walls along x, a multiple of both cells apart.", "[0.0, 200.0]", **_WALLS, default="the surface's ends"
        ),
        "y": Meaning("Walls along y, likewise.", "[0.0, 120.0]", **_WALLS, default="the surface's ends"),
        "step": Meaning(
            "Step to which the surface's raster is resampled.", "2.0", **_LENGTH, default="that of the surface"
        ),
        "origin": Meaning(
            "Where x = 0 and y = 0 lie in the projection of the surface's file; exported maps lie there. Give heights "
            "from a corner: single precision takes no coordinates of millions of metres.",
            "[689000.0, 5334000.0]",
            unit="m",
            default="`[0.0, 0.0]`",
            allowed="two numbers",
        ),
        "ends": Meaning("What holds the ground at its walls; for a free face see `cut`.", '"roller"'),
        "polygon": Meaning(
            "Corners in plan of the part that is kept; what lies around it is left out.",
            "[[20, 10], [180, 10], [180, 110], [20, 110]]",
            unit="m",
            default="not used: all is kept",
            allowed=_CORNERS,
        ),
        "depth": Meaning(
            "Depth below the surface down to which ground is kept; the cut stands still.",
            "15.0",
            **_LENGTH,
            default="not used: kept down to the base",
        ),
        "cut": Meaning(
            "What holds the ground along its polygon: free is as if the soil around had been dug away.", '"fixed"'
        ),
        "run_out_line": Meaning(
            "Line in plan along which run-out is measured, straight on beyond its ends.",
            "[[20, 60], [90, 60], [180, 80]]",
            unit="m",
            default="along the mean displacement of the slide",
            allowed="two points or more",
        ),
    },
    "water": {
        "level": Meaning("Height of the water, in the ground and above it.", "3.0", unit="m"),
        "table": Meaning(
            "Of a section, height of the water as a line from wall to wall.", "[[0, 8], [44, 0], [92, 0]]", unit="m"
        ),
        "raster": Meaning("Of a terrain, file of the heights of the water table.", '"water.asc"', unit="m"),
        "depth": Meaning("Depth of the water table below the surface.", "2.0", unit="m", least=0),
        "r_u": Meaning("Pore pressure over the weight of the soil above.", "0.25", least=0, below=1),
    },
    "soil": {
        "unit_weight": Meaning("Weight of the soil with the water in it.", "20e3", unit="N/m3", above=0),
        "saturated_unit_weight": Meaning(
            "Weight of soil that lies below the water table at the start, where soil above it weighs unit_weight.",
            "20e3",
            unit="N/m3",
            above=0,
            default="that of soil above it",
        ),
        "young": Meaning("Young's modulus.", "1e8", unit="Pa", above=0),
        "poisson": Meaning("Poisson's ratio.", "0.3", above=-1, below=0.5),
        "strength": Meaning(
            "Undrained shear strength; `[strength]` is short for a table of it.", "42e3", unit="Pa", above=0
        ),
        "strength_ratio": Meaning(
            "In place of the strength, what it is over the effective vertical stress at rest: the weight of the soil "
            "above, of its mean unit weight, less the pressure of the water, so it needs `[water]`.",
            "0.25",
            above=0,
            most=1,
        ),
        "strength_minimum": Meaning(
            "Least strength, where it goes with the stress: that of the soil at the surface. It goes with "
            "`strength_ratio`.",
            "5e3",
            unit="Pa",
            above=0,
        ),
        "softening_modulus": Meaning(
            "Loss of strength over plastic strain.", "85e3", unit="Pa", above=0, default="none: no softening"
        ),
        "residual_ratio": Meaning("Strength left at large strain, over the peak.", "0.5", least=0, most=1),
        "tension_cutoff": Meaning("Largest mean tension.", "0.0", unit="Pa", least=0, default="no limit"),
        "gap_memory": Meaning(
            "Whether soil that the tension cutoff has opened closes its gap before it bears pressure; without it it "
            "resists at once, and grains are thrown out.",
            "true",
        ),
        "plastic_strain": Meaning("Measure of plastic strain by which the soil softens.", '"engineering"'),
        "strain_95": Meaning(
            "Plastic strain at which 95 % of an exponential loss is done, instead of softening_modulus.",
            "10.0",
            above=0,
        ),
        "softening_length": Meaning(
            'Thickness of the band that softening refers to; `"cell"`: that of a cell, whichever it is.',
            "2.4",
            **_LENGTH,
            default="a fifth of the height of the slope, or of the ground's relief",
        ),
        "rate_coefficient": Meaning(
            "Rise of strength for each tenfold rate of strain.", "0.1", least=0, default="none: no effect of rate"
        ),
        "reference_rate": Meaning("Rate of shear strain at which strength is as given.", "1e-5", unit="1/s", above=0),
        "cohesion": Meaning("Cohesion, with friction in place of strength.", "5e3", unit="Pa", least=0),
        "friction": Meaning("Angle of friction.", "25.0", unit="degrees", least=0, most=60),
        "dilation": Meaning("Angle of dilation, at most that of friction.", "0.0", unit="degrees", least=0, most=60),
        "criterion": Meaning("Law of soil with friction.", '"mohr-coulomb"'),
        "matching": Meaning("Where the cone of Drucker-Prager meets Mohr-Coulomb's pyramid.", '"plane strain"'),
        "residual_cohesion": Meaning("Cohesion left at large strain.", "0.0", unit="Pa", least=0),
        "residual_friction": Meaning("Friction left at large strain.", "20.0", unit="degrees", least=0, most=60),
        "softening_strain": Meaning(
            "Plastic shear strain over which cohesion and friction fall to the residual.",
            "0.2",
            above=0,
            default="none: no softening",
        ),
        "decay": Meaning("How they fall.", '"linear"'),
        "unusual": Meaning(
            "Whether numbers of the soil, of gravity and of the water's height that betray another unit are meant as "
            "they are; without it they are refused.",
            "false",
        ),
    },
    "strength": {
        "mean": Meaning("Mean, at the ground where there is a trend.", "42e3", unit="Pa", above=0),
        "cov": Meaning("Coefficient of variation.", "0.3", least=0),
        "marginal": Meaning("Distribution of the parameter at a point.", '"lognormal"'),
        "correlation": Meaning(
            "Family of correlation functions, see [random fields](random-fields.md).", '"exponential"'
        ),
        "length": Meaning(
            "Correlation length along each axis, as the family defines it; inf: constant along it.",
            "[60.0, 2.0]",
            **_LENGTH,
        ),
        "energy": Meaning("Share of the field's variance that its modes keep.", "0.999", above=0, most=1),
        "sampled_at": Meaning("Where the field is taken: at particles, or one value for each cell.", '"particles"'),
        "lower": Meaning(
            "Lower bound of the distribution, where its family has one.",
            "10e3",
            unit="Pa",
            default="0; none, give it, of a beta distribution",
        ),
        "upper": Meaning(
            "Upper bound, likewise.", "90e3", unit="Pa", default="no bound; none, give it, of a beta distribution"
        ),
        "trend": Meaning(
            "Growth of the mean, and of the deviation with it, per metre of depth.",
            "1.2e3",
            unit="Pa/m",
            default="none: alike at every depth",
        ),
        "trend_from": Meaning(
            "Where the depth of the trend is counted from: the ground's surface, which follows the face of a cut, the "
            "top of each layer, or an elevation, such as that of the ground before a cut; above it there is no trend.",
            '"surface"',
            unit="m",
            allowed="an elevation above the base",
        ),
        "bedding": Meaning(
            "Inclined strata: `dip` below the horizontal and `strike`, anticlockwise from x seen from above, both in "
            "degrees. With strike 90, as by default, they dip towards the toe. Lengths are then down the dip, along "
            "strike and across.",
            "{ dip = 15.0, strike = 90.0 }",
            default="level strata",
            allowed="a table, its dip from 0 to 90",
        ),
        "nataf": Meaning("Whether the parameter itself has the correlation, not the Gaussian field behind it.", "true"),
        "boreholes": Meaning(
            "Measured values: the place and the value there. x of a simple slope is from its rear, z from its base.",
            "[[10.0, 2.5, 45e3]]",
            unit="m, Pa",
            default="none measured",
            allowed="rows of a coordinate per axis and the value",
        ),
        "borehole_error": Meaning("Deviation of the measured values, in deviations of the field.", "0.1", least=0),
    },
    "cross_correlation": {
        "parameters": Meaning(
            "Names of the parameters.", '["cohesion", "friction"]', allowed="two or more that vary, each once"
        ),
        "matrix": Meaning(
            "Their correlation, a row for each.",
            "[[1.0, -0.5], [-0.5, 1.0]]",
            allowed="symmetric, 1 on the diagonal, positive definite",
        ),
        "nataf": Meaning("Whether it is that of the parameters, not that of the Gaussian fields behind them.", "true"),
    },
    "rough": _GRID,
    "refined": _GRID | {"cell": Meaning("Edge of a cell.", "1.0", **_LENGTH)},
    "run": {
        "gravity": Meaning("Acceleration of gravity.", "9.81", unit="m/s2", above=0),
        "t_end": Meaning("Time at which a run ends, if it has not before.", "20.0", unit="s", above=0),
        "slides_t_end": Meaning(
            "Time up to which slides of the refined grid go on that had not come to rest at t_end; what has failed is "
            "told at t_end.",
            "60.0",
            unit="s",
            default="`t_end`",
            allowed="`t_end` or more",
            above=0,
        ),
        "failure": Meaning(
            "What failure is: a displacement, or the limit load of the slope of median soil, from which the "
            "displacement is then found and printed with the answer.",
            '"limit load"',
        ),
        "failure_displacement": Meaning("Displacement from which on soil counts as sliding.", "1.0", **_LENGTH),
        "least_volume": Meaning(
            "Volume of soil that has to move farther than that where a slope fails, so that a few grains are no "
            "failure; in a section m2.",
            "5.0",
            unit="m3",
            above=0,
            default='any particle; with `"limit load"` 0.05 times the slope\'s height to the power of 2 in a section, '
            "3 in 3D",
        ),
        "settle": Meaning("Whether a run ends once its slope stands still.", "true"),
        "rest": Meaning("Whether a slide ends once its deposit rests.", "true", default="as `settle`"),
    },
    "campaign": {
        "samples": Meaning("Number of random slopes.", "200", least=1),
        "seed": Meaning("Number from which all randomness follows.", "1", least=0),
        "coefficients": Meaning("How coefficients of the field are drawn.", '"latin hypercube"'),
        "k_t": Meaning(
            'Stopping rule of `"published"`: refined runs in a row that stand.',
            "5",
            least=1,
            default='not used; `"published"`: none, give it',
        ),
        "estimator": Meaning("How the failure probability is estimated.", '"two-phase"'),
        "refined_runs": Meaning(
            "Budget of refined runs.",
            "60",
            least=10,
            default='a fifth of the samples, at least 20; with `target_cov`, and of `"monte carlo"`, all samples',
        ),
        "target_cov": Meaning(
            "Coefficient of variation of the estimate at which to stop.", "0.2", above=0, below=1, default="none"
        ),
        "levels": Meaning(
            "Levels of subset simulation above plain sampling.", "6", least=1, default=f"`{SubsetPlan.levels}`"
        ),
        "replicates": Meaning(
            "Independent repeats of subset simulation.", "8", least=2, default=f"`{SubsetPlan.replicates}`"
        ),
        "lanes": Meaning("Rough runs in one program.", "1", least=1, default="`1` on CPU, `64` elsewhere"),
        "look_ahead": Meaning("Refined runs under way at once.", "1", least=1),
        "screening_stop": Meaning(
            "Displacement at which a rough run ends undisputed.", "2.0", **_LENGTH, default="none: rough runs go on"
        ),
        "calibrate": Meaning("Whether rough strength is brought down by the grids' factors of safety.", "false"),
        "restart_every": Meaning("Time between restart points of a refined run.", "600.0", unit="s", above=0),
        "fields": Meaning(
            "Grids whose final displacement and plastic strain are kept, and of a failure two frames.", '"refined"'
        ),
        "modes": Meaning("Grids whose failures get a mode; only a slope with a toe has modes.", '"refined"'),
        "slides": Meaning(
            "Failures that slide on to their end, drawn along the ranks; other refined runs end once they have failed.",
            "30",
            least=0,
            default='`"all"`',
        ),
    },
}
MEANINGS["layer"] = {
    "name": Meaning("What it is called.", '"soft clay"', default="`layer` and its number"),
    "bottom": Meaning(
        "Its lower boundary; where that meets the one above, the layer ends.", "[[0, 2], [92, -2]]", unit="m"
    ),
    "raster": Meaning("Instead, under a terrain, a file of the boundary's heights.", '"rock.asc"', unit="m"),
    "depth": Meaning("Instead, depth of the boundary below the surface.", "3.0", **_LENGTH),
    "thickness": Meaning("Instead, thickness of the layer.", "2.0", **_LENGTH),
    "rock": Meaning("Whether it is rock, which does not yield.", "true"),
    **{name: replace(meaning, default="that of [soil]") for name, meaning in MEANINGS["soil"].items()},
}
MEANINGS["hazard"] = {
    "thresholds": Meaning(
        "Thicknesses of the deposit (m, cm) and speeds (m/s, km/h) to map.",
        '["0.5 m", "1 m/s"]',
        unit="in each",
        allowed="texts: a number above 0 and its unit",
    ),
    "every": Meaning("Steps from one look at the columns to the next.", "20", least=1),
}
MEANINGS["exposed"] = {
    "name": Meaning("Its name, of which there is one.", '"road"', allowed="text of up to 60 characters"),
    "at": Meaning("A point: `[x]` in a section, `[x, y]` in 3D.", "[72.0]", unit="m", allowed="one or two numbers"),
    "between": Meaning("In a section, the two ends of a stretch.", "[70.0, 76.0]", unit="m", allowed="two numbers"),
    "polygon": Meaning(
        "In 3D, the corners of a polygon in order.", "[[70, 5], [76, 5], [73, 12]]", unit="m", allowed=_CORNERS
    ),
    "value": Meaning("What stands there.", "250e3", unit="any currency", least=0),
    "vulnerability": Meaning(
        "Share of the value that is lost at each largest thickness, or each largest speed, straight lines "
        "between; it does not fall.",
        '[["0 m", 0.0], ["1 m", 0.4], ["3 m", 1.0]]',
        unit="in each",
        allowed="pairs: a number and its unit, a share from 0 to 1",
    ),
}
_VARIED: dict[str, Any] = {"default": "not varied"}
MEANINGS["sweep"] = {
    "lx": Meaning("Correlation lengths of the strength along x.", "[10, 30, 60, 120]", **_LENGTH, **_VARIED),
    "ly": Meaning("Correlation lengths along y, of a scene in 3D.", "[6, 12, 24]", **_LENGTH, **_VARIED),
    "lz": Meaning("Correlation lengths along z.", "[1, 2, 4]", **_LENGTH, **_VARIED),
    "cov": Meaning("Coefficients of variation of the strength.", "[0.2, 0.3, 0.4]", least=0, **_VARIED),
    "k_t": Meaning(
        'Stopping rules of `"published"`, all told from the runs of one campaign by the largest.',
        "[2, 5, 10]",
        least=1,
        **_VARIED,
    ),
}
_TYPES = {float: "number", int: "integer", bool: "boolean", str: "string", list: "array"}
_ALLOWED = {
    float: "any number",
    int: "any number",
    tuple: "any numbers",
    bool: "`true`, `false`",
    str: "text",
    LINE: "points, or a file's name",
    RASTER: "a file's name",
}
"""What a key of a kind may hold that has no other range."""


def json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a scene's tables and keys."""
    tables: dict[str, Any] = {
        section: {
            "type": "object",
            "description": TABLES[section],
            "properties": {name: _property(key, MEANINGS[section][name]) for name, key in keys.items()},
            "required": [name for name, key in keys.items() if key.default is REQUIRED],
            "additionalProperties": False,
        }
        for section, keys in KEYS.items()
    }
    tables["sweep"]["minProperties"] = 1
    for section in SEVERAL:
        tables[section] = {"type": "array", "items": tables[section]}
    stored = {"type": "object", "description": "Written by a campaign into the scene that it keeps: leave it out."}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scene of jaxmpm",
        "type": "object",
        "properties": {"name": {"type": "string"}, **tables, **dict.fromkeys(STORED, stored)},
        "required": [section for section in SECTIONS if section not in OPTIONAL],
        "oneOf": [{"required": [section]} for section in SITES],
        "additionalProperties": False,
    }


def _property(key: Key, meaning: Meaning) -> dict[str, Any]:
    unit = f" ({meaning.unit})" if meaning.unit != "-" else ""
    default = f" Default: {meaning.default}." if meaning.default else ""
    said: dict[str, Any] = {"description": meaning.words + unit + default}
    if key.default not in (REQUIRED, UNSAID, None):
        said["default"] = key.default
    if isinstance(key.kind, dict):
        return said | {"enum": list(key.kind)}
    if isinstance(key.kind, Table):
        return said | _table(key.kind)
    if key.kind == LINE:
        point = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        return said | {"anyOf": [{"type": "array", "items": point, "minItems": 2}, {"type": "string"}]}
    if key.kind == RASTER:
        return said | {"type": "string"}
    ends = {
        "exclusiveMinimum": meaning.above,
        "minimum": meaning.least,
        "exclusiveMaximum": meaning.below,
        "maximum": meaning.most,
    }
    value: dict[str, Any] = {name: end for name, end in ends.items() if end is not None}
    if key.kind is tuple:
        return said | _list({"type": "number", **value})
    if key.kind in (NUMBERS, WHOLE_NUMBERS):
        type_ = "integer" if key.kind == WHOLE_NUMBERS else "number"
        return said | _list({"type": type_, **value}) | {"uniqueItems": True}
    if key.kind in (ROWS, NAMES):
        return said | _list({"type": "string"} if key.kind == NAMES else _list({"type": "number"}))
    value = {"type": _TYPES[key.kind], **value}
    others: list[dict[str, Any]] = [{"const": word} for word in ([] if key.none is None else [key.none]) + [*key.words]]
    if key.or_table is not None:
        whole = key.or_table.keys is SECTIONS["strength"]
        others.append({"$ref": "#/properties/strength"} if whole else _table(key.or_table))
    return said | ({"anyOf": [value, *others]} if others else value)


def _list(of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "minItems": 1, "items": of}


def _table(table: Table) -> dict[str, Any]:
    """Schema of a table within a table, whose keys are those of a random field, or numbers."""
    return {
        "type": "object",
        "properties": {
            name: {"$ref": f"#/properties/strength/properties/{name}"}
            if name in SECTIONS["strength"]
            else {"type": _TYPES[key.kind]}
            for name, key in table.keys.items()
        },
        "required": [name for name, key in table.keys.items() if key.default is REQUIRED],
        "additionalProperties": False,
    }


def markdown() -> str:
    """docs/scenes.md: every key with unit, default, range and example."""
    parts = [
        "# Scenes: every key\n",
        "A scene is a TOML file. This page is made from the checks that read it (`python -m cooperative.reference`).",
        f"So is [`{SCHEMA.name}`](../cooperative/{SCHEMA.name}), from which an editor completes keys:",
        "`jaxmpm new` and `jaxmpm example` write it beside the scene, which names it in its first line,",
        f"`{NAMED.strip()}`. Lengths are in metres, stresses in Pa. `name`, outside all tables, is a title.\n",
    ]
    for section, keys in KEYS.items():
        brackets = 2 if section in SEVERAL else 1
        parts += [f"## `{'[' * brackets}{section}{']' * brackets}`\n", TABLES[section] + "\n"]
        if section == "refined":
            continue
        parts += ["| key | what | unit | default | range | example |", "|---|---|---|---|---|---|"]
        shown = {name: key for name, key in keys.items() if section != "layer" or name not in SECTIONS["soil"]}
        parts += [_row(name, key, MEANINGS[section][name]) for name, key in shown.items()]
        parts.append("")
    return "\n".join(parts)


def _row(name: str, key: Key, meaning: Meaning) -> str:
    default = "none, give it" if key.default is REQUIRED else meaning.default or "not used"
    if key.default not in (REQUIRED, UNSAID, None):
        default = f"`{json.dumps(key.default)}`"
    cells = (f"`{name}`", meaning.words, meaning.unit, default, _allowed(key, meaning), f"`{meaning.example}`")
    return f"| {' | '.join(cells)} |"


def _allowed(key: Key, meaning: Meaning) -> str:
    """What a key may hold, in words; empty for a list of which nobody has said what it holds."""
    if isinstance(key.kind, dict):
        return ", ".join(f'`"{choice}"`' for choice in key.kind)
    if key.kind in (NUMBERS, WHOLE_NUMBERS):
        return f"different {'whole ' if key.kind == WHOLE_NUMBERS else ''}numbers, each {meaning.range()}"
    found = meaning.allowed or meaning.range() or _ALLOWED.get(key.kind, "")
    found += ", or inf" if key.infinite else ""
    found += ", whole" if key.kind is int else ""
    found += ", one per axis" if key.kind is tuple and not meaning.allowed else ""
    found += "".join(f', or `"{word}"`' for word in ([key.none] if key.none else []) + [*key.words])
    return found + (", or a table" if key.or_table else "")


def write(root: Path) -> None:
    """Write the page and the schema into a checkout."""
    write_aside(root / "docs" / "scenes.md", markdown().encode())
    write_aside(root / "cooperative" / SCHEMA.name, (json.dumps(json_schema(), indent=1) + "\n").encode())


if __name__ == "__main__":
    write(Path())
