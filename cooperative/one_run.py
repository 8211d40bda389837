"""One slide: a soil of a scene run on one grid, what comes of it in words and numbers, and its pictures."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from subprocess import CalledProcessError
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import numpy as np

import jaxmpm
import kl
from cooperative import runs
from cooperative.measure import ReleaseHistory
from cooperative.reporting import panels, save, units_of_campaign
from cooperative.scene import Campaign, RandomField
from cooperative.store import FinishedRun, own_folder
from jaxmpm import Scene, State, diagnostics, solve_each, write_vtkhdf
from jaxmpm.laws import declared
from jaxmpm.run import Hooks, Midway
from jaxmpm.support import check

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation  # loads what only animations need

CERTAIN = 1e-6
"""Coefficient of variation of what is certain."""
MILLISECONDS = 100.0
"""Between two pictures of an animation."""
WRITERS = {".mp4": "ffmpeg", ".gif": "pillow"}
"""What matplotlib writes an animation by, by the ending of its file."""
DOTS = 80
"""Dots of an animation to the inch."""


@dataclass(frozen=True)
class Slide:
    """A run of one soil.

    Args:
        name: of the scene.
        soil: in words.
        grid: in words.
        failure_displacement: from which on soil slides (m).
        least_volume: of soil that has to slide, in m3 or, in a section, m2; None for any particle.
        units: of the numbers of the run, in words.
        scene: of the solver.
        sample: status, numbers and fields of the run, see `cooperative.store.FinishedRun`.
        failed: time (s) at which it had failed, None where it stands.
        times: of the states (s).
        states: from the start to the end.
    """

    name: str
    soil: str
    grid: str
    failure_displacement: float
    least_volume: float | None
    units: dict[str, str] = field(repr=False)
    scene: Scene = field(repr=False)
    sample: FinishedRun = field(repr=False)
    failed: float | None = None
    times: tuple[float, ...] = field(default=(), repr=False)
    states: tuple[State, ...] = field(default=(), repr=False)

    @property
    def row(self) -> dict[str, Any]:
        """Numbers of the run, as a campaign has them."""
        return dict(self.sample.row)

    @property
    def stands(self) -> bool:
        """Whether it stands."""
        return self.failed is None and not self.row["broke_off"]


def slide(
    campaign: Campaign,
    sample: int | None = None,
    *,
    mean: bool = False,
    divide: float = 1.0,
    grid: str = "refined",
    frames: int = 40,
    progress: Callable[[float, float], None] = lambda seconds, displacement: None,
) -> Slide:
    """Run one soil of a scene: does it stand, how far does it go, and when.

    Args:
        campaign: from `cooperative.read`, or made in Python. Nothing in it needs to be random.
        sample: number of the sample whose soil it is; None for median soil.
        mean: take the means of all that is random instead.
        divide: strength by this number.
        grid: "rough" or "refined".
        frames: states that are kept, at most.
        progress: called with the time and the largest displacement (s, m) as the run goes on.

    Returns:
        The run.

    Raises:
        ValueError: the scene has no such sample, or a number is beyond its limit.
    """
    check.positive("divide", divide)
    check.whole("frames", frames, 2)
    campaign.check_sample(sample)
    if mean and sample is not None:
        raise ValueError(f"sample = {sample}: mean soil is that of no sample")
    soil = runs.random_soil(campaign)
    coefficients = np.zeros(soil.modes) if sample is None else runs.coefficients_of(campaign, soil)[sample]
    model = runs.build(campaign := _certain(campaign) if mean else campaign, grid, runs.random_soil(campaign))
    scene, state = model.of_sample(coefficients)
    scene = scene if divide == 1 else jaxmpm.reduced(scene, divide)
    model, run, start = replace(model, scene=scene, state=state), campaign.run, time.perf_counter()
    least, limit = campaign.failing_volume, run.failure_displacement
    past, kept, failed = ReleaseHistory.start(np.asarray(scene.particles.volume), limit), {0.0: state}, None

    def report_moment(_: int, seconds: float, midway: Midway) -> None:
        nonlocal past, failed
        moved = diagnostics.displacement(midway.state)
        past = past.after(seconds, moved)
        if failed is None and float(diagnostics.exceeded_displacement(scene, midway.state, least)) > limit:
            failed = seconds
        if seconds - max(kept) >= run.last(grid) / (frames - 1):
            kept[seconds] = jax.device_get(midway.state)
        progress(seconds, float(moved.max()))

    name, parameter = next(iter(declared(scene.material).items()))
    ((_, result),) = solve_each(
        scene, state, {name: [parameter.value]}, width=1, t_end=model.t_end, rules=campaign.rules(),
        hooks=Hooks(observe=report_moment),
    )  # fmt: skip
    kept[float(result.state.step) * float(result.time_step)] = result.state
    motion = past if grid in campaign.modes else None
    units = units_of_campaign(campaign)
    of = "mean soil" if mean else "median soil" if sample is None else f"soil of sample {sample}"
    return Slide(
        campaign.name, of if divide == 1 else f"{of}, its strength divided by {divide:g}",
        f"{grid} grid, cells of {campaign.grids[grid].cell:g} m", limit, least, units, scene,
        runs.finished_run(model, sample or 0, coefficients, result, time.perf_counter() - start, motion), failed,
        tuple(kept), tuple(kept.values()),
    )  # fmt: skip


Field = TypeVar("Field", bound=RandomField)


def _certain(campaign: Campaign) -> Campaign:
    """The campaign with the means of all that is random: its median soil then is its mean soil."""

    def certain(varies: Field) -> Field:
        return replace(varies, marginal=kl.Normal, cov=CERTAIN, lower=None, upper=None, boreholes=None)

    def all_certain(random: Mapping[str, RandomField]) -> dict[str, RandomField]:
        return {name: certain(varies) for name, varies in random.items()}

    site, rain, drawdown = campaign.site, campaign.rain, campaign.drawdown
    return replace(
        campaign, random=all_certain(campaign.random),
        ground=replace(site, layers=tuple(replace(layer, random=all_certain(layer.random)) for layer in site.layers)),
        rain=None if rain is None else rain.with_conductivities(lambda varies, _: certain(varies)),
        drawdown=None if drawdown is None else drawdown.with_conductivities(lambda varies, _: certain(varies)),
    )  # fmt: skip


def lines(run: Slide) -> Iterator[str]:
    """A run in words.

    Args:
        run: from `slide`.
    """
    row, unit = run.row, "m2" if run.scene.grid.dimension == 2 else "m3"
    yield f"{run.name}: {run.soil}, {run.grid}"
    if row["broke_off"]:
        moved = f"having moved {row['displacement']:.3g} m"
        yield f"  it broke off after {row['time']:.3g} s ({run.sample.status}), {moved}"
        return
    rest = "at rest" if run.sample.status == "SETTLED" else "not at rest yet"
    if run.failed is None:
        yield f"  it stands: no more than {row['displacement']:.2g} m of motion after {row['time']:.3g} s, {rest}"
        return
    what = "soil" if not run.least_volume else f"{run.least_volume:.3g} {unit} of soil"
    yield f"  it fails: {what} moved farther than {run.failure_displacement:g} m within {run.failed:.3g} s"
    yield f"  it slides {row['displacement']:.3g} m, {rest} after {row['time']:.3g} s"
    volume = f"{row['volume']:.3g} {run.units['volume'].replace('³', '3')}"
    mode = f", {row['mode']}" if "mode" in row else ""
    foremost = f" (foremost soil {row['runout_foremost']:.3g} m)" if row["runout_foremost"] > row["runout"] else ""
    yield f"  run-out {row['runout']:.3g} {run.units['runout']}{foremost}; volume {volume}{mode}"
    if row.get("walls"):
        yield f"  it reached {row['walls']}: draw the ground longer there"


def animation_path(folder: Path, path: Path | None = None) -> Path:
    """The file that an animation is written to.

    Args:
        folder: of the other files.
        path: name of an MP4 or a GIF; None for slide.mp4 in the folder where ffmpeg is there, else slide.gif.

    Raises:
        ValueError: another ending, a folder that is not there, or an MP4 where there is no ffmpeg.
    """
    from matplotlib.animation import FFMpegWriter  # loads what only animations need

    encodes = FFMpegWriter.isAvailable()
    path = folder / f"slide.{'mp4' if encodes else 'gif'}" if path is None else path
    if path.suffix not in WRITERS:
        raise ValueError(f"{path} is no name of an animation: give one that ends in {' or '.join(WRITERS)}")
    if path.parent != folder and not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}, make it or give another name")
    if path.suffix == ".mp4" and not encodes:
        raise ValueError(
            f"{path}: an MP4 is written by ffmpeg, which is not found: install it, or give {path.with_suffix('.gif')}"
        )
    return path


def write_slide(run: Slide, folder: Path, *, animation: Path | None = None, vtk: bool = False) -> Iterator[Path]:
    """Write what a run looks like: slide.png, profile.png, and slide.mp4 or slide.gif.

    Args:
        run: from `slide`.
        folder: to write to.
        animation: MP4 or GIF of the animation, None for one in the folder, see `animation_path`.
        vtk: whether slide.vtkhdf is written too, for ParaView.

    Yields:
        Path of each file.

    Raises:
        ValueError: the animation is neither, or there is no ffmpeg.
        OSError: the disk refuses, or ffmpeg does.
    """
    animation = animation_path(folder, animation)
    own_folder(folder)
    end = run.states[-1]
    yield save(jaxmpm.plot.state(run.scene, end), folder / "slide.png")
    yield save(profile(run), folder / "profile.png")
    moving = jaxmpm.plot.animate(run.scene, run.states, times=run.times, interval=MILLISECONDS)
    yield save_animation(moving, animation)
    if vtk:
        write_vtkhdf(folder / "slide.vtkhdf", run.scene, run.states, run.times)
        yield folder / "slide.vtkhdf"


def save_animation(moving: FuncAnimation, path: Path) -> Path:
    """Write an animation.

    Args:
        moving: of matplotlib.
        path: of the file, as of `animation_path`.

    Returns:
        The path.

    Raises:
        OSError: the disk refuses, or ffmpeg does.
    """
    try:
        moving.save(path, writer=WRITERS[path.suffix], dpi=DOTS)
    except CalledProcessError as error:
        raise OSError(errno.EIO, f"{path}: ffmpeg ends with status {error.returncode}, give a GIF") from error
    return path


def profile(run: Slide) -> Any:
    """The surface of the soil before and after, in 3D through the middle of the ground.

    Args:
        run: from `slide`.
    """
    grid, start = run.scene.grid, np.asarray(run.scene.particles.position, float)
    volume = np.asarray(run.scene.particles.volume, float)
    half = float(np.median(volume) ** (1 / grid.dimension)) / 2
    figure, (ax,) = panels(1, size=(9.0, 3.0))
    for label, style, state in (("before", "k--", run.states[0]), ("after", "C3-", run.states[-1])):
        position = start + np.asarray(state.displacement, float)
        if grid.dimension == 3:
            middle = (start[1].min() + start[1].max()) / 2
            position = position[:, np.abs(position[1] - middle) <= grid.cell / 2]
        column = np.floor(position[0] / grid.cell).astype(int)
        columns = np.unique(column)
        top = [position[-1, column == number].max() + half for number in columns]
        ax.plot((columns + 0.5) * grid.cell, top, style, label=label)
    ax.set(xlabel="x [m]", ylabel="z [m]", aspect="equal")
    ax.legend(frameon=False)
    return figure
