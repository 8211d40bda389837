"""The probability of failure against time as a figure and as tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cooperative.reporting import panels, save
from cooperative.tools.in_time._answer import InTime
from cooperative.tools.seepage import HOUR, csv_text, draw_load, write_texts
from jaxmpm.support.text import literal


def write_in_time(result: InTime, folder: Path) -> list[Path]:
    """Write `probability.png`, `probability.csv`, `first_failures.csv` and `probability.json`.

    Args:
        result: of `probability_in_time`.
        folder: to write to.

    Returns:
        Paths of the files.

    Raises:
        OSError: the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "probability.png"
    save(_figure(result), picture)
    texts = {
        "probability.csv": _table(result), "first_failures.csv": _samples(result), "probability.json": _json(result)
    }  # fmt: skip
    return [picture, *write_texts(folder, texts)]


def _figure(result: InTime) -> Figure:
    """P_f with its interval above the rain or the level."""
    figure, axes = panels(2, 1, size=(7.0, 2.9))
    hours = np.array(result.times) / HOUR
    low, high = np.array([each.interval for each in result.estimates]).T
    axes[0].fill_between(hours, low, high, color="#D55E00", alpha=0.25, lw=0, label="95 % interval at each time")
    axes[0].plot(hours, [each.probability for each in result.estimates], "o-", color="#D55E00", label="P_f")
    axes[0].set(ylabel="probability that it has failed", ylim=(0, None))
    axes[0].set_title(literal(result.campaign.name), loc="left")
    axes[0].legend(frameon=False, fontsize="small")
    draw_load(axes, result.campaign)
    return figure


def _table(result: InTime) -> str:
    rows: list[list[object]] = [
        [time, each.probability, *each.interval, each.cov, each.refined_runs]
        for time, each in zip(result.times, result.estimates, strict=True)
    ]
    return csv_text(["t [s]", "P_f", "low", "high", "cov", "runs"], rows)


def _when(result: InTime, first: int) -> object:
    """The time of a first failure (s) in words."""
    return "broke off" if first < 0 else "none" if first == len(result.times) else result.times[first]


def _samples(result: InTime) -> str:
    rows: list[list[object]] = [
        [
            number, _when(result, int(first)),
            _when(result, result.refined[number]) if number in result.refined else "",
            *(round(float(each), 4) for each in result.factors[number]),
        ]
        for number, first in enumerate(result.rough)
    ]  # fmt: skip
    head = ["sample", "first failure, rough [s]", "first failure, refined [s]"]
    return csv_text([*head, *(f"factor at {time:g} s" for time in result.times)], rows)


def _json(result: InTime) -> str:
    content = {
        "name": result.campaign.name,
        "runs": result.runs,
        "times": [
            {
                "time": time, "probability": each.probability, "interval": list(each.interval), "level": each.level,
                "cov": each.cov if np.isfinite(each.cov) else None, "method": each.method, "notes": list(each.notes),
            }
            for time, each in zip(result.times, result.estimates, strict=True)
        ],
    }  # fmt: skip
    return json.dumps(content, indent=1) + "\n"
