"""What a campaign's folder tells: the rows of its samples, and both phases as its estimator sees them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cooperative.estimate import Phases
from cooperative.runs._columns import COLUMNS
from cooperative.runs._ground import StoredGround
from cooperative.runs._model import sampling_of
from cooperative.scene import Campaign
from cooperative.store import Record, Rows, Store, read_rows

OF_PARTICLES = ("displacement", "plastic_strain")
"""Fields of a sample that have a value, or a vector, for each particle."""


def rows_reader(
    store: Store, samples: int | None, ground: StoredGround | None = None, look: Callable[[], None] = lambda: None
) -> Callable[[str], Rows]:
    """Reads the verified rows of a grid. Files of samples that the campaign does not have are damaged.

    Args:
        store: the campaign's folder.
        samples: of the first phase, None where only the estimator of a script knows.
        ground: of the campaign; then files that hold another number of coefficients or of particles are damaged too.
        look: called before each file.
    """
    return partial(read_rows, store, foreign=partial(foreign, samples, ground), look=look)


def foreign(samples: int | None, ground: StoredGround | None, grid: str, sample: Record) -> str | None:
    """What a sample holds that a campaign of so many samples, or a grid, does not have; None if nothing."""
    if samples is not None and sample.number >= samples:
        return f"is of a sample that the scene, with {samples}, does not have"
    if ground is None:
        return None
    (count,) = sample.shapes["coefficients"]
    if count != ground.terms and not (sample.row["broke_off"] and count == 0):
        return f"holds {count} coefficients of a field that has {ground.terms}"
    shape = ground.grids[grid].position.shape
    expected = dict(zip(OF_PARTICLES, (shape, shape[1:]), strict=True))
    expected |= dict.fromkeys(COLUMNS, ground.grids[grid].columns.shape)
    for name, wanted in expected.items():
        what, held = "columns" if name in COLUMNS else "particles", sample.shapes.get(f"fields/{name}", wanted)
        if held != wanted:
            return f"holds {name} of shape {held} for {what} of shape {wanted}"
    return None


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """What the rows of both grids tell the campaign's estimator."""
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
