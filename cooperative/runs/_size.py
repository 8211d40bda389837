"""How large a campaign is, by its scene alone: particles, steps, memory.

Its cost on this machine comes from a trial of some seconds.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from cooperative.runs._built import build
from cooperative.runs._lanes import lanes_of, lent_by
from cooperative.runs._model import GridModel
from cooperative.runs._random_soil import random_soil
from cooperative.runs._sampling import sampling_of
from cooperative.scene import TAIL, Campaign, RandomField, check_cells
from jaxmpm import Material, Scene, State, Status, advance, block, ground
from jaxmpm.laws import declared
from jaxmpm.run import devices_of
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.check import about
from jaxmpm.support.values import by_value

MOST_STEPS = 10**7
"""Of one run. The published slope takes 2,000 and 5,000; with more, rounding in float32 gets the better of a step."""

MOST_WORK = 1e13
"""Particles times steps of one run: some 20 days of one core."""

MOST_RUNS = 10**7
"""Of samples on the rough grid, each of which is a file."""

# Bytes, estimated upwards: per particle and per stored node while a grid is built and brought to rest, per node that is
# not stored, per point of the box that particles are chosen from, and per particle of each further lane. With PROCESS
# they give 0.54 and 1.09 GB for the published slope's two grids in 3D; at its peak a process takes 0.50 and 0.90
# (docs/clusters.md). What a node that is not stored takes is its bedrock, on a grid that its sky makes twice as high.
PER_PARTICLE, PER_NODE, PER_POINT, PER_LANE, PER_NODE_OF_AIR = 600, 200, 120, 150, 40
PROCESS = 5e8
"""Of one process, with JAX and its compiled programs."""


@dataclass(frozen=True)
class GridSize:
    """One grid.

    Args:
        particles: in all.
        nodes: that are stored.
        air: nodes that are not.
        points: of the box around the slope that are in memory at once.
        steps: of a run.
        passes: filters of averaging in each step.
    """

    particles: float
    nodes: float
    air: float
    points: float
    steps: float
    passes: float

    @property
    def work(self) -> float:
        """What a run takes, in particles times steps; a filter over the nodes is a tenth of a particle's step."""
        return (self.particles + 0.1 * self.passes * self.nodes) * self.steps

    def memory(self, lanes: int) -> float:
        """Bytes of its model and of a program with so many lanes."""
        model = self.particles * PER_PARTICLE + self.points * PER_POINT
        model += self.nodes * PER_NODE + self.air * PER_NODE_OF_AIR
        return model + (lanes - 1) * (self.particles * PER_LANE + self.nodes * PER_NODE / 4)


def grid_size(campaign: Campaign, grid: str) -> GridSize:
    """Size of one grid.

    Args:
        campaign: the campaign.
        grid: "rough" or "refined".

    Raises:
        ValueError: slope, soil and grid do not fit together.
    """
    site, numerics, gravity = campaign.site, campaign.grids[grid], campaign.run.gravity
    shape = site.shape
    cells, speed = ground.cells(shape, numerics), math.sqrt(gravity * shape.extent[-1])
    site.layer_of(np.zeros((campaign.dimension, 0)), numerics)  # which refuses lines that do not go together

    def alone(soil: AnySoil) -> Scene:
        # One particle of the same soil has the same time step, and meets the same checks.
        domain, corner = (2 * numerics.cell,) * campaign.dimension, (0.0,) * campaign.dimension
        local = numerics if getattr(soil, "softens", True) else replace(numerics, internal_length=None)
        return block(numerics.spacing, soil, local, domain=domain, corner=corner, speed=speed)[0]

    soils = [layer.soil for layer in site.soils(campaign.soil)]
    scenes = [alone(soil) for soil in soils]
    one = min(scenes, key=lambda scene: float(scene.numerics.time_step))
    for soil, random in zip(soils, [layer.random for layer in site.layers] or [campaign.random], strict=True):
        if _varies_in_steepness(soil.material(np.dtype("float32"), numerics.cell), random):
            _refused_at_the_ends(alone, _steepest(soil, random, site.span))
    dt, particle_size = float(one.numerics.time_step), math.prod(numerics.spacing)
    steps = campaign.run.last(grid) / dt if dt > 0 else math.inf
    passes = max(scene.numerics.nonlocal_passes or 0 for scene in scenes)
    counts = [count + 3.0 for count in cells]
    filled = ground.volume(shape) / numerics.cell**campaign.dimension
    nodes = max(ground.estimated_nodes(scene, math.prod(counts), math.prod(counts[:-1]), filled) for scene in scenes)
    return GridSize(
        particles=ground.volume(shape) / particle_size,
        nodes=nodes,
        air=math.prod(counts) - nodes,
        points=ground.points_held(shape, numerics),
        steps=steps,
        passes=passes,
    )


