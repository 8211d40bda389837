"""Samples through the lanes of one grid's program: from a sample's number and coefficients to its row."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import tee
from operator import itemgetter
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from cooperative.measure import (
    FailureMode,
    ModeRules,
    ReleaseHistory,
    consequences,
    exceeded,
    failure_mode,
    walls_reached,
)
from cooperative.runs._model import GridModel
from cooperative.runs._restart import Frames, RestartPoint, read_restart, write_restart
from cooperative.runs._stopping import Asked, Stopped
from cooperative.store import MOVING, SLIDES, FinishedRun, Scalar, stored_source
from jaxmpm import Face, Result, Status, diagnostics, solve_each
from jaxmpm.run import Chunk, Hooks, Midway, Rule, passing

GROUND_MOVED = "column_ground"
"""Field of a slide: how far the ground of each column has moved (m), the largest displacement of what was its top."""
COLUMNS = ("column_deposit", "column_thickness", "column_speed", "column_arrival")
"""Fields of a slide, one value for each column, of the soil that lies or moves above the surface that was there before:
thickness at the end (m), largest thickness (m) and speed (m/s), and time of arrival (s), nan where it never came."""

_passing = jax.jit(passing)


def run_samples(
    model: GridModel,
    coefficients: np.ndarray | Mapping[int, np.ndarray],
    numbers: Iterable[int],
    *,
    width: int | None = None,
    rules: Sequence[Rule] | None = None,
    on_chunk: Callable[[Chunk], None] | None = None,
    restart_in: Path | None = None,
    stop: Asked = lambda: False,
    slides: bool = False,
) -> Iterator[FinishedRun]:
    """Run the samples with these numbers, and yield each as it ends.

    Args:
        model: the grid.
        coefficients: (modes,) of each number.
        numbers: of the samples.
        width: lanes at a time; None for `model.lanes`.
        rules: that end a run before its end time, by default `model.campaign.rules()`.
        on_chunk: called after every chunk of steps.
        restart_in: folder of the campaign, where runs longer than `restart_every` write restart points and go on from
            those that are there; None, or a folder that is not there, is for runs without.
        stop: called after every chunk of steps; once it is true no further sample begins, and those under way write
            restart points.
        slides: go on from where refined runs had failed, see `Plan.slides`, or from where slides that had not come to
            rest ended; a run without a restart point starts afresh.

    Yields:
        Each sample, its `seconds` those after the one before.

    Raises:
        Stopped: once `stop` was true.
    """
    under_way, left_out = _UnderWay(model, restart_in, stop, SLIDES if slides else model.grid), False

    def until_stopped() -> Iterator[int]:
        nonlocal left_out
        for number in numbers:
            left_out = stop()
            if left_out:
                return
            yield number

    def looked(chunk: Chunk) -> None:
        under_way.watch(chunk.busy)
        if on_chunk is not None:
            on_chunk(chunk)

    to_run, to_draw = tee(until_stopped())
    names = model.varied_names
    soils = tee((model.varied(jnp.asarray(coefficients[number])) for number in to_draw), len(names))
    varied = {name: map(itemgetter(name), soil_of_sample) for name, soil_of_sample in zip(names, soils, strict=True)}
    for number, result in solve_each(
        model.scene, model.state, varied, numbers=to_run, width=model.lanes if width is None else width,
        t_end=model.t_end, rules=model.campaign.rules() if rules is None else rules,
        hooks=Hooks(under_way.begin, looked, under_way.remember if under_way.remembers else None),
    ):  # fmt: skip
        lane = under_way.lanes.pop(number)
        seconds = lane.before + under_way.lap()
        motion = lane.motion if model.grid in model.campaign.modes else None
        yield finished_run(model, number, coefficients[number], result, seconds, motion, lane.frames)
    if left_out:
        raise Stopped


@dataclass
class _Lane:
    """A run under way.

    motion: its past for the modes. before: seconds that it had taken when this process took it up. written: when its
    last restart point was written.
    """

    motion: ReleaseHistory
    frames: Frames
    before: float
    written: float


class _UnderWay:
    """The runs under way between chunks of steps: their past for the modes, frames, restart points.

    folder: of the campaign, None without restart points. stored_as: the grid of its samples, or SLIDES. lanes: by
    number. started: when the last run ended. stopping: whether a stop was seen after the last chunk. busy: lanes of
    that chunk not shown yet. any_ended: whether a run ended with it.
    """

    def __init__(self, model: GridModel, folder: Path | None, stop: Asked, stored_as: str) -> None:
        source = None if folder is None else stored_source(folder)
        self.digest, self.folder = ("", None) if source is None else (source.digest, folder)
        self.model, self.stop, self.stored_as = model, stop, stored_as
        plan, volume = model.campaign.plan, np.asarray(model.scene.particles.volume)
        self.at_rest = ReleaseHistory.start(volume, model.campaign.run.failure_displacement)
        self.remembers = self.folder is not None or model.grid in (*model.campaign.modes, *plan.fields)
        self.lanes: dict[int, _Lane] = {}
        self.started, self.stopping, self.busy, self.any_ended = time.perf_counter(), False, 0, False

    def lap(self) -> float:
        """Seconds since a run ended the last time."""
        before, self.started = self.started, time.perf_counter()
        return self.started - before

    def begin(self, number: int) -> Midway | None:
        """Where a sample goes on from."""
        names = (self.stored_as, MOVING) if self.stored_as == SLIDES else (self.stored_as,)
        kept = (
            read_restart(self.folder, name, number, self.digest, like=self.model.state, start=self.at_rest)
            for name in names
            if self.folder is not None
        )
        point = next(filter(None, kept), None)
        past = (self.at_rest, Frames(), 0.0) if point is None else (point.motion, point.frames, point.seconds)
        self.lanes[number] = _Lane(*past, time.perf_counter())
        return None if point is None else point.midway

    def watch(self, busy: int) -> None:
        """After a chunk, before its lanes are shown; those that ended with the chunk before have been given out."""
        if self.stopping:
            raise Stopped
        self.stopping, self.busy, self.any_ended = self.stop(), busy, False

    def remember(self, number: int, seconds: float, midway: Midway) -> None:
        """One lane after a chunk.

        Raises `Stopped` after the last one, if none waits to be given out.
        """
        lane, running = self.lanes[number], int(midway.state.status) == Status.RUNNING
        goes_on_as = self._goes_on_as(seconds, midway)
        if seconds > lane.motion.times[-1]:  # a lane with a number that none may have takes no step
            self._follow(lane, seconds, midway, frames=running or goes_on_as == SLIDES)
        now = time.perf_counter()
        due = not running or self.stopping or now - lane.written > self.model.campaign.plan.restart_every
        if self.folder is not None and goes_on_as is not None and due:
            state = replace(midway.state, status=jnp.asarray(int(Status.RUNNING), jnp.int32))
            taken = lane.before + now - self.started
            point = RestartPoint(replace(midway, state=state), lane.motion, lane.frames, taken)
            write_restart(self.folder, goes_on_as, number, self.digest, point)
            lane.written = now
        self.busy -= 1
        self.any_ended |= not running
        if self.stopping and not self.busy and not self.any_ended:
            raise Stopped

    def _goes_on_as(self, seconds: float, midway: Midway) -> str | None:
        """What its restart point is kept as: of a failure for its slide, of a slide without rest for a later end.

        None for a run that has ended for good.
        """
        status = int(midway.state.status)
        if status == Status.RUNNING:
            return self.stored_as
        kept = {Status.DECIDED: SLIDES, Status.FINISHED: MOVING}.get(Status(status))
        return kept if kept and self.model.slides_on and self._fails(midway, seconds) else None

    def _follow(self, lane: _Lane, seconds: float, midway: Midway, *, frames: bool) -> None:
        """Add the motion of a chunk to a lane's past, and a frame where one is due."""
        moved, farthest = _moved(midway.state.displacement)
        lane.motion = lane.motion.after(seconds, moved)
        stored = frames and self.model.grid in self.model.campaign.plan.fields
        if stored and lane.frames.due(float(farthest), lane.motion.failure_displacement):
            lane.frames = lane.frames.after(seconds, midway.state.displacement)

    def _fails(self, midway: Midway, seconds: float) -> bool:
        """Whether enough soil of a run that has ended moved as far as a failure, or is bound to."""
        campaign = self.model.campaign
        reached = diagnostics.exceeded_displacement(self.model.scene, midway.state, campaign.failing_volume)
        return foreseen(float(reached), seconds, midway) > campaign.run.failure_displacement


