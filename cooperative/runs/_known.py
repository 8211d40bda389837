"""What a campaign's folder tells: the rows of its samples, and both phases as its estimator sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from cooperative.estimate import Phases
from cooperative.runs._columns import COLUMNS
from cooperative.runs._model import GridModel, sampling_of
from cooperative.scene import Campaign
from cooperative.store import GRIDS, Rows, Sample, Store, reader
from jaxmpm import column_shape

OF_PARTICLES = ("displacement", "plastic_strain")
"""Fields of a sample that have a value, or a vector, for each particle."""


def rows_reader(
    campaign: Campaign, store: Store, models: Mapping[str, GridModel] | None = None
) -> Callable[[str], Rows]:
    """Reads the verified rows of a grid; files of samples that the campaign does not have are damaged, and with its
    `models` those that hold another number of coefficients or of particles too."""
    samples: int | None = None
    # The estimator of a script is not here, and alone knows how many samples it makes.
    if campaign.plan.estimator is not None:
        samples = campaign.estimator.rough_runs(sampling_of(campaign))

    return reader(store, {grid: partial(foreign, samples, None if models is None else models[grid]) for grid in GRIDS})


def foreign(samples: int | None, model: GridModel | None, sample: Sample) -> str | None:
    """What a sample holds that a campaign of so many samples, or a grid, does not have; None if nothing."""
    if samples is not None and sample.number >= samples:
        return f"is of a sample that the scene, with {samples}, does not have"
    if model is None:
        return None
    modes, given_up = model.soil.modes, sample.row["broke_off"] and not sample.coefficients.size
    if sample.coefficients.shape != (modes,) and not given_up:
        return f"holds {sample.coefficients.size} coefficients of a field that has {modes}"
    shape = model.scene.particles.position.shape
    for name, expected in zip(OF_PARTICLES, (shape, shape[1:]), strict=True):
        if name in sample.fields and sample.fields[name].shape != expected:
            return f"holds {name} of shape {sample.fields[name].shape} for particles of shape {expected}"
    cells = column_shape(model.scene)
    for name in COLUMNS:
        if name in sample.fields and sample.fields[name].shape != cells:
            return f"holds {name} of shape {sample.fields[name].shape} for columns of shape {cells}"
    return None


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """What the rows of both grids tell the campaign's estimator."""
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
