"""What a campaign will cost on this machine, told from a trial of some seconds."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cooperative.runs._model import GridModel, build, sampling_of
from cooperative.runs._random_soil import random_soil
from cooperative.runs._size import GridSize, grid_size
from cooperative.scene import Campaign
from cooperative.store import GRIDS
from jaxmpm import Scene, State, Status, advance


@dataclass(frozen=True)
class Cost:
    """sizes: of both grids, by name. runs: how many there are of each, at most on the refined grid. step: seconds of
    one step of a run on each."""

    sizes: Mapping[str, GridSize]
    runs: Mapping[str, int]
    step: Mapping[str, float]

    def hours(self, grid: str) -> float:
        """Of one core, if no run ended before its time: they end once they have settled, most after a fifth of it."""
        return self.runs[grid] * self.sizes[grid].steps * self.step[grid] / 3600

    @property
    def memory(self) -> float:
        """Bytes of both grids with one lane each."""
        return sum(size.memory(1) for size in self.sizes.values())


def cost_of(campaign: Campaign, seconds: float = 10.0) -> Cost:
    """Try a run of each grid for half of `seconds`, compiling not counted. Raises ValueError where ground, soil and
    grids do not fit together."""
    rough, soil = campaign.estimator.rough_runs(sampling_of(campaign)), random_soil(campaign)
    budget = campaign.estimator.budget(rough)
    models = {grid: build(campaign, grid, soil, at_rest=False) for grid in GRIDS}
    return Cost(
        sizes={grid: grid_size(campaign, grid) for grid in GRIDS},
        runs={"rough": rough, "refined": rough if budget is None else min(budget, rough)},
        step={grid: seconds_per_step(model, seconds / len(GRIDS)) for grid, model in models.items()},
    )


def seconds_per_step(model: GridModel, seconds: float) -> float:
    """Seconds of one step of a run, from as many as fit into the time given."""
    scene, start = model.median
    state, taken, spent, steps = _steps(scene, start, 1), 0, 0.0, 1
    while spent < seconds:
        begun = time.perf_counter()
        after = jax.block_until_ready(_steps(scene, state, steps))
        spent += time.perf_counter() - begun
        taken += max(int(after.step) - int(state.step), 1)
        # It starts free of stress, and may break off; then it begins again.
        state = after if int(after.status) == Status.RUNNING else start
        steps = min(2 * steps, 1000)
    return spent / taken


@jax.jit
def _steps(scene: Scene, state: State, steps: int) -> State:
    return advance(scene, state, jnp.asarray(steps))
