"""From a sample's number to its row: scene on a grid, strength from the coefficients, run, consequences."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import kl
from cooperative.estimate import Sampling
from cooperative.measure import FailureMode, ModeRules, Motion, SlopeGeometry, consequences, failure_mode
from cooperative.runs._restart import RestartPoint, read_restart, write_restart
from cooperative.scene import Config, built
from cooperative.store import Sample, Scalar, read_store
from jaxmpm import Chunk, Midway, Result, Scene, Slope, State, Status, solve_each


@dataclass(frozen=True)
class GridModel:
    """One grid of a campaign, ready to run: its scene, the shared initial state, the field's expansion; the factor on
    its strength where the grids are calibrated."""

    grid: str
    config: Config
    scene: Scene
    state: State
    expansion: kl.Expansion
    strength_factor: float = 1.0

    @property
    def half_size(self) -> np.ndarray:
        """Half the particle spacing per axis (d,) m."""
        return np.asarray(self.config.grids[self.grid].spacing) / 2

    @property
    def reach(self) -> float:
        """Distance up to which two particles hang together [m]: a little more than the diagonal of a cell."""
        return 1.5 * self.scene.grid.cell

    def strength(self, coefficients: Any) -> jax.Array:
        """Undrained strength at the particles (N,) Pa, for coefficients (M,)."""
        strength = self.config.strength
        marginal = strength.marginal(strength.mean, strength.cov)
        points = self.scene.particles.position if strength.sampled_at == "particles" else self._cell_centres()
        field = _strength(self.expansion, marginal, coefficients, points)
        return field if self.strength_factor == 1 else field * self.strength_factor

    def _cell_centres(self) -> jax.Array:
        """Centre of the cell that each particle starts in (d, N) m, kept in the slope's box where that ends in it."""
        grid, shape = self.scene.grid, self.config.slope
        origin = jnp.asarray(grid.origin)[:, None]
        centre = origin + (jnp.floor((self.scene.particles.position - origin) / grid.cell) + 0.5) * grid.cell
        return jnp.minimum(centre, jnp.asarray(box_of(shape))[:, None])


@jax.jit
def _strength(expansion: kl.Expansion, marginal: Any, coefficients: Any, position: Any) -> Any:
    return marginal.transform(kl.field_at(expansion, coefficients, position))


def expansion_of(config: Config) -> kl.Expansion:
    """The strength's expansion over the whole box of the slope, the same for every grid."""
    strength, extent = config.strength, box_of(config.slope)
    return kl.expand(
        tuple(strength.correlation(length) for length in strength.length),
        origin=(0.0,) * len(extent),
        extent=extent,
        energy=strength.energy,
    )


def box_of(shape: Slope) -> tuple[float, ...]:
    """Edges of the box from the origin that holds the slope (d,) m."""
    top = shape.foundation + shape.height
    return (shape.length, top) if shape.width is None else (shape.length, shape.width, top)


def coefficients_of(config: Config, expansion: kl.Expansion) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for."""
    return np.asarray(config.plan.coefficients(jax.random.key(config.plan.seed), config.plan.samples, expansion.modes))


def sampling_of(config: Config) -> Sampling:
    """The first phase as the campaign's estimator sees it; the random field is expanded when first asked for."""
    expansion = lru_cache(maxsize=1)(lambda: expansion_of(config))
    return Sampling(
        config.plan.samples,
        config.run.failure_displacement,
        config.plan.screening_stop,
        modes=lambda: int(expansion().modes),
        draw=lambda: coefficients_of(config, expansion()),
    )


def build(config: Config, grid: str, expansion: kl.Expansion) -> GridModel:
    """Scene and initial state of one grid; ValueError where slope, soil and grid do not fit together."""
    scene, state = built(config, grid)
    factor = config.calibration.factor if config.calibration and grid == "rough" else 1.0
    return GridModel(grid, config, scene, state, expansion, factor)


