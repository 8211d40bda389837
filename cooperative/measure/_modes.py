"""Failure modes: shallow, deep, compound and progressive, from depths across the slope and times of release.

The four modes are those of Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413, who distinguish
them by eye. The rules here need no eye. Where several hold, the gravest name wins: progressive, compound, deep,
shallow.

    shallow       no mass slides deeper below the crest than the slope is high: it passes above the toe
    deep          all masses slide deeper
    compound      masses of both kinds at different positions along the slope
    progressive   soil lets go in two pulses, with a valley in the rate between them

Of the rules that were tried, this one of progressive failure agrees best with readers who know the four definitions
alone (`python -m benchmarks mode_readings`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cooperative.measure._consequences import checked, largest_per_slice, overlapped_slices
from cooperative.measure._onsets import ReleaseHistory, releases
from jaxmpm import Face
from jaxmpm.support.values import by_value

SEVERITY = ("progressive", "compound", "deep", "shallow")


@dataclass(frozen=True)
class ModeRules:
    """Limits of the rules.

    Args:
        failure_displacement: displacement from which soil counts as sliding, and as released (m).
        slice_width: width of the slices across the slope (m).
        separation: two masses side by side are two if the depth between them is less than that of the lesser by this
            share of the slope height.
        smallest_share: share of the sliding volume below which a mass does not count.
        window: time over which the rate at which soil lets go is averaged (s).
        valley: between two pulses this rate falls to at most this share of the lesser peak.
    """

    failure_displacement: float = 1.0
    slice_width: float = 2.0
    separation: float = 0.2
    smallest_share: float = 0.05
    window: float = 1.0
    valley: float = 0.5


@by_value
@dataclass(frozen=True)
class FailureMode:
    """Failure mode of one final state.

    Args:
        name: one of SEVERITY, or "none" if nothing slides.
        depth: sliding depth below the crest of each slice along the slope (slices,) m, 0 where nothing slides; one
            slice in a section.
        masses: the depth of each mass (m).
        released: when the first and, if progressive, the second mass began to let go (s).
        notes: in words.
    """

    name: str
    depth: np.ndarray
    masses: tuple[float, ...]
    released: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()


def failure_mode(
    position: np.ndarray,
    displacement: np.ndarray,
    volume: np.ndarray,
    geometry: Face,
    *,
    half_size: np.ndarray,
    motion: ReleaseHistory | None = None,
    rules: ModeRules | None = None,
) -> FailureMode:
    """Mode of one final state.

    Args:
        position: (d, N) m, rows (x, y, z) or, in a section, (x, z).
        displacement: (d, N) m, rows (x, y, z) or, in a section, (x, z).
        volume: (N,).
        geometry: face of the slope.
        half_size: half the initial particle spacing (d,) m.
        motion: the run's past; without it progressive failure cannot be recognised, which a note states.
        rules: limits of the rules, None for the defaults.

    Raises:
        ValueError: shapes that do not fit, or a past with another failure displacement than that of the rules.
    """
    rules = rules or ModeRules()
    position, displacement, volume, half_size = checked(position, displacement, volume, half_size)
    if motion is not None and motion.volume.shape != volume.shape:
        raise ValueError(f"motion is of {motion.volume.size} particles: give that of the run's {volume.size}")
    if motion is not None and motion.failure_displacement != rules.failure_displacement:
        its, limit = motion.failure_displacement, rules.failure_displacement
        raise ValueError(f"motion has the failure displacement {its:g} m: start it with the rules' {limit:g} m")
    sliding = np.linalg.norm(displacement, axis=0) >= rules.failure_displacement
    depth, share = depth_profile(position, sliding, volume, geometry, half_size=half_size, rules=rules)
    if not sliding.any():
        return FailureMode("none", depth, ())
    masses = separate_masses(depth, share, geometry.height, rules)
    released: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    if motion is None:
        notes = ("no displacement history: progressive failure cannot be recognised",)
    else:
        released = releases(
            motion, sliding, smallest_share=rules.smallest_share, window=rules.window, valley=rules.valley
        )
    return FailureMode(name_mode(masses, geometry.height, len(released) > 1), depth, masses, released, notes)


def name_mode(masses: tuple[float, ...], slope_height: float, progressive: bool) -> str:
    """Name from the depths of the masses (m): the precedence of the rules, nothing else."""
    deep = [depth > slope_height for depth in masses]
    if progressive:
        return "progressive"
    if any(deep):
        return "deep" if all(deep) else "compound"
    return "shallow"


def depth_profile(
    position: np.ndarray,
    sliding: np.ndarray,
    volume: np.ndarray,
    geometry: Face,
    *,
    half_size: np.ndarray,
    rules: ModeRules,
) -> tuple[np.ndarray, np.ndarray]:
    """Sliding depth below the crest (m) and share of the sliding volume of each slice along the slope, (slices,) each.

    The slices divide the slope evenly from end to end, so that moving or mirroring it changes nothing.
    """
    below = geometry.crest_z - (position[-1, sliding] - half_size[-1])
    if len(position) == 2:
        return np.array([below.max(initial=0.0)]), np.ones(1)
    y, half = position[1], float(half_size[1])
    low, high = float(y.min() - half), float(y.max() + half)
    slices = max(round((high - low) / rules.slice_width), 1)
    if not sliding.any():
        return np.zeros(slices), np.zeros(slices)
    y, width = y[sliding], (high - low) / slices
    first, last = overlapped_slices(y, half, origin=low, slice_width=width, slices=slices)
    share = np.zeros(slices)
    for step in range(int((last - first).max()) + 1):
        at = first + step
        edge = low + at * width
        overlap = np.minimum(y + half, edge + width) - np.maximum(y - half, edge)
        np.add.at(share, np.minimum(at, last), volume[sliding] * np.maximum(overlap, 0.0))
    return largest_per_slice(first, last, below, slices), share / share.sum()


def separate_masses(depth: np.ndarray, share: np.ndarray, slope_height: float, rules: ModeRules) -> tuple[float, ...]:
    """Depths (m) of the masses side by side: peaks of the depth profile that stand out from what lies between them.

    Args:
        depth: (slices,), from `depth_profile`. The flank of a deep slide gets shallower and is no mass of its own.
        share: (slices,), from `depth_profile`. The flank of a deep slide gets shallower and is no mass of its own.
        slope_height: from toe to crest (m).
        rules: limits of the rules.
    """
    from scipy.signal import find_peaks  # takes a tenth of a second, which no campaign without slides needs

    padded = np.concatenate([[0.0], depth, [0.0]])
    peaks = find_peaks(padded, prominence=rules.separation * slope_height)[0] - 1
    if peaks.size == 0:
        return (float(depth.max()),)
    saddles = [a + int(np.argmin(depth[a:b])) for a, b in pairwise(peaks)]
    edges = [0, *saddles, depth.size]
    large = [
        float(depth[peak])
        for peak, a, b in zip(peaks, edges[:-1], edges[1:], strict=True)
        if share[a:b].sum() >= rules.smallest_share
    ]
    return tuple(large) or (float(depth.max()),)
