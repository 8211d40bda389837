"""Strength against depth at three stations of a section: what a scene's means, trends and layers amount to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from matplotlib.axes import Axes

import kl
from cooperative.reporting import _plots as plots
from cooperative.runs import GridModel, rock_of, strength_of

SAMPLES = {2: 512, 3: 64}
"""Samples that a profile is made of, in a section and in 3D, whose grids are larger."""

TAILS = (0.05, 0.95)
"""Shares of the samples that lie below the ends of a band."""

LEVEL = 0.02
"""Share of the relief within which ground counts as the foot or the top of a slope."""

COLOURS = {"toe": "#009E73", "mid slope": "#E69F00", "crest": "#56B4E9"}


@dataclass(frozen=True)
class Profile:
    """Strength in one column of particles.

    Args:
        station: "toe", "mid slope" or "crest".
        x: of the column (m).
        elevation: of its ground's surface (m).
        depth: below it (n,) m, downwards.
        mean: by parameter (n,), in SI units and degrees, nan where the soil has none.
        tails: by parameter that is random (2, n), the values below which `TAILS` of the samples lie.
    """

    station: str
    x: float
    elevation: float
    depth: np.ndarray
    mean: Mapping[str, np.ndarray]
    tails: Mapping[str, np.ndarray]


def stations(x: np.ndarray, surface: np.ndarray) -> dict[str, int]:
    """Which columns stand at the toe, mid slope and the crest of a section, whichever way it falls.

    Toe and crest are the nearest two of which one has the lowest ground and the other the highest, within `LEVEL` of
    the relief. Level ground has one station, in its middle.

    Args:
        x: of the columns, ascending (n,) m.
        surface: elevation of the ground there (n,) m.
    """
    foot, relief = surface.min(), np.ptp(surface)
    if relief == 0:
        return {"mid slope": len(x) // 2}
    share = (surface - foot) / relief
    low, high = np.flatnonzero(share <= LEVEL), np.flatnonzero(share >= 1 - LEVEL)
    pair = np.unravel_index(np.abs(x[low][:, None] - x[high]).argmin(), (low.size, high.size))
    toe, crest = int(low[pair[0]]), int(high[pair[1]])
    first = min(toe, crest)
    middle = first + int(np.abs(share[first : max(toe, crest) + 1] - 0.5).argmin())
    return {"toe": toe, "mid slope": middle, "crest": crest}


def profiles(model: GridModel, plane: np.ndarray) -> list[Profile]:
    """Strength at the stations of a section of a grid, over samples that its random soil draws.

    A law of the user's own may have none.

    Args:
        model: the grid.
        plane: which of its particles are of the section (N,).
    """
    position = np.asarray(model.scene.particles.position, float)
    x, first = np.unique(position[0, plane], return_index=True)
    surface = np.asarray(model.campaign.site.shape.heights(*position[:-1, plane][:, first]), float)
    found = stations(x, surface)
    columns = {}
    for station, at in found.items():
        column = np.flatnonzero(plane & (position[0] == x[at]))
        columns[station] = column[np.argsort(-position[-1, column])]
    certain, rock = strength_of(model), rock_of(model)
    chosen = np.concatenate(list(columns.values()))
    values_of_samples = _drawn(model, [name for name in certain if name in model.names], chosen)
    ends = np.cumsum([column.size for column in columns.values()])[:-1]
    result = []
    for number, (station, column) in enumerate(columns.items()):
        at = found[station]
        of_column = {name: np.split(values, ends, axis=1)[number] for name, values in values_of_samples.items()}
        bare = np.where(rock[column], np.nan, 1.0)
        mean = {
            name: bare * (of_column[name].mean(axis=0) if name in of_column else of[column])
            for name, of in certain.items()
        }
        tails = {name: bare * np.quantile(values, TAILS, axis=0) for name, values in of_column.items()}
        depth = surface[at] - position[-1, column]
        result.append(Profile(station, float(x[at]), float(surface[at]), depth, mean, tails))
    return result


def _drawn(model: GridModel, names: Sequence[str], chosen: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters (samples, n) of some particles in samples of their own, which a scene with few samples has too."""
    if not names:
        return {}
    coefficients = kl.latin_hypercube(jax.random.key(0), SAMPLES[model.campaign.dimension], model.soil.modes)
    ascending, back = np.unique(chosen, return_inverse=True)
    values = model.of(ascending).parameters_of_samples(np.asarray(coefficients), names)
    return {name: of_samples[:, back] for name, of_samples in values.items()}


def draw_profiles(axes: Sequence[Axes], shown: Sequence[Profile]) -> None:
    """Mean strength against depth, and the band of its samples where it is random, a panel for each parameter.

    Args:
        axes: of the parameters.
        shown: profiles of the stations.
    """
    for ax, name in zip(axes, shown[0].mean, strict=True):
        scale = plots.quantity(name)
        for profile in shown:
            colour = COLOURS[profile.station]
            label = f"{profile.station}, x = {profile.x:.4g} m"
            ax.plot(profile.mean[name] / scale.size, profile.depth, color=colour, lw=1.5, label=label)
            if name in profile.tails:
                ax.fill_betweenx(profile.depth, *profile.tails[name] / scale.size, color=colour, alpha=0.2, lw=0)
        random = any(name in profile.tails for profile in shown)
        ax.set_title("mean, 5 to 95 %" if random else "mean", loc="left")
        ax.set(xlabel=scale.label, ylabel="depth [m]", ylim=(max(profile.depth.max() for profile in shown), 0.0))
        ax.set_xlim(left=0.0)
    for ax in axes[:1]:
        ax.legend(fontsize="x-small", frameon=False)
