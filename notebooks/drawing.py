"""What the notebooks draw alike: particles as boxes in true size, and colours that all eyes tell apart."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""The palette of Okabe and Ito (2008), https://jfly.uni-koeln.de/color/."""


def style() -> None:
    """Settings of matplotlib for light figures."""
    plt.rcParams.update(
        {
            "figure.dpi": 72,
            "figure.constrained_layout.use": True,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.prop_cycle": plt.cycler(color=[BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK]),
            "image.cmap": "viridis",
        }
    )


def corners(position: Any, half_size: Any) -> np.ndarray:
    """Corners (N, 4, 2) m of boxes around `position` (2, N) m, 1.25 `half_size` (2,) m to each side.

    They are a quarter larger than the particles, so that sheared soil shows no gaps.
    """
    around = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 1.25 * np.asarray(half_size)
    return np.asarray(position).T[:, None] + around


def draw_section(
    ax: Axes,
    position: Any,
    half_size: Any,
    values: Any,
    *,
    colours: str = "viridis",
    limits: tuple[float, float] | None = None,
    title: str = "",
) -> PolyCollection:
    """Draw particles of a section at `position` (2, N) m, coloured by `values` (N) between `limits`."""
    boxes = PolyCollection(
        corners(position, half_size), array=np.asarray(values), cmap=colours, lw=0, antialiased=False
    )
    boxes.set_clim(limits)
    ax.add_collection(boxes)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    ax.set_title(title, loc="left", fontsize=10)
    return boxes
