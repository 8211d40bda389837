"""From cone resistance to parameters of soil, and to layers by soil behaviour type.

Sources: q_t and s_u: Lunne, Robertson and Powell (1997), Cone Penetration Testing in Geotechnical Practice, Sections
5.4 and 5.6; friction angle of sand: Kulhawy and Mayne (1990), Manual on Estimating Soil Properties for Foundation
Design, EPRI EL-6800, Eq. 4-12; soil behaviour type: Robertson (2009), doi:10.1139/T09-065, and, without pore pressures
and weights, Robertson (2010), 2nd International Symposium on Cone Penetration Testing, paper 2-56.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from cooperative.laboratory import Values
from cooperative.tools.soundings._sounding import Sounding
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

ATMOSPHERE = 1e5
"""Pa."""
TYPES = ("sand", "silty sand", "clay", "peat")
"""Soil behaviour types from the smallest index up: zones 6 and 7, 5, 3 and 4, and 2 of Robertson."""
LIMITS = (2.05, 2.6, 3.6)
"""Index I_c between them."""
THINNEST, STEP = 1.5, 0.25
"""Thickness (m) below which a proposed layer goes to its neighbour, and of the intervals that it is made of."""
TRANSITION = 0.5
"""Distance (m) over which a cone feels the next layer, some ten of its diameters."""
FEWEST = 8
"""Readings from which a layer is estimated."""
STRENGTH = "s_u = (q_t - sigma_v0) / N_kt (Lunne, Robertson and Powell 1997)"
FRICTION = "phi = 17.6 + 11 log10((q_t / p_a) / sqrt(sigma'_v0 / p_a)) (Kulhawy and Mayne 1990, EPRI EL-6800)"


@dataclass(frozen=True)
class Stresses:
    """What the interpretation of a sounding takes the ground to weigh.

    Args:
        unit_weight: of the soil with its water (N/m3).
        water: depth of the water table below the surface (m), where the sounding has none.
    """

    unit_weight: float = 18e3
    water: float = 1.0

    def of(self, sounding: Sounding) -> tuple[Values, Values]:
        """Total and effective vertical stress (n,) Pa at the readings, of still water.

        Args:
            sounding: whose readings.
        """
        table = self.water_of(sounding)
        total = self.unit_weight * sounding.depth
        return total, total - WATER_WEIGHT * np.maximum(sounding.depth - table, 0)

    def water_of(self, sounding: Sounding) -> float:
        """Depth (m) of the water table below the surface at a sounding, its own where its file has one.

        Args:
            sounding: whose.
        """
        return self.water if sounding.water is None else sounding.water


def corrected_cone(sounding: Sounding) -> Values:
    """Cone resistance q_t (n,) Pa: q_c + (1 - a) u_2 with the net area ratio a.

    It is what the file has as q_t, else q_c where it has no area ratio, or no pore pressure at all: in sand they differ
    little, in soft clay q_c is too small. A gap in u_2 alone is one in q_t.

    Args:
        sounding: whose readings.
    """
    if sounding.corrected is not None:
        return sounding.corrected
    if sounding.area_ratio is None or not np.isfinite(sounding.pore).any():
        return sounding.cone
    return sounding.cone + (1 - sounding.area_ratio) * sounding.pore


def strength_of(sounding: Sounding, stresses: Stresses, n_kt: float) -> Values:
    """Undrained shear strength (n,) Pa, nan in gaps and where it is not above 0.

    Args:
        sounding: whose readings.
        stresses: of the ground.
        n_kt: cone factor.

    Raises:
        ValueError: a cone factor that no clay has.
    """
    if not 5 <= n_kt <= 40:
        raise ValueError(f"N_kt = {n_kt:g}: clays have 8 to 25, give one of 5 to 40")
    value = (corrected_cone(sounding) - stresses.of(sounding)[0]) / n_kt
    return np.where(value > 0, value, np.nan)


def friction_of(sounding: Sounding, stresses: Stresses) -> Values:
    """Peak angle of friction (n,) degrees of sand, nan in gaps and above the water-free surface.

    Args:
        sounding: whose readings.
        stresses: of the ground.
    """
    effective = stresses.of(sounding)[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = corrected_cone(sounding) / ATMOSPHERE / np.sqrt(effective / ATMOSPHERE)
        value = 17.6 + 11 * np.log10(ratio)
    return np.where((effective > 0) & (value > 0), value, np.nan)


def behaviour_index(sounding: Sounding, stresses: Stresses) -> Values:
    """Soil behaviour type index I_c (n,), nan in gaps.

    Args:
        sounding: whose readings.
        stresses: of the ground.

    Raises:
        ValueError: no sleeve friction, on which the index rests.
    """
    if not np.isfinite(sounding.sleeve).any():
        raise ValueError(
            f"{sounding.file}: sounding {shown(sounding.name)} has no sleeve friction, from which layers are proposed: "
            "give the layers by --layers"
        )
    total, effective = stresses.of(sounding)
    with np.errstate(invalid="ignore", divide="ignore"):
        net = corrected_cone(sounding) - total
        ratio = np.log10(100 * sounding.sleeve / net) + 1.22
        power = np.ones_like(net)
        # The exponent of the stress depends on the index: a few rounds settle both.
        for _ in range(10):
            resistance = net / ATMOSPHERE * (ATMOSPHERE / effective) ** power
            index = np.hypot(3.47 - np.log10(resistance), ratio)
            power = np.clip(0.381 * index + 0.05 * effective / ATMOSPHERE - 0.15, 0, 1)
    return np.where(np.isfinite(index), index, np.nan)


@by_value
@dataclass(frozen=True)
class ProposedLayer:
    """A layer of a site.

    Args:
        kind: of `TYPES`, or "soil" where none was proposed.
        top: elevation (m).
        bottom: elevation (m).
        meets: elevations (m) at which it meets another layer.
    """

    kind: str
    top: float
    bottom: float
    meets: tuple[float, ...] = ()

    def inside(self, z: Values) -> npt.NDArray[np.bool_]:
        """Which elevations (n,) m lie in it.

        Args:
            z: m.
        """
        return (z < self.top) & (z >= self.bottom)

    def of_another(self, sounding: Sounding, stresses: Stresses) -> npt.NDArray[np.bool_]:
        """Which readings (n,) in it are of another soil.

        Within `TRANSITION` of another layer these are all of another type, elsewhere those whose type is no neighbour
        of its own: sand in clay, clay in sand.

        Args:
            sounding: whose readings.
            stresses: of the ground.
        """
        types = types_of(sounding, stresses)
        apart = np.abs(types - TYPES.index(self.kind))
        near = np.array([np.abs(sounding.z - elevation) <= TRANSITION for elevation in self.meets]).any(axis=0)
        return self.inside(sounding.z) & (types >= 0) & (apart > np.where(near, 0, 1))


def proposed_layers(soundings: list[Sounding], stresses: Stresses) -> list[ProposedLayer]:
    """Level layers by the mean soil behaviour type index of all soundings, from the top down.

    Args:
        soundings: with sleeve friction.
        stresses: of the ground.

    Raises:
        ValueError: a sounding without sleeve friction or elevation.
    """
    require_elevations(soundings)
    top, bottom = extent_of(soundings)
    edges = np.arange(top, bottom - STEP, -STEP)
    indices = np.full((len(soundings), len(edges)), np.nan)
    readings = np.zeros(len(edges), int)
    for row, sounding in zip(indices, soundings, strict=True):
        index = behaviour_index(sounding, stresses)
        interval = np.floor((top - sounding.z) / STEP).astype(int)
        valid = np.isfinite(index) & (interval < len(edges))
        counts = np.bincount(interval[valid], minlength=len(edges))
        readings += counts
        row[:] = np.bincount(interval[valid], index[valid], minlength=len(edges)) / np.where(counts > 0, counts, np.nan)
    seen = np.isfinite(indices).any(axis=0)
    mean = np.array([np.nanmedian(column) for column in indices[:, seen].T])
    starts, readings = edges[seen], readings[seen]
    kinds, tops = _merged(np.searchsorted(LIMITS, mean), starts)
    tops[0] = top
    while len(kinds) > 1:
        ends = np.append(tops[1:], bottom)
        thick = tops - ends
        # The soundings end within the lowest layer, whose thickness is more than they show of it.
        least = np.full(len(kinds), THINNEST)
        if readings[starts <= tops[-1]].sum() >= FEWEST:
            least[-1] /= 2
        k = int(np.argmin(thick / least))
        if thick[k] >= least[k]:
            break
        means = [mean[(starts <= high) & (starts > low)].mean() for high, low in zip(tops, ends, strict=True)]
        sides = [j for j in (k - 1, k + 1) if 0 <= j < len(kinds)]
        # The neighbour of the nearer type takes it over, of two that of the nearer index.
        kinds[k] = kinds[min(sides, key=lambda j: (abs(kinds[j] - kinds[k]), abs(means[j] - means[k])))]
        kinds, tops = _merged(kinds, tops)
    levels = [*tops.tolist(), bottom]
    return [ProposedLayer(TYPES[kind], *between) for kind, between in zip(kinds, pairwise(levels), strict=True)]


def _merged(kinds: npt.NDArray[np.intp], tops: Values) -> tuple[npt.NDArray[np.intp], Values]:
    """Types of soil from the top down, and their upper ends (m), with neighbours of one type as one."""
    first = np.r_[True, np.diff(kinds) != 0]
    return kinds[first], tops[first]


def types_of(sounding: Sounding, stresses: Stresses) -> npt.NDArray[np.intp]:
    """Number among `TYPES` of the soil at each reading (n,), -1 where it is unknown.

    Args:
        sounding: whose readings.
        stresses: of the ground.
    """
    if not np.isfinite(sounding.sleeve).any():
        return np.full(sounding.depth.size, -1)
    index = behaviour_index(sounding, stresses)
    return np.where(np.isfinite(index), np.searchsorted(LIMITS, index), -1)


def kind_between(soundings: list[Sounding], stresses: Stresses, top: float, bottom: float) -> str | None:
    """Type of the soil between two elevations (m) by its median index, None without sleeve friction.

    Args:
        soundings: with elevations.
        stresses: of the ground.
        top: elevation (m).
        bottom: elevation (m).
    """
    types = [np.empty(0, int)]
    for sounding in soundings:
        types_there = types_of(sounding, stresses)
        types.append(types_there[(types_there >= 0) & (sounding.z < top) & (sounding.z >= bottom)])
    sorted_types = np.sort(np.concatenate(types))
    return TYPES[int(sorted_types[sorted_types.size // 2])] if sorted_types.size else None


def require_elevations(soundings: list[Sounding]) -> None:
    """Raise ValueError for soundings without position or elevation.

    Args:
        soundings: to look at.
    """
    for sounding in soundings:
        lacking = [
            name for name, value in (("x", sounding.x), ("elevation of the surface", sounding.top)) if np.isnan(value)
        ]
        if lacking:
            raise ValueError(
                f"{sounding.file}: sounding {shown(sounding.name)} has no {lacking[0]}: write it into the file, in a "
                "CSV as a column x [m] or top [m]"
            )


def extent_of(soundings: list[Sounding]) -> tuple[float, float]:
    """Elevation (m) of the highest surface and of the deepest reading.

    Args:
        soundings: with elevations.
    """
    return max(sounding.top for sounding in soundings), float(min(sounding.z.min() for sounding in soundings))


def thinned(elevation: Values, valid: npt.NDArray[np.bool_], apart: float) -> npt.NDArray[np.int64]:
    """Numbers of the readings that are used: as they were read, none averaged, each at least a distance below the last.

    Args:
        elevation: (n,) of the readings (m), falling.
        valid: (n,) which may be used.
        apart: distance (m).
    """
    numbers: list[int] = []
    for k in np.flatnonzero(valid):
        if not numbers or elevation[numbers[-1]] - elevation[k] >= apart - 1e-6:
            numbers.append(int(k))
    return np.array(numbers, int)
