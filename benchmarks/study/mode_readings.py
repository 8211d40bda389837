"""Shares of failure modes of the same slides under each reading of the four printed definitions.

The paper distinguishes modes by eye and prints no rule. `python -m benchmarks.study.mode_readings` runs calibrated
rough slides that benchmarks/data/mode_pasts.npz lacks. It keeps what modes depend on: when soil lets go, and how deep
slices across the slope slide. `python -m benchmarks mode_readings` names the modes by each reading.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.measure import Report
from benchmarks.study.cases import CASES, FAILS_ABOVE, campaign_of
from benchmarks.study.modes import POOLED
from benchmarks.study.rows import DATA, Run, read_table
from cooperative import build, coefficients_of, random_soil
from cooperative.estimate import wilson_interval
from cooperative.measure import SEVERITY, ModeRules, Motion, failure_mode
from jaxmpm import reduced, solve

KEPT = DATA / "mode_pasts.npz"
CASE = "lx = ly = 60"
SLIDES = 20
EVERY = 0.25
"""Seconds between looks at a run."""

LEAST = ModeRules().smallest_share
"""Share of the sliding volume below which a pulse is none."""


@dataclass(frozen=True)
class Past:
    """What the mode of a slide depends on.

    Attributes:
        released: (k,) share of the sliding volume that let go in each EVERY seconds.
        depth: (n,) sliding depth below the crest of each slice across the slope (m), 0 where nothing slides.
        share: (n,) of the sliding volume in each slice.
        height: of the slope (m).
        mode: by the default rule.
    """

    released: np.ndarray
    depth: np.ndarray
    share: np.ndarray
    height: float
    mode: str


def pulses(past: Past, valley: float) -> bool:
    """Whether soil lets go in two pulses, between which the rate falls to this share of the lesser peak.

    The rate is averaged over one second. Each pulse has at least LEAST of the volume.
    """
    rate = uniform_filter1d(np.asarray(past.released, float), round(1 / EVERY), mode="constant")
    before, after = np.cumsum(past.released), np.cumsum(past.released[::-1])[::-1]
    first, second = np.maximum.accumulate(rate), np.maximum.accumulate(rate[::-1])[::-1]
    parts = (before >= LEAST) & (after >= LEAST)
    return bool(np.any(parts & (rate <= valley * np.minimum(first, second))))


def lull(past: Past, share: float) -> bool:
    """Whether less than this share of the volume lets go in a second, with at least LEAST of it before and after."""
    seconds = round(1 / EVERY)
    total = np.concatenate([[0.0], np.cumsum(past.released)])
    before, until = total[:-seconds], total[seconds:]
    return bool(np.any((before >= LEAST) & (total[-1] - until >= LEAST) & (until - before < share)))


def adjoining(past: Past, least: float) -> bool:
    """Whether slices deeper than the slope is high and shallower ones each have this share of the volume."""
    deep = float(past.share[past.depth > past.height].sum())
    return min(deep, 1 - deep) >= least


def named(past: Past, progressive: Callable[[Past], bool] | None, compound: Callable[[Past], bool] | None) -> str:
    """Mode by the precedence of the default rule, whose own answer stands where a reading is None."""
    if past.mode == "progressive" if progressive is None else progressive(past):
        return "progressive"
    if past.mode == "compound" if compound is None else compound(past):
        return "compound"
    return "deep" if float(past.depth.max()) > past.height else "shallow"


Reading = tuple[Callable[[Past], bool] | None, Callable[[Past], bool] | None]
READINGS: dict[str, Reading] = {
    "default": (None, None),
    **{
        f"two pulses, valley below {part:.2g} of the lesser": (partial(pulses, valley=part), None)
        for part in (1 / 2, 1 / 3, 1 / 5)
    },
    **{f"a second with less than {part:.0%}": (partial(lull, share=part), None) for part in (0.02, 0.05, 0.1)},
    **{
        f"deep and shallow slices, {part:.0%} each": (None, partial(adjoining, least=part)) for part in (0.05, 0.1, 0.2)
    },
}


def past_of(run: Run) -> Past:
    """Run a slide of the study to its end and look at it every EVERY seconds."""
    campaign = campaign_of(**CASES[run.case])
    soil = random_soil(campaign)
    model = build(campaign, run.grid, soil)
    scene, state = model.of_sample(coefficients_of(campaign, soil)[run.sample])
    times = np.arange(EVERY, campaign.run.t_end + EVERY / 2, EVERY).tolist()
    result = solve(reduced(scene, run.reduction), state, t_end=campaign.run.t_end, snapshots=times).raise_if_failed()
    position, volume = (np.asarray(each, float) for each in (scene.particles.position, scene.particles.volume))
    motion = Motion.start(volume, FAILS_ABOVE)
    for at, seen in zip(result.times, result.snapshots, strict=True):
        motion = motion.after(at, np.linalg.norm(np.asarray(seen.displacement), axis=0))
    face = campaign.site.shape.face
    assert face is not None
    displacement = np.asarray(result.state.displacement, float)
    mode = failure_mode(position, displacement, volume, face, half_size=model.half_size, motion=motion)
    sliding = np.linalg.norm(displacement, axis=0) >= FAILS_ABOVE
    y, edges = position[1], np.linspace(0.0, 1.0, mode.depth.size + 1)
    low, high = y.min() - model.half_size[1], y.max() + model.half_size[1]
    share, _ = np.histogram(y[sliding], bins=low + edges * (high - low), weights=volume[sliding])
    released, _ = np.histogram(motion.onset[sliding], bins=[0.0, *times], weights=volume[sliding])
    total = volume[sliding].sum()
    return Past(released / total, mode.depth, share / total, face.height, mode.name)


def kept() -> dict[int, Past]:
    """Pasts by sample, of benchmarks/data."""
    if not KEPT.is_file():
        return {}
    with np.load(KEPT) as stored:
        parts = [stored[name] for name in ("sample", "released", "depth", "share", "height", "mode")]
    return {int(n): Past(r, d, s, float(h), str(m)) for n, r, d, s, h, m in zip(*parts, strict=True)}


def keep(pasts: dict[int, Past]) -> None:
    """Write pasts by sample."""
    each = list(pasts.values())
    np.savez_compressed(
        KEPT,
        sample=np.array(list(pasts)),
        released=np.stack([past.released for past in each]).astype(np.float32),
        depth=np.stack([past.depth for past in each]).astype(np.float32),
        share=np.stack([past.share for past in each]).astype(np.float32),
        height=np.array([past.height for past in each]),
        mode=np.array([past.mode for past in each]),
    )


def shares(pasts: list[Past], reading: Reading) -> dict[str, float]:
    """Share of each mode by a reading."""
    names = Counter(named(past, *reading) for past in pasts)
    return {mode: round(names[mode] / len(pasts), 3) for mode in SEVERITY}


def run(quick: bool) -> Report:
    """Shares by each reading, beside the printed ones; `quick` makes no difference."""
    pasts = list(kept().values())
    table = {name: shares(pasts, reading) for name, reading in READINGS.items()}
    values: dict[str, float | str] = {"slides": len(pasts)}
    for mode in SEVERITY:
        each = [row[mode] for row in table.values()]
        values |= {f"{mode}_least": min(each), f"{mode}_most": max(each)}
        values |= {f"{mode}_printed": round(POOLED[mode] / sum(POOLED.values()), 3)}
        values |= {f"{mode}_verdict": verdict(min(each), max(each), len(pasts))}
    return Report(values, [{"reading": name, **row} for name, row in table.items()])


def verdict(least: float, most: float, slides: int) -> str:
    """Whether a mode's share depends on the reading, from its least and most share of so many slides."""
    if least == most:
        return "the same by each reading"
    apart = wilson_interval(least * slides, slides)[1] < wilson_interval(most * slides, slides)[0]
    return "depends on a rule that is not printed" if apart else "too few slides to decide"


def main() -> None:
    """Run the slides that the kept file lacks."""
    rows = read_table(DATA / "study_sweep_slides.csv")
    slides = sorted((run for run in rows if run.case == CASE and run.grid == "rough"), key=lambda run: run.sample)
    pasts = kept()
    for slide in slides[:SLIDES]:
        if slide.sample not in pasts:
            pasts[slide.sample] = past_of(slide)
            keep(pasts)
            print(slide.sample, pasts[slide.sample].mode, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