def run_samples(
    model: GridModel,
    coefficients: np.ndarray | Mapping[int, np.ndarray],
    numbers: Iterable[int],
    *,
    width: int | None = None,
    stop_at: float | None = None,
    on_chunk: Callable[[Chunk], None] | None = None,
    restart_in: Path | None = None,
) -> Iterator[Sample]:
    """Run the samples with these numbers, whose coefficients are (modes,) each, and yield each as it ends, `seconds`
    after the one before.

    width: lanes at a time; None takes 1 on CPU, where lanes run in turn, and 64 elsewhere. restart_in: folder of the
    campaign, where runs longer than `restart_every` write restart points and go on from those that are there; None, or
    a folder that is not there, is for runs without.
    """
    if width is None:
        width = 1 if jax.default_backend() == "cpu" else 64
    config, run, started = model.config, model.config.run, time.perf_counter()
    at_rest = Motion.start(np.asarray(model.scene.particles.volume), run.failure_displacement)
    motions: dict[int, Motion] = {}
    written: dict[int, float] = {}
    before: dict[int, float] = {}
    folder = restart_in if restart_in is not None and (restart_in / "scene.toml").is_file() else None
    digest = "" if folder is None else read_store(folder).digest

    def begin(number: int) -> Midway | None:
        written[number] = time.perf_counter()
        point = None
        if folder is not None:
            point = read_restart(folder, model.grid, number, digest, like=model.state, start=at_rest)
        motions[number] = at_rest if point is None else point.motion
        before[number] = 0.0 if point is None else point.seconds
        return None if point is None else point.midway

    def remember(number: int, seconds: float, midway: Midway) -> None:
        motions[number] = motions[number].after(seconds, np.asarray(_moved(midway.state.displacement)))
        now = time.perf_counter()
        due = now - written[number] > config.plan.restart_every
        if folder is not None and due and midway.state.status == Status.RUNNING:
            point = RestartPoint(midway, motions[number], before[number] + now - started)
            write_restart(folder, model.grid, number, digest, point)
            written[number] = now

    remembers = folder is not None or model.grid in config.plan.modes
    strengths = ((number, model.strength(jnp.asarray(coefficients[number]))) for number in numbers)
    for number, result in solve_each(
        model.scene, model.state, strengths, width=width, t_end=run.t_end, settle=run.settle, stop_at=stop_at,
        on_chunk=on_chunk, observe=remember if remembers else None, resume=begin,
    ):  # fmt: skip
        seconds, started = before[number] + time.perf_counter() - started, time.perf_counter()
        motion = motions.pop(number) if model.grid in config.plan.modes else None
        yield finished(model, number, coefficients[number], result, seconds, motion)


@jax.jit
def _moved(displacement: jax.Array) -> jax.Array:
    return jnp.linalg.norm(displacement, axis=0)


def finished(
    model: GridModel,
    number: int,
    coefficients: np.ndarray,
    result: Result,
    seconds: float,
    motion: Motion | None = None,
) -> Sample:
    """The record of a run; its mode too, where its past was remembered. A run that broke off has no consequences,
    only the displacement it had reached."""
    scene, config = model.scene, model.config
    displacement = np.asarray(result.state.displacement)
    history = result.state.history
    fields: dict[str, np.ndarray] = {}
    if model.grid in config.plan.fields:
        fields["displacement"] = displacement.astype(np.float32)
        if history is not None:
            fields["plastic_strain"] = np.asarray(history, np.float32)
    row: dict[str, Scalar]
    if bool(result.failed):
        reached = np.linalg.norm(displacement, axis=0)
        row = {"displacement": float(np.max(reached, where=np.isfinite(reached), initial=0.0)), "broke_off": True}
    else:
        run = (
            np.asarray(scene.particles.position),
            displacement,
            np.asarray(scene.particles.volume),
            geometry_of(config),
        )
        limit = config.run.failure_displacement
        measured = consequences(*run, half_size=model.half_size, sliding_displacement=limit, reach=model.reach)
        row = {**measured.as_row(), "broke_off": False}
        if motion is not None:
            rules = ModeRules(sliding_displacement=limit)
            mode = failure_mode(*run, half_size=model.half_size, motion=motion, rules=rules)
            row |= mode_row(mode)
            fields["slice_depth"] = mode.depth.astype(np.float32)
    return Sample(
        number=number,
        status=Status(int(result.status)).name,
        steps=int(result.state.step),
        seconds=seconds,
        coefficients=coefficients,
        row=row,
        fields=fields,
        dtype=str(displacement.dtype),
        device=jax.devices()[0].device_kind,
    )


def mode_row(mode: FailureMode) -> dict[str, Scalar]:
    """A mode's scalars: its name, how many masses slide, depth of the shallowest and deepest [m], and when the first
    and, if progressive, the second began to let go [s]. What a mode does not have is left out."""
    row: dict[str, Scalar] = {"mode": mode.name, "masses": len(mode.masses)}
    if mode.masses:
        row |= {"depth_shallowest": min(mode.masses), "depth_deepest": max(mode.masses)}
    return row | dict(zip(("onset", "onset_second"), mode.released, strict=False))


def geometry_of(config: Config) -> SlopeGeometry:
    """Where the slope's toe is and how high it stands."""
    shape = config.slope
    return SlopeGeometry(toe_x=shape.toe_x, toe_z=shape.foundation, height=shape.height)
