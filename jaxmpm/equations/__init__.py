"""Equations of a step: transfers, motion of the nodes, stress, and free field; `jaxmpm.step` applies them in order."""

from jaxmpm.equations._free_field import beyond_ends, free_field
from jaxmpm.equations._gaps import bridged, by_levels, closed, gap_of, gaps, sheared, undrained
from jaxmpm.equations._maps import MASS_FLOOR, Maps, grid_position, reciprocal
from jaxmpm.equations._nodes import (
    GridMotion,
    Nodal,
    braked,
    external_force,
    felt_gravity,
    move_grid,
    nodal_velocity,
    particles_to_grid,
    pushed,
)
from jaxmpm.equations._stress import acting_stress, excess_of, update_stress

__all__ = [
    "MASS_FLOOR",
    "GridMotion",
    "Maps",
    "Nodal",
    "acting_stress",
    "beyond_ends",
    "braked",
    "bridged",
    "by_levels",
    "closed",
    "excess_of",
    "external_force",
    "felt_gravity",
    "free_field",
    "gap_of",
    "gaps",
    "grid_position",
    "move_grid",
    "nodal_velocity",
    "particles_to_grid",
    "pushed",
    "reciprocal",
    "sheared",
    "undrained",
    "update_stress",
]
