"""How each sample of a campaign runs: its loads, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypedDict

import numpy as np

from cooperative.scene import tables
from cooperative.scene.tables import LimitLoad
from jaxmpm import BaseMotion, Settle
from jaxmpm.run import Early
from jaxmpm.support.text import shown

AT_REST = Settle(slides=1.0)
"""Stands for a slide's rest, from the failure displacement on."""


class Loads(TypedDict):
    """What loads the ground, as `jaxmpm.ground.build_ground` takes it."""

    gravity: float
    k_h: float | None
    k_v: float | None
    motion: BaseMotion | None


@dataclass(frozen=True)
class Run:
    """How each sample runs.

    Args:
        gravity: m/s2.
        k_h: pseudo-static horizontal acceleration over gravity, see `jaxmpm.section`; the initial stress holds it.
        k_v: pseudo-static vertical acceleration over gravity, upwards, likewise.
        motion: of the base, from the stress at rest on; None for none.
        strength_factor: on all strength, as strength reduction by its inverse.
        t_end: up to when it runs (s).
        slides_t_end: up to when slides of the refined grid go on (s), None up to t_end.
        failure: what is failure, a displacement that is given or that at the limit load of the median soil.
        failure_displacement: from which soil counts as sliding (m).
        least_volume: of soil that moves so far where a slope fails (m3, in a section m2), 0 for any particle, None by
            the size of the slope, see `Campaign.failing_volume`.
        settle: when a lane has settled, None for never; unless given, a slide, which exceeds the failure displacement,
            once its deposit rests.
        early: whether a run of which only the class is asked for ends by `jaxmpm.run.Early`; None where that holds.
    """

    gravity: float = 9.81
    t_end: float = 20.0
    slides_t_end: float | None = None
    failure: Literal["displacement", "limit load"] = "displacement"
    failure_displacement: float = 1.0
    least_volume: float | None = None
    settle: Settle | None = AT_REST
    k_h: float = 0.0
    k_v: float = 0.0
    motion: BaseMotion | None = None
    strength_factor: float = 1.0
    early: bool | None = None

    def __post_init__(self) -> None:
        if self.settle is AT_REST:
            object.__setattr__(self, "settle", Settle(slides=self.failure_displacement))

    @property
    def loads(self) -> Loads:
        """What loads the ground, as `jaxmpm.ground.build_ground` takes it; None for what is absent."""
        return Loads(gravity=self.gravity, k_h=self.k_h or None, k_v=self.k_v or None, motion=self.motion)

    def last(self, grid: str) -> float:
        """Time (s) at which a run of a grid ends at the latest."""
        return self.slides_t_end if grid == "refined" and self.slides_t_end is not None else self.t_end

    def settles(self, stop_at: float | None, softens: bool) -> Settle | None:
        """When a run has settled, by `early` too where that holds; None for never.

        Args:
            stop_at: displacement (m) that decides the class, None where more than the class is asked for.
            softens: whether all soil does, linearly.
        """
        if self.settle is None or stop_at is None or self.early is False or self._never_early(softens):
            return self.settle
        return replace(self.settle, early=Early(self.t_end))

    def _never_early(self, softens: bool) -> str | None:
        """Why `early` does not hold, None where it does."""
        if self.settle is None:
            return "settle is off"
        return "the base moves" if self.motion is not None else None if softens else "not all soil softens linearly"

    def check(self, dimension: int, softens: bool) -> None:
        """Check what goes together.

        Args:
            dimension: number of the ground's axes.
            softens: whether all soil does, linearly.

        Raises:
            ValueError: slides that end before other runs, a rule that does not hold, or a motion of other axes or
                beyond the end of the run.
        """
        if self.early and (why := self._never_early(softens)):
            raise ValueError(
                f"early = true, and {why}: its rule holds for slopes that settle unshaken, of soil with "
                "softening_modulus: leave it out"
            )
        if self.slides_t_end is not None and self.slides_t_end < self.t_end:
            raise ValueError(
                f"slides_t_end = {self.slides_t_end:g} s is before t_end = {self.t_end:g} s, up to which all runs go: "
                "give at least that, or leave it out"
            )
        if self.motion is None:
            return
        axes, duration = np.shape(self.motion.acceleration)[0], float(self.motion.duration)
        if axes != dimension:
            raise ValueError(f"motion has {axes} axes, the ground {dimension}: give an acceleration along each")
        if duration > self.t_end * (1 + 1e-6):
            raise ValueError(
                f"the motion of the base lasts {duration:g} s, beyond t_end = {self.t_end:g} s at which runs end: give "
                f"t_end = {duration:g} or more, or cut the record"
            )

    def failing_at(self, limit_load: LimitLoad) -> Run:
        """The run of samples that fail from the displacement of a limit load.

        Args:
            limit_load: as measured.
        """
        settle = self.settle
        if settle is not None and settle.slides is not None:
            settle = replace(settle, slides=limit_load.displacement)
        return replace(
            self, failure_displacement=limit_load.displacement, least_volume=limit_load.volume or 0.0, settle=settle
        )


def check_limit_load(run: tables.Run, given: LimitLoad | None) -> None:
    """Check a limit load, asked for or given.

    Args:
        run: table of the scene.
        given: by the scene, None where not.

    Raises:
        ValueError: it does not go with the table [run].
    """
    asked = run.failure == "limit load"
    if asked and "failure_displacement" in run.model_fields_set:
        raise ValueError(
            "[run] failure_displacement has no effect beside failure = 'limit load', which finds it: leave it out"
        )
    if asked and run.least_volume == 0:
        raise ValueError(
            "[run] least_volume = 0 beside failure = 'limit load': any particle moves below the limit load, give more "
            "or leave it out"
        )
    if given is None:
        return
    if not asked:
        raise ValueError("the scene has a table [limit_load] without [run] failure = 'limit load': leave it out")
    if run.least_volume not in (None, given.volume):
        raise ValueError(
            f"[run] least_volume = {run.least_volume:g} and [limit_load] volume = {shown(given.volume)} differ: the "
            "displacement belongs to one volume, give that one in both"
        )


def run_of(table: tables.Run, motion: BaseMotion | None) -> Run:
    """How the samples of a scene run.

    A slide ends when its deposit rests, where runs end once they have settled, unless `rest` is false.

    Args:
        table: of the scene.
        motion: of the base, None for none.
    """
    values = dict(table)
    settle, rest = values.pop("settle"), values.pop("rest")
    slides = None if rest is False else table.failure_displacement
    return Run(**values, motion=motion, settle=Settle(slides=slides) if settle else None)
