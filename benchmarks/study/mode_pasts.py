"""Slides whose mode rules name, and of the first of them readers: calibrated rough ones of the study, run again and
looked at often.

benchmarks/data/mode_pasts.npz holds what a rule reads of each: when soil lets go, and how deep slices across the slope
slide. `python -m benchmarks.study.mode_readings` runs the slides that the file lacks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.study.cases import CASES, FAILS_ABOVE, campaign_of
from benchmarks.study.draw import Slide
from benchmarks.study.rows import DATA, Run, read_table
from cooperative import build, coefficients_of, random_soil
from cooperative.measure import ReleaseHistory, failure_mode
from jaxmpm import Face, reduced, solve

STORED = DATA / "mode_pasts.npz"
CASE = "lx = ly = 60"
EVERY = 0.25
"""Seconds between looks at a run."""

LOOKS = (1.0, 2.0, 4.0, 7.0, 11.0)
"""Seconds after the first release at which a slide is drawn; its end follows."""


@dataclass(frozen=True)
class Past:
    """What the mode of a slide depends on.

    Attributes:
        released: (k,) share of the sliding volume that let go in each EVERY seconds.
        depth: (n,) sliding depth below the crest of each slice across the slope (m), 0 where nothing slides.
        share: (n,) of the sliding volume in each slice.
        height: of the slope (m).
        mode: by its depths alone: compound, deep or shallow.
    """

    released: np.ndarray
    depth: np.ndarray
    share: np.ndarray
    height: float
    mode: str


@dataclass(frozen=True)
class Watched:
    """A slide that was run again.

    Attributes:
        slide: its displacements at LOOKS and at its end.
        onset: when each particle let go (N,) s, inf if it has not.
        face: of the slope.
        past: what its mode depends on.
    """

    slide: Slide
    onset: np.ndarray
    face: Face
    past: Past


def slides() -> list[Run]:
    """The slides, by sample."""
    rows = read_table(DATA / "study_sweep_slides.csv")
    return sorted((run for run in rows if run.case == CASE and run.grid == "rough"), key=lambda run: run.sample)


def looks(times: np.ndarray, first: float) -> np.ndarray:
    """Numbers of the times (s), ascending, nearest to LOOKS after the first release (s), and of the last."""
    look_times = [time for time in first + np.array(LOOKS) if time < times[-1]]
    return np.unique([*(int(np.abs(times - time).argmin()) for time in look_times), times.size - 1])


def watch(run: Run) -> Watched:
    """Run a slide of the study to its end and look at it every EVERY seconds.

    Raises:
        FloatingPointError: the run breaks off.
    """
    campaign = campaign_of(**CASES[run.case])
    soil = random_soil(campaign)
    model, coefficients = build(campaign, run.grid, soil), coefficients_of(campaign, soil)[run.sample]
    scene, state = model.of_sample(coefficients)
    times = np.arange(EVERY, campaign.run.t_end + EVERY / 2, EVERY)
    result = solve(
        reduced(scene, run.reduction), state, t_end=campaign.run.t_end, snapshots=times.tolist()
    ).raise_if_failed()
    position, volume = (np.asarray(array, float) for array in (scene.particles.position, scene.particles.volume))
    motion = ReleaseHistory.start(volume, FAILS_ABOVE)
    for at, seen in zip(result.times, result.snapshots, strict=True):
        motion = motion.after(at, np.linalg.norm(np.asarray(seen.displacement), axis=0))
    face = campaign.site.shape.face
    assert face is not None
    displacement = np.asarray(result.state.displacement, float)
    mode = failure_mode(position, displacement, volume, face, half_size=model.half_size)
    sliding = np.linalg.norm(displacement, axis=0) >= FAILS_ABOVE
    y, edges = position[1], np.linspace(0.0, 1.0, mode.depth.size + 1)
    low, high = y.min() - model.half_size[1], y.max() + model.half_size[1]
    share, _ = np.histogram(y[sliding], bins=low + edges * (high - low), weights=volume[sliding])
    released, _ = np.histogram(motion.onset[sliding], bins=[0.0, *times], weights=volume[sliding])
    total = volume[sliding].sum()
    shown = looks(times, float(motion.onset.min()))
    slide = Slide(
        position,
        np.asarray(model.half_size),
        np.asarray(model.strength(coefficients)),
        tuple(times[shown].tolist()),
        np.stack([np.asarray(result.snapshots[number].displacement) for number in shown]),
        campaign.grids[run.grid].cell,
    )
    past = Past(released / total, mode.depth, share / total, face.height, mode.name)
    return Watched(slide, motion.onset, face, past)


def stored() -> dict[int, Past]:
    """Pasts by sample, of benchmarks/data."""
    if not STORED.is_file():
        return {}
    with np.load(STORED) as file:
        parts = [file[name] for name in ("sample", "released", "depth", "share", "height", "mode")]
    return {int(n): Past(r, d, s, float(h), str(m)) for n, r, d, s, h, m in zip(*parts, strict=True)}


def keep(pasts: dict[int, Past]) -> None:
    """Write pasts by sample."""
    values = list(pasts.values())
    np.savez_compressed(
        STORED,
        sample=np.array(list(pasts)),
        released=np.stack([past.released for past in values]).astype(np.float32),
        depth=np.stack([past.depth for past in values]).astype(np.float32),
        share=np.stack([past.share for past in values]).astype(np.float32),
        height=np.array([past.height for past in values]),
        mode=np.array([past.mode for past in values]),
    )
