"""What a slide brought over each column of cells, and over exposed places, as its sample keeps it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cooperative.measure import ColumnPlan, Place
from cooperative.runs._model import GridModel
from cooperative.store import Scalar
from jaxmpm import Face, Result, passing

COLUMNS = ("column_deposit", "column_thickness", "column_speed", "column_arrival")
"""Fields of a slide, one value for each column: thickness at the end (m), largest thickness (m) and speed (m/s), and
time of arrival (s), nan where it never came."""

_passing = jax.jit(passing)


def kept_columns(model: GridModel, result: Result) -> dict[str, np.ndarray]:
    """What the end of a slide tells of the columns; nothing where nobody asked."""
    state, columns = result.state, result.state.columns
    if columns is None:
        return {}
    now = _passing(model.scene, jax.tree.map(jnp.asarray, state), columns.moved)
    deposit, thickness = np.asarray(now.thickness), np.asarray(columns.thickness)
    arrival = np.asarray(columns.arrival)
    # The run may have ended between two looks.
    came = (deposit >= columns.least) & ~np.isfinite(arrival)
    arrival = np.where(came, float(state.step) * float(result.time_step), arrival)
    arrival = np.where(np.isfinite(arrival), arrival, np.nan)
    found = deposit, np.maximum(thickness, deposit), np.asarray(columns.speed), arrival
    return {name: values.astype(np.float32) for name, values in zip(COLUMNS, found, strict=True)}


def column_row(model: GridModel, columns: dict[str, np.ndarray]) -> dict[str, Scalar]:
    """What the columns of a slide, where it has them, tell in numbers: `area_columns`, the plan area (m2, in a section
    m) of the columns beyond the toe in which soil lies at the end, and what came over each exposed place."""
    kept, hazard = model.state.columns, model.campaign.hazard
    if not columns or kept is None or hazard is None:
        return {}
    plan = model.columns
    covered, face = columns["column_deposit"] >= kept.least, model.campaign.site.shape.face
    row: dict[str, Scalar] = {"area_columns": float(covered[beyond_toe(face, plan)].sum()) * plan.area}
    for place in hazard.places:
        row |= place_row(place, plan, columns)
    return row


def beyond_toe(face: Face | None, plan: ColumnPlan) -> slice:
    """The columns, along x, that lie beyond the toe; that which holds the toe is none of them. All of ground that has
    no toe."""
    return slice(0 if face is None else int(np.searchsorted(plan.edges(0), face.toe_x - 1e-6)), None)


def place_row(place: Place, plan: ColumnPlan, columns: dict[str, np.ndarray]) -> dict[str, Scalar]:
    """What came over a place: largest thickness (m) and speed (m/s) of its columns, and when it was reached (s), if it
    was."""
    mine = place.columns(plan)
    _, thickness, speed, arrival = (columns[name][mine] for name in COLUMNS)
    row: dict[str, Scalar] = {
        f"thickness_at_{place.key}": float(thickness.max()),
        f"speed_at_{place.key}": float(speed.max()),
    }
    reached = arrival[np.isfinite(arrival)]
    return row | ({f"arrival_at_{place.key}": float(reached.min())} if reached.size else {})
