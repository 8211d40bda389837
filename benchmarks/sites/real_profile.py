"""Where soil was lost and laid down along the run-out line of a slide, surveyed and in the slides of its campaign.

The survey is a change of heights on squares, in a CSV file beside the scene. Its volume in each station of the line is
compared with that of the particles there at the end less that at the start. A square or particle belongs to the
station of the nearest point of the line. The first and last station hold what lies beyond them. The survey holds what
the debris took from its path too; the ground of a scene is not eroded.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.csv_rows import number, read_rows
from cooperative.measure import Track
from cooperative.reporting import panels, save

EDGES = np.arange(0.0, 951.0, 50.0)
"""Ends of the stations along the line (m)."""

SQUARE = 100.0
"""Area of a surveyed square (m2)."""

Ends = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Lower end, median and upper end of the slides, each (stations,) m3."""


def in_stations(track: Track, position: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Volume in each station (stations,) m3.

    Args:
        track: the run-out line.
        position: in plan (2, n) m.
        volume: at each of them (n,) m3.
    """
    return np.histogram(np.clip(track.along(position)[0], EDGES[0], EDGES[-1]), EDGES, weights=volume)[0]


def surveyed(track: Track, path: Path) -> np.ndarray:
    """Surveyed change of volume in each station (stations,) m3; loss is negative.

    Args:
        track: the run-out line.
        path: of the file, with the middle x and y of each square (m) and its change of height (m).
    """
    squares = read_rows(path, {"x": number, "y": number, "change": number}, ("x", "y")).values()
    x, y, change = (np.array([square[name] for square in squares]) for name in ("x", "y", "change"))
    return in_stations(track, np.array([x, y]), SQUARE * change)


def misplaced(survey: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Volume that a slide laid down elsewhere than surveyed, over the surveyed loss (...,).

    Args:
        survey: change (stations,) m3.
        change: of slides (..., stations) m3.
    """
    return np.abs(change - survey).sum(axis=-1) / 2 / -survey.clip(max=0.0).sum()


def stations(slide: str, survey: np.ndarray, ends: Ends) -> list[dict[str, Any]]:
    """A row for each station, with whether the interval holds the surveyed change."""
    return [
        {
            "slide": slide,
            "from_m": start,
            "to_m": end,
            "surveyed_m3": round(change),
            "low_m3": round(low),
            "median_m3": round(median),
            "high_m3": round(high),
            "within": low <= change <= high,
        }
        for start, end, change, low, median, high in np.column_stack([EDGES[:-1], EDGES[1:], survey, *ends]).tolist()
    ]


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """Change of volume along the line, with the interval of the slides."""
    figure, (axis,) = panels(1, size=(6.4, 3.2))
    at = np.append([row["from_m"] for row in rows], rows[-1]["to_m"])
    survey, low, median, high = (
        np.array([row[f"{name}_m3"] for row in rows]) / 1e3 for name in ("surveyed", "low", "median", "high")
    )
    axis.stairs(high, at, baseline=low, fill=True, color="#0072B2", alpha=0.2, lw=0, label="90 % of the slides")
    axis.stairs(median, at, color="#0072B2", lw=1.5, ls="--", label="their median")
    axis.stairs(survey, at, color="black", lw=1.5, label="surveyed")
    axis.axhline(0.0, color="0.7", lw=0.8)
    axis.set(xlabel="distance along the run-out line [m]", ylabel="change of volume [1000 m3 per 50 m]")
    axis.legend(frameon=False)
    save(figure, folder / "real_slides_profile.png", dpi=90)
