"""The probability of failure against time as a figure and as tables."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cooperative.reporting import panels, save
from cooperative.store import write_aside
from cooperative.tools.in_time._answer import InTime
from jaxmpm.support.text import literal

HOUR = 3600.0
MM_PER_HOUR = 3.6e6


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
    paths = [folder / "probability.png"]
    save(_figure(result), paths[0])
    names = ("probability.csv", "first_failures.csv", "probability.json")
    for name, content in zip(names, (_table(result), _samples(result), _json(result)), strict=True):
        paths.append(folder / name)
        write_aside(paths[-1], content.encode())
    return paths


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
    table = result.campaign.seepage
    assert table is not None
    end = table.times[-1]
    if table.rate is not None:
        times, rates = np.array([*table.rate, (max(end, table.rate[-1][0]), table.rate[-1][1])]).T
        axes[1].step(times / HOUR, rates * MM_PER_HOUR, where="post", color="#0072B2")
        axes[1].set(ylabel="rain [mm/h]")
    elif table.level is not None:
        times = np.linspace(0, end, 200)
        axes[1].plot(times / HOUR, np.interp(times, *np.array(table.level).T), color="#0072B2")
        axes[1].set(ylabel="level [m]")
    axes[1].set(xlabel="time [h]")
    for ax in axes:
        ax.set(xlim=(0, end / HOUR))
    return figure


def _written(head: list[str], rows: list[list[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def _table(result: InTime) -> str:
    rows: list[list[object]] = [
        [time, each.probability, *each.interval, each.cov, each.refined_runs]
        for time, each in zip(result.times, result.estimates, strict=True)
    ]
    return _written(["t [s]", "P_f", "low", "high", "cov", "runs"], rows)


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
    return _written([*head, *(f"factor at {time:g} s" for time in result.times)], rows)


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