@jax.jit
def _moved(displacement: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How far each particle has moved (N,) m, and the farthest."""
    moved = jnp.linalg.norm(displacement, axis=0)
    return moved, moved.max()


def finished_run(
    model: GridModel,
    number: int,
    coefficients: np.ndarray,
    result: Result,
    seconds: float,
    motion: ReleaseHistory | None = None,
    frames: Frames | None = None,
) -> FinishedRun:
    """The record of a run; its mode too, where its past was remembered, and its frames if it failed.

    A run that broke off, or a refined one that ended once its class was decided, has no consequences, only the
    displacement it had reached. That of a run whose class was decided is the one that the rule which ended it foresees.

    Args:
        model: the grid.
        number: of the sample.
        coefficients: of the sample (terms,).
        result: of the run.
        seconds: of wall time.
        motion: its past, None where not remembered.
        frames: of the run.
    """
    time = float(result.state.step * result.time_step)
    decided = model.grid == "refined" and int(result.status) == Status.DECIDED
    fields = _fields_at_end(result) if model.grid in model.campaign.plan.fields and not decided else {}
    if decided or result.broke_off:
        measures = _displacement_alone(model, result)
    else:
        measures, of_slide = _measured(model, result, motion, frames)
        fields |= of_slide
    counts = foreseen(float(measures["displacement"]), time, result)
    row = {**measures, "displacement": counts, "broke_off": bool(result.broke_off), "time": time}
    if (level := model.water_level(coefficients)) is not None:
        row["water_level"] = level
    return FinishedRun(
        number, Status(int(result.status)).name, int(result.state.step), seconds, coefficients, row, fields,
        dtype=str(result.state.displacement.dtype), device=jax.devices()[0].device_kind,
    )  # fmt: skip


def _fields_at_end(result: Result) -> dict[str, np.ndarray]:
    """Displacement, and plastic strain where the law remembers it."""
    history, fields = result.state.history, {"displacement": np.asarray(result.state.displacement, np.float32)}
    strain = getattr(history, "strain", history)  # of a law that remembers more, the part that is named so
    if getattr(strain, "shape", None) == fields["displacement"].shape[1:]:  # layers of other laws have one each
        fields["plastic_strain"] = np.asarray(strain, np.float32)
    return fields


def _displacement_alone(model: GridModel, result: Result) -> dict[str, Scalar]:
    """The one measure of a run that broke off, or whose class alone is known; what is not finite has not moved."""
    moved = np.linalg.norm(np.asarray(result.state.displacement), axis=0)
    volume = np.asarray(model.scene.particles.volume)
    return {"displacement": exceeded(np.where(np.isfinite(moved), moved, 0.0), volume, model.campaign.failing_volume)}


def _measured(
    model: GridModel, result: Result, motion: ReleaseHistory | None, frames: Frames | None
) -> tuple[dict[str, Scalar], dict[str, np.ndarray]]:
    """Measures of a run that came to its end, and fields: frames and columns of a failure, slices of its mode."""
    scene, campaign, geometry = model.scene, model.campaign, model.geometry
    position, volume = np.asarray(scene.particles.position), np.asarray(scene.particles.volume)
    run = position, np.asarray(result.state.displacement), volume
    half, limit, fields = model.half_size, campaign.run.failure_displacement, dict[str, np.ndarray]()
    slide = consequences(
        *run, geometry, half_size=half, failure_displacement=limit, reach=model.reach,
        least_volume=campaign.failing_volume, runout_thickness=campaign.runout_thickness,
    )  # fmt: skip
    walls = walls_reached(
        *run, model.walls, half_size=half, failure_displacement=limit, within=scene.grid.cell, reach=model.reach,
        polygon=campaign.site.fixed_edge,
    )  # fmt: skip
    row: dict[str, Scalar] = {**slide.as_row(), "walls": walls}
    if slide.displacement > limit:
        fields |= {} if frames is None else frames.as_fields()
        fields |= (columns := column_fields(model, result))
        row |= column_row(model, columns)
    if motion is not None and isinstance(geometry, Face):
        rules = ModeRules(failure_displacement=limit, valley=campaign.plan.valley)
        mode = failure_mode(*run, geometry, half_size=half, motion=motion, rules=rules)
        row |= mode_row(mode)
        fields["slice_depth"] = mode.depth.astype(np.float32)
    return row, fields


def foreseen(displacement: float, time: float, run: Result | Midway) -> float:
    """Displacement (m) for which a run counts that has ended: what it had reached, or what its rule foresees.

    Args:
        displacement: reached (m).
        time: at its end (s).
        run: that has ended.
    """
    if int(run.state.status) == Status.DECIDED and isinstance(run.ended_by, Rule):
        return run.ended_by.foreseen(displacement, time)
    return displacement


def mode_row(mode: FailureMode) -> dict[str, Scalar]:
    """A mode's scalars; what a mode does not have is left out.

    Its name, how many masses slide, depth of the shallowest and deepest (m), and when the first and, if progressive,
    the second began to let go (s).
    """
    row: dict[str, Scalar] = {"mode": mode.name, "masses": len(mode.masses)}
    if mode.masses:
        row |= {"depth_shallowest": min(mode.masses), "depth_deepest": max(mode.masses)}
    return row | dict(zip(("onset", "onset_second"), mode.released, strict=False))


def column_fields(model: GridModel, result: Result) -> dict[str, np.ndarray]:
    """Fields of the columns at the end of a slide; none where the scene has no maps."""
    state, columns = result.state, result.state.columns
    if columns is None:
        return {}
    now = _passing(model.scene, jax.tree.map(jnp.asarray, state), columns.moved, columns.surface)
    deposit, thickness = np.asarray(now.thickness), np.asarray(columns.thickness)
    arrival = np.asarray(columns.arrival)
    # The run may have ended between two looks.
    came = (deposit >= columns.least) & ~np.isfinite(arrival)
    arrival = np.where(came, float(state.step) * float(result.time_step), arrival)
    arrival = np.where(np.isfinite(arrival), arrival, np.nan)
    values = deposit, np.maximum(thickness, deposit), np.asarray(columns.speed), arrival
    fields = {name: values_there.astype(np.float32) for name, values_there in zip(COLUMNS, values, strict=True)}
    return fields | {GROUND_MOVED: _ground_moved(model, np.asarray(state.displacement)).astype(np.float32)}


def _ground_moved(model: GridModel, displacement: np.ndarray) -> np.ndarray:
    """Largest displacement (m) of the soil that was in the top cell below the surface, for each column."""
    position, plan = np.asarray(model.scene.particles.position), model.columns
    top = model.campaign.site.shape.heights(*position[:-1].astype(float)) - position[-1] <= plan.cell
    cells = np.floor((position[:-1] - np.array(plan.origin)[:, None]) / plan.cell).astype(int)
    at = tuple(np.clip(index, 0, count - 1)[top] for index, count in zip(cells, plan.shape, strict=True))
    moved = np.zeros(plan.shape)
    np.maximum.at(moved, at, np.linalg.norm(displacement, axis=0)[top])
    return moved


def column_row(model: GridModel, columns: dict[str, np.ndarray]) -> dict[str, Scalar]:
    """Scalars of the columns of a slide, where it has them.

    `area_columns` is the plan area (m2, in a section m) of the columns beyond the toe on which soil lies at the end.
    The others are, of the soil above the surface that was there before, the largest thickness (m) and speed (m/s) at
    each element at risk, and the time (s) at which it arrived there, if it did. `ground_at` is how far the element's
    own ground has moved (m).
    """
    passed = model.state.columns
    if not columns or passed is None:
        return {}
    plan = model.columns
    covered, face = columns["column_deposit"] >= passed.least, model.campaign.site.shape.face
    row: dict[str, Scalar] = {"area_columns": float(covered[plan.beyond(face)].sum()) * plan.area}
    for element in model.campaign.elements_at_risk:
        columns_there = element.columns(plan)
        _, thickness, speed, arrival = (columns[name][columns_there] for name in COLUMNS)
        row[f"thickness_at_{element.key}"] = float(thickness.max())
        row[f"speed_at_{element.key}"] = float(speed.max())
        row[f"ground_at_{element.key}"] = float(columns[GROUND_MOVED][columns_there].max())
        reached = arrival[np.isfinite(arrival)]
        if reached.size:
            row[f"arrival_at_{element.key}"] = float(reached.min())
    return row
