"""Transfers between particles and grid: shape functions, both engines, averages over neighbours."""

from jaxmpm.transfer._affine import momentum, nodal_momentum, velocity_gradient
from jaxmpm.transfer._averages import band_thickness, filtered, length_of_band, passes_for, thickness_on, within_cells
from jaxmpm.transfer._cells import cell_sums
from jaxmpm.transfer._near import (
    SPARE,
    along,
    at_rows,
    beside,
    can_follow,
    fits,
    near_soil,
    of_all,
    of_stored,
    on_nodes,
    spreads,
    with_room,
)
from jaxmpm.transfer._primitives import scatter_p
from jaxmpm.transfer._shape import GIMP, Linear, QuadraticBSpline, inside, locate
from jaxmpm.transfer._transfers import g2p, p2g
from jaxmpm.transfer.native import available as native_available
from jaxmpm.transfer.native import instructions as native_instructions
from jaxmpm.transfer.native import library as native_library
from jaxmpm.transfer.native.cuda import available as cuda_available
from jaxmpm.transfer.native.cuda import fault as cuda_fault
from jaxmpm.transfer.native.cuda import library as cuda_library

__all__ = [
    "GIMP",
    "SPARE",
    "Linear",
    "QuadraticBSpline",
    "along",
    "at_rows",
    "band_thickness",
    "beside",
    "can_follow",
    "cell_sums",
    "cuda_available",
    "cuda_fault",
    "cuda_library",
    "filtered",
    "fits",
    "g2p",
    "inside",
    "length_of_band",
    "locate",
    "momentum",
    "native_available",
    "native_instructions",
    "native_library",
    "near_soil",
    "nodal_momentum",
    "of_all",
    "of_stored",
    "on_nodes",
    "p2g",
    "passes_for",
    "scatter_p",
    "spreads",
    "thickness_on",
    "velocity_gradient",
    "with_room",
    "within_cells",
]
