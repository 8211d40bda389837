"""What a campaign's folder tells: the rows of its samples, and both phases as its estimator sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from cooperative.estimate import Phases
from cooperative.runs._columns import COLUMNS
from cooperative.runs._model import GridModel, sampling_of
from cooperative.scene import Campaign
from cooperative.store import GRIDS, Record, Rows, Store, reader
from jaxmpm import column_shape

OF_PARTICLES = ("displacement", "plastic_strain")
"""Fields of a sample that have a value, or a vector, for each particle."""


def rows_reader(
    campaign: Campaign,
    store: Store,
    models: Mapping[str, GridModel] | None = None,
    look: Callable[[], None] = lambda: None,
) -> Callable[[str], Rows]:
    """Reads the verified rows of a grid; files of samples that the campaign does not have are damaged, and with its
    `models` those that hold another number of coefficients or of particles too. look: called before each file."""
    samples: int | None = None
    # The estimator of a script is not here, and alone knows how many samples it makes.
    if campaign.plan.estimator is not None:
        samples = campaign.estimator.rough_runs(sampling_of(campaign))

    strange = {grid: partial(foreign, samples, None if models is None else models[grid]) for grid in GRIDS}
    return reader(store, strange, look)


def foreign(samples: int | None, model: GridModel | None, sample: Record) -> str | None:
    """What a sample holds that a campaign of so many samples, or a grid, does not have; None if nothing."""
    if samples is not None and sample.number >= samples:
        return f"is of a sample that the scene, with {samples}, does not have"
    if model is None:
        return None
    modes, (count,) = model.soil.modes, sample.shapes["coefficients"]
    if count != modes and not (sample.row["broke_off"] and count == 0):
        return f"holds {count} coefficients of a field that has {modes}"
    shape = model.scene.particles.position.shape
    expected = dict(zip(OF_PARTICLES, (shape, shape[1:]), strict=True))
    expected |= dict.fromkeys(COLUMNS, column_shape(model.scene))
    for name, wanted in expected.items():
        what, held = "columns" if name in COLUMNS else "particles", sample.shapes.get(f"fields/{name}", wanted)
        if held != wanted:
            return f"holds {name} of shape {held} for {what} of shape {wanted}"
    return None


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """What the rows of both grids tell the campaign's estimator."""
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