def _varies_in_steepness(law: Material, random: Collection[str]) -> bool:
    """Whether parameters vary of the part that governs how steeply a law softens."""
    numbers = declared(law)
    return law.steepest_softening is not None and any(
        numbers[name].path.startswith("softening.") for name in random if name in numbers
    )


def _steepest(soil: AnySoil, random: Mapping[str, RandomField], span: tuple[float, float]) -> AnySoil:
    """The soil where it softens most steeply beside its shear modulus: what varies at such ends of its values."""

    def steepness(varied: AnySoil) -> float:
        law = varied.material(np.dtype("float32"), 1.0)
        return 0.0 if law.steepest_softening is None else float(law.steepest_softening / law.shear)

    names = [name for name in random if hasattr(soil, name) and name != "strength_ratio"]
    ends = product(*(random[name].extremes(span) for name in names))
    return max((replace(soil, **dict(zip(names, values, strict=True))) for values in ends), key=steepness)


def _refused_at_the_ends(alone: Callable[[AnySoil], Scene], soil: AnySoil) -> None:
    """Raise ValueError where the soil at the ends of what varies softens too steeply for any run."""
    try:
        alone(soil)
    except ValueError as error:
        where = f"soil {TAIL:g} deviations from the middle of what varies, less far with a smaller cov"
        raise about(where, error) from error


def check_size(campaign: Campaign, workers: int = 1) -> None:
    """Raise ValueError for a campaign that cannot run here, before anything larger than a particle is built.

    Args:
        campaign: the campaign.
        workers: processes that hold both grids each.

    Raises:
        ValueError: slope, soil and grids that do not fit together, and for a campaign that would not end or not fit
            into the memory of this machine, or of the devices that hold its arrays.
    """
    campaign.require()
    check_cells(campaign)
    runs = _first_runs(campaign)
    if runs > MOST_RUNS:
        first = next(iter(campaign.grids))
        raise ValueError(f"the campaign asks for {runs} {first} runs, the limit is {MOST_RUNS:.0e}: give fewer samples")
    sizes = {grid: grid_size(campaign, grid) for grid in campaign.grids}
    for grid, size in sizes.items():
        t_end, step = campaign.run.t_end, campaign.run.last(grid) / size.steps
        if t_end < step:
            raise ValueError(
                f"t_end = {t_end:g} s is less than one time step of the {grid} grid, {step:.2g} s: "
                "give the seconds that a slide takes"
            )
        if not size.steps <= MOST_STEPS:
            raise ValueError(
                f"{grid} grid: a run takes {size.steps:.3g} steps, the limit is {MOST_STEPS:.0e}: give a larger cell, "
                "a larger cfl, softer soil or a shorter t_end"
            )
        if not size.work <= MOST_WORK:
            raise ValueError(
                f"{grid} grid: a run takes {size.particles:.3g} particles times {size.steps:.3g} steps, "
                f"{size.work:.1e} with {size.passes:.3g} averages in each; the limit is {MOST_WORK:.0e}: give "
                "larger cells and spacings"
            )
    _check_memory(
        sizes, workers, {grid: min(lanes_of(campaign.plan, grid, sizes[grid].particles), runs) for grid in sizes}
    )


