"""Restart points of long runs: a run that is killed goes on from its last one, bit for bit.

A restart point holds the state, what the settle watch remembers, what the modes need of the past and the frames so far.
It lies in the campaign's folder, which a worker must see; where it does not, its runs start afresh.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cooperative.measure import Motion
from cooperative.runs._frames import Frames
from cooperative.store import check_frames, restart_path
from foundation import files
from jaxmpm import Midway, State, load_state, save_state


@dataclass(frozen=True)
class RestartPoint:
    """A run under way. seconds: of wall time that it has taken so far."""

    midway: Midway
    motion: Motion
    frames: Frames
    seconds: float


def write_restart(folder: Path, grid: str, number: int, digest: str, point: RestartPoint) -> None:
    """Write the restart point of a sample, in place of its last one. digest: of the scene. OSError if the disk
    refuses; the last one then stays."""
    path = restart_path(folder, grid, number)
    files.claimed_folder(path.parent)
    motion = point.motion
    about = {
        "scene": digest,
        "grid": grid,
        "sample": number,
        "seconds": point.seconds,
        "quiet": point.midway.quiet,
        "reference": point.midway.reference,
        "times": np.asarray(motion.times),
        "moved": motion.moved,
        "onset": motion.onset,
        "seen": motion.seen,
        "travel": np.concatenate([np.zeros(0), *motion.travel]),
        **point.frames.as_fields(),
    }
    save_state(path, point.midway.state, about=about)


def read_restart(
    folder: Path, grid: str, number: int, digest: str, *, like: State, start: Motion
) -> RestartPoint | None:
    """The restart point of a sample, or None where there is none: the run starts afresh.

    like: a state of that grid. start: the motion of a run that has not begun. One that is damaged, or of another scene
    or sample, is named in a warning and renamed to `*.damaged`.
    """
    path = restart_path(folder, grid, number)
    if not os.path.lexists(path):
        return None
    try:
        if path.parent.is_symlink():
            raise files.DamagedFile(f"{path} leads out of the campaign's folder")
        state, about = load_state(path, like)
        if (about.get("scene"), about.get("grid"), about.get("sample")) != (digest, grid, number):
            raise files.DamagedFile(f"{path} is of another scene or sample")
        return _restored(path, state, about, start)
    except ValueError as error:
        warnings.warn(f"{error}: set aside, the run starts afresh", stacklevel=2)
        files.set_aside(path)
        return None


def _restored(path: Path, state: State, about: dict[str, Any], start: Motion) -> RestartPoint:
    """The run as it was; DamagedFile where a part of it is missing or of another type or shape."""
    particles = start.volume.shape
    for name, shape in (("seconds", ()), ("quiet", ()), ("reference", ()), ("times", (-1,)), ("moved", particles),
                        ("onset", particles), ("seen", particles), ("travel", (-1,))):  # fmt: skip
        found = np.asarray(about.get(name))
        if found.dtype.kind not in "biuf" or (found.ndim != 1 if shape == (-1,) else found.shape != shape):
            raise files.DamagedFile(f"{path} holds {name} as {found.dtype} of shape {found.shape}")
    snapshots = len(about["times"])
    if snapshots < 1 or len(about["travel"]) != sum(range(2, snapshots + 1)):
        raise files.DamagedFile(f"{path} holds {len(about['travel'])} numbers of travel for {snapshots} snapshots")
    check_frames(path, about, state.displacement.shape)
    # Snapshot k has one travel for each snapshot up to it.
    ends = np.cumsum(np.arange(2, len(about["times"]) + 1))
    motion = Motion(
        start.volume,
        start.failure_displacement,
        tuple(about["times"].tolist()),
        about["moved"],
        about["onset"],
        about["seen"],
        tuple(np.split(about["travel"], ends)[: len(ends)]),
    )
    midway = Midway(state, about["quiet"], about["reference"])
    return RestartPoint(midway, motion, Frames.of(about), about["seconds"])
