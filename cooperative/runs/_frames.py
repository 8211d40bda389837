"""A slide at a few of its moments, kept while it runs: it can then be drawn without being run again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

PASSED = (1.0, 5.0)
"""Multiples of the failure displacement. A frame is the state after the first chunk of steps that ends beyond one."""


@dataclass(frozen=True)
class Frames:
    """A run at some of its times. times: of T moments, ascending (s). displacement: at each of them (d, N) m."""

    times: tuple[float, ...] = ()
    displacement: tuple[np.ndarray, ...] = ()

    def due(self, farthest: float, failure_displacement: float) -> bool:
        """Whether soil that has moved so far (m) asks for the next frame. At most one is taken at a time."""
        return len(self.times) < len(PASSED) and farthest > PASSED[len(self.times)] * failure_displacement

    def after(self, time: float, displacement: ArrayLike) -> Self:
        """With one frame more; half precision tells 10 m to 4 mm, which is enough for a picture."""
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