def _check_memory(sizes: Mapping[str, GridSize], workers: int, lanes: Mapping[str, int]) -> None:
    """Raise ValueError for grids beyond the memory of this machine, or of the devices that hold their arrays."""
    what = f"{sizes['rough'].particles:.3g} rough and {sizes['refined'].particles:.3g} refined particles"
    what += f" in {workers} workers" if workers > 1 else f" in {lanes['rough']} and {lanes['refined']} lanes"
    remedy = "give larger cells and spacings, fewer lanes or fewer workers"
    lent, alone = lent_by(devices_of()), dict.fromkeys(sizes, 1)

    def models(lanes: Mapping[str, int], process: float) -> float:
        one = sum(size.memory(lanes[grid]) for grid, size in sizes.items()) + process
        # The controller builds both grids too, to see that they fit.
        return one + (workers * one if workers > 1 else 0.0)

    # Where arrays stand on a device, the host has those of one lane, while it builds a grid.
    on_host = alone if workers > 1 or math.isfinite(lent) else lanes
    _refuse_beyond(memory_limit(), models(on_host, PROCESS), what, "this machine", remedy)
    on_device = {grid: count // len(devices_of(count)) for grid, count in (alone if workers > 1 else lanes).items()}
    remedy += ", or let JAX take a larger share of the device (XLA_CLIENT_MEM_FRACTION=0.95)"
    _refuse_beyond(lent, models(on_device, 0.0), what, f"each {devices_of()[0].device_kind}", remedy)


def check_all(campaign: Campaign) -> None:
    """Check what can be checked of a campaign without building its grids.

    Args:
        campaign: the campaign.

    Raises:
        Faults: of its size here, and of its random fields.
    """
    gathered = check.Gathered()
    with gathered.of():
        check_size(campaign)
    with gathered.of():
        check_coefficients(campaign, random_soil(campaign).modes)
    gathered.raise_all()


def check_coefficients(campaign: Campaign, modes: int) -> None:
    """Raise ValueError for more coefficients than this machine's memory holds.

    Args:
        campaign: the campaign.
        modes: coefficients of a sample.
    """
    runs = _first_runs(campaign)
    # The design, a copy while it is made, and the controller's own; all of NumPy.
    needed = 12.0 * runs * modes + PROCESS
    what = f"{runs} samples of {modes} coefficients"
    remedy = "give fewer samples, longer correlation lengths or less energy"
    _refuse_beyond(memory_limit(), needed, what, "this machine", remedy)


def _first_runs(campaign: Campaign) -> int:
    """Runs on the campaign's first grid."""
    return campaign.estimator.rough_runs(sampling_of(campaign)) if campaign.coarse is None else campaign.plan.samples


def _refuse_beyond(limit: float, needed: float, what: str, lender: str, remedy: str) -> None:
    if not needed <= limit:
        raise ValueError(f"{what} take some {needed / 1e9:.3g} GB, {lender} lends {limit / 1e9:.3g} GB: {remedy}")


def memory_limit() -> float:
    """Bytes that a process of this machine may use: its memory, or less where the system limits it; inf if unknown."""
    return min(_limits(), default=math.inf)


def _limits() -> Iterator[float]:
    if hasattr(os, "sysconf") and {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= os.sysconf_names.keys():
        yield float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError):
        yield float(Path("/sys/fs/cgroup/memory.max").read_bytes())
    try:
        import resource  # not on every system
    except ImportError:
        return
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
        soft, _ = resource.getrlimit(kind)
        if soft != resource.RLIM_INFINITY:
            yield float(soft)


@by_value
@dataclass(frozen=True)
class Cost:
    """What a campaign takes on this machine.

    Args:
        sizes: of the grids, by name.
        runs: how many there are of each, at most on the refined grid; one of each where nothing is random.
        step: seconds of one step of a run on each; none where no run was tried.
    """

    sizes: Mapping[str, GridSize]
    runs: Mapping[str, int]
    step: Mapping[str, float]

    def hours(self, grid: str) -> float:
        """Of one core, if no run ended before its time: they end once they have settled, most after a fifth of it."""
        return self.runs[grid] * self.sizes[grid].steps * self.step[grid] / 3600

    @property
    def memory(self) -> float:
        """Bytes of the grids with one lane each."""
        return sum(size.memory(1) for size in self.sizes.values())


def cost_of(campaign: Campaign, seconds: float | None = None) -> Cost:
    """What a campaign takes, once its grids have been built.

    Args:
        campaign: the campaign.
        seconds: of a trial, in which a run of each grid takes its part, compiling not counted; None for no trial.

    Raises:
        Faults: ground, soil and grids do not fit together.
    """
    gathered, models, soil = check.Gathered(), {}, random_soil(campaign)
    for grid in campaign.grids:
        with gathered.of(f"{grid} grid"):
            models[grid] = build(campaign, grid, soil, at_rest=False)
    gathered.raise_all()
    rough = campaign.estimator.rough_runs(sampling_of(campaign))
    budget = campaign.estimator.budget(rough)
    runs = {"coarse": campaign.plan.samples, "rough": rough, "refined": rough if budget is None else min(budget, rough)}
    return Cost(
        sizes={grid: grid_size(campaign, grid) for grid in models},
        runs={grid: runs[grid] if campaign.varies else 1 for grid in models},
        step={}
        if seconds is None
        else {grid: seconds_per_step(model, seconds / len(models)) for grid, model in models.items()},
    )


def seconds_per_step(model: GridModel, seconds: float) -> float:
    """Seconds of one step of a run of the median soil, from as many as fit into the time given.

    Args:
        model: the grid.
        seconds: of the trial.
    """
    scene, start = model.median
    state, taken, spent, steps = _steps(scene, start, 1), 0, 0.0, 1
    while spent < seconds:
        first = time.perf_counter()
        after = jax.block_until_ready(_steps(scene, state, steps))
        spent += time.perf_counter() - first
        taken += max(int(after.step) - int(state.step), 1)
        # It starts free of stress, and may break off; then it begins again.
        state = after if int(after.status) == Status.RUNNING else start
        steps = min(2 * steps, 1000)
    return spent / taken


@jax.jit
def _steps(scene: Scene, state: State, steps: int) -> State:
    return advance(scene, state, jnp.asarray(steps))
