"""What a campaign's folder tells: the rows of its samples, and both phases as its estimator sees them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cooperative.estimate import Phases
from cooperative.runs._model import sampling_of
from cooperative.scene import Campaign
from cooperative.store import Rows, Store, read_rows


def rows_reader(campaign: Campaign, store: Store) -> Callable[[str], Rows]:
    """Reads the verified rows of a grid; files of samples that the campaign does not have are damaged."""
    if campaign.plan.estimator is None:
        # That of a script, which is not here, and which alone knows how many samples it makes.
        return partial(read_rows, store)
    return partial(read_rows, store, samples=campaign.estimator.rough_runs(sampling_of(campaign)))


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """What the rows of both grids tell the campaign's estimator."""
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
