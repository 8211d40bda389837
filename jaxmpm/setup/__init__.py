"""Scene and State from particles, a law and numerical choices, all checked, with the initial stress."""

from jaxmpm.setup._build import PADDING, ROUNDING, below, build, end_walls, material_on
from jaxmpm.setup._builders import bar, block, column
from jaxmpm.setup._choices import WALL_STRENGTH
from jaxmpm.setup._discretisation import (
    RESOLVED,
    Discretisation,
    cell_independent,
    cells_up,
    check_discretisation,
    check_resolved,
)
from jaxmpm.setup._fill import fill, ordered
from jaxmpm.setup._follow import estimated_nodes, follow_soil, under_sky
from jaxmpm.setup._initial_stress import at_rest, overburden, settled
from jaxmpm.setup._law import check_scene, check_shape, force_of_water, wave_speed, with_water_sealed
from jaxmpm.setup._motion import pseudo_static, read_motion
from jaxmpm.setup._scene import scene, unstressed, with_stress
from jaxmpm.setup._vary import check_names, check_start, numbers_of, parameter_names, vary, with_soil

__all__ = [
    "PADDING",
    "RESOLVED",
    "ROUNDING",
    "WALL_STRENGTH",
    "Discretisation",
    "at_rest",
    "bar",
    "below",
    "block",
    "build",
    "cell_independent",
    "cells_up",
    "check_discretisation",
    "check_names",
    "check_resolved",
    "check_scene",
    "check_shape",
    "check_start",
    "column",
    "end_walls",
    "estimated_nodes",
    "fill",
    "follow_soil",
    "force_of_water",
    "material_on",
    "numbers_of",
    "ordered",
    "overburden",
    "parameter_names",
    "pseudo_static",
    "read_motion",
    "scene",
    "settled",
    "under_sky",
    "unstressed",
    "vary",
    "wave_speed",
    "with_soil",
    "with_stress",
    "with_water_sealed",
]
