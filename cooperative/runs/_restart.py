"""What a run leaves while it is under way: frames and restart points.

A slide is drawn by its frames without being run again. A run that was killed goes on from its restart point, bit for
bit.

A restart point holds the state, the memory of the stopping rules, what the modes need of the past and the frames so
far. It lies in the campaign's folder, which a worker must see; where it does not, its runs start afresh.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from cooperative.measure import ReleaseHistory
from cooperative.store import restart_path
from jaxmpm import State, load_state, save_state
from jaxmpm.run import Midway
from jaxmpm.support import files
from jaxmpm.support.values import by_value

MEMORY = "memory."
"""Begins the names of the memories of stopping rules in a restart point."""
PAST = ("moved", "released", "around")
"""Arrays of a `ReleaseHistory` in a restart point."""
PASSED = (1.0, 5.0)
"""Multiples of the failure displacement. A frame is the state after the first chunk of steps that ends beyond one."""


@by_value
@dataclass(frozen=True)
class Frames:
    """A run at some of its times.

    Args:
        times: of T moments, ascending (s).
        displacement: at each of them (d, N) m.
    """

    times: tuple[float, ...] = ()
    displacement: tuple[np.ndarray, ...] = ()

    def due(self, farthest: float, failure_displacement: float) -> bool:
        """Whether soil that has moved so far (m) asks for the next frame.

        At most one is taken at a time.
        """
        return len(self.times) < len(PASSED) and farthest > PASSED[len(self.times)] * failure_displacement

    def after(self, time: float, displacement: ArrayLike) -> Self:
        """With one frame more; half precision resolves 10 m to 4 mm, which is enough for a picture."""
        return type(self)((*self.times, time), (*self.displacement, np.asarray(displacement).astype(np.float16)))

    def as_fields(self) -> dict[str, np.ndarray]:
        """As they are stored: `frames` (T, d, N) m and `frame_times` (T,) s, or nothing where there are none."""
        if not self.times:
            return {}
        return {"frames": np.stack(self.displacement), "frame_times": np.asarray(self.times)}

    @classmethod
    def of(cls, fields: Mapping[str, np.ndarray]) -> Self:
        """Those among the fields of a sample or a restart point, none where they have none."""
        if "frames" not in fields:
            return cls()
        return cls(tuple(fields["frame_times"].tolist()), tuple(fields["frames"]))


@dataclass(frozen=True)
class RestartPoint:
    """A run under way.

    Args:
        midway: state, and what the stopping rules remember.
        motion: past of the run, for its mode.
        frames: so far.
        seconds: of wall time that it has taken so far.
    """

    midway: Midway
    motion: ReleaseHistory
    frames: Frames
    seconds: float


def write_restart(folder: Path, grid: str, number: int, digest: str, point: RestartPoint) -> None:
    """Write the restart point of a sample in place of its last one, which stays if the disk refuses.

    Args:
        folder: of the campaign.
        grid: or SLIDES.
        number: of the sample.
        digest: of the scene.
        point: the run under way.

    Raises:
        OSError: the disk refuses.
    """
    path = restart_path(folder, grid, number)
    files.claimed_folder(path.parent)
    motion = point.motion
    about = {
        "scene": digest,
        "grid": grid,
        "sample": number,
        "seconds": point.seconds,
        **{f"{MEMORY}{name}": memory for name, memory in point.midway.memory.items()},
        "times": np.asarray(motion.times),
        **{name: np.asarray(getattr(motion, name)) for name in PAST},
        **point.frames.as_fields(),
    }
    save_state(path, point.midway.state, about=about)


def read_restart(
    folder: Path, grid: str, number: int, digest: str, *, like: State, start: ReleaseHistory
) -> RestartPoint | None:
    """The restart point of a sample, or None where there is none: the run starts afresh.

    One that is damaged, or of another scene or sample, is named in a warning and renamed to `*.damaged`.

    Args:
        folder: of the campaign.
        grid: or SLIDES.
        number: of the sample.
        digest: of the scene.
        like: a state of that grid.
        start: the motion of a run that has not begun.
    """
    path = restart_path(folder, grid, number)
    if not os.path.lexists(path):
        return None
    try:
        if path.parent.is_symlink():
            raise files.DamagedFile(f"{path} leads out of the campaign's folder")
        state, about = load_state(path, like)
        of_run = (about.get("scene"), about.get("grid"), about.get("sample")) == (digest, grid, number)
        if not of_run or not {"times", *PAST} <= about.keys():
            raise files.DamagedFile(f"{path} is of another scene or sample")
    except ValueError as error:
        warnings.warn(f"{error}: set aside, the run starts afresh", stacklevel=2)
        files.set_aside(path)
        return None
    memory = {name.removeprefix(MEMORY): values for name, values in about.items() if name.startswith(MEMORY)}
    motion = replace(start, times=tuple(about["times"].tolist()), **{name: about[name] for name in PAST})
    return RestartPoint(Midway(state, memory), motion, Frames.of(about), about["seconds"])
