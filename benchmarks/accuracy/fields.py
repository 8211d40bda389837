"""Random fields: error in covariance against run time, beside other methods, and the published examples.

Every timing is of one core, in a process of its own, on 1 m cells of 96 x 96 x 24 m with correlation lengths of 60, 60
and 2 m unless the row has others.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import kl
from benchmarks.measure import Report, on_cores
from cooperative.reporting import save
from kl import plots

PAPER: dict[str, Any] = {"name": "paper", "lengths": [60.0, 60.0, 2.0], "extent": [96.0, 96.0, 24.0], "cell": 1.0}
SHORT = {**PAPER, "name": "short lengths", "lengths": [10.0, 10.0, 2.0], "batch": 20}
SMALL: dict[str, Any] = {"name": "small box", "lengths": [10.0, 10.0, 2.0], "extent": [16.0, 16.0, 8.0], "cell": 1.0}
POINTS = 681_984


def _case(method: str, parameter: Any = None, domain: dict[str, Any] = PAPER, **options: Any) -> dict[str, Any]:
    case = {"method": method, "parameter": parameter, **domain, **options}
    return {"domain": domain["name"], **on_cores(1, "benchmarks.accuracy.fields_case", json.dumps(case))}


def _median(runs: list[dict[str, Any]], *timings: str) -> dict[str, Any]:
    """The first run, with each timing that of the run whose median is the middle one."""
    middle = {name: sorted((run[name] for run in runs), key=lambda t: t["median"])[len(runs) // 2] for name in timings}
    return {**runs[0], **middle}


def _curves(quick: bool) -> list[dict[str, Any]]:
    """Rows of every method on the paper's lattice; the dense decomposition on the small one, beside two others."""
    haar, nystrom = ((4, 6), (24, 48)) if quick else ((3, 4, 5, 6, 7), (12, 16, 24, 32, 40, 48))
    energies = (0.95, 0.99) if quick else (0.9, 0.95, 0.99, 0.9999, 0.99999)
    cases: list[tuple[str, Any, dict[str, Any], dict[str, Any]]] = [
        *(("haar", level, PAPER, {}) for level in haar),
        *(("nystrom", order, PAPER, {}) for order in nystrom),
        *(("truncated", energy, PAPER, {}) for energy in energies),
        ("untruncated", None, PAPER, {}),
        *(("circulant", padding, PAPER, {"repeats": 3}) for padding in ((2.0,) if quick else (2.0, 3.0))),
        ("dense", None, SMALL, {}),
        ("truncated", 0.999, SMALL, {}),
        ("untruncated", None, SMALL, {}),
        ("truncated", 0.999, SHORT, {}),
    ]
    if importlib.util.find_spec("gstools"):
        modes = (100,) if quick else (100, 300, 1000)
        cases += [("randomization", number, PAPER, {"repeats": 1}) for number in modes]
    return [_case(method, parameter, domain, **options) for method, parameter, domain, options in cases]


# Colours that the colour-blind can tell apart (Okabe and Ito).
LOOK = {
    "truncated": ("#0072B2", "o", "truncated by energy"),
    "haar": ("#E69F00", "s", "Haar, by level"),
    "nystrom": ("#009E73", "^", "Nystrom, by order"),
    "untruncated": ("#D55E00", "D", "untruncated, on the lattice"),
    "circulant": ("#CC79A7", "v", "circulant embedding, by padding"),
    "randomization": ("#000000", "x", "randomization (GSTools), by modes"),
    "dense": ("#56B4E9", "P", "dense decomposition"),
}


def _figure(rows: list[dict[str, Any]]) -> Figure:
    """Worst and rms error against seconds per realisation: the paper's lattice, and the small box with open marks."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True)
    for panel, measure in zip(panels, ("error_worst", "error_rms"), strict=True):
        for method, (colour, marker, label) in LOOK.items():
            for domain, filled in ((PAPER["name"], True), (SMALL["name"], False)):
                chosen = [r for r in rows if (r["method"], r["domain"]) == (method, domain)]
                chosen.sort(key=lambda row: row["parameter"] or 0)
                if not chosen:
                    continue
                seconds = [row["realisation_s"]["median"] for row in chosen]
                face = None if filled else "none"
                name = label if filled else f"{label}, {' x '.join(f'{e:g}' for e in SMALL['extent'])} m only"
                panel.loglog(
                    seconds, [row[measure] for row in chosen], marker + "-", color=colour, mfc=face, ms=5, label=name
                )
        panel.set(xlabel="seconds per realisation, one core", ylabel=measure.replace("_", " of covariance, "))
        panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _example_1() -> tuple[dict[str, Any], Figure]:
    """Autocorrelation of 1000 realisations along the axes through the centre, and its picture as the paper's Fig. 1.

    The paper does not print the box; its reference point is the first cell beyond the middle of 20 x 10 x 10 m.
    """
    extent, lengths, cell, samples = (20.0, 10.0, 10.0), (16.9, 16.9, 1.7), 0.5, 1000
    covariance = tuple(map(kl.SquaredExponential, lengths))
    axes = tuple(np.arange(cell / 2, size, cell, dtype=np.float32) for size in extent)
    expansion = kl.expand(covariance, (0.0,) * 3, extent)
    coefficients = kl.latin_hypercube(jax.random.key(1), samples, expansion.modes)
    centre = tuple(len(axis) // 2 - 1 for axis in axes)
    lags, estimates, targets = [], [], []
    for number, axis in enumerate(axes):
        line = tuple(
            jnp.asarray(a if other == number else a[middle : middle + 1])
            for other, (a, middle) in enumerate(zip(axes, centre, strict=True))
        )
        fields = kl.field_on_lattice(expansion, coefficients, line).reshape(samples, -1)
        strength = np.asarray(kl.Lognormal(10e3, 0.3).transform(fields), np.float64)
        lag = axis - axis[centre[number]]
        correlation: Any = np.corrcoef(strength.T)
        estimates.append(correlation[centre[number]])
        lags.append(lag)
        targets.append(np.exp(-((lag / lengths[number]) ** 2)))
    names = ("x", "y", "z")
    figure = plots.correlation(tuple(lags), tuple(estimates), tuple(targets), samples=samples, names=names)
    worst = max(float(np.abs(e - t).max()) for e, t in zip(estimates, targets, strict=True))
    return {
        "example_1_modes_95": kl.expand(covariance, (0.0,) * 3, extent, energy=0.95).modes,
        "example_1_modes_95_by_axis": _modes_by_axis(covariance, extent),
        "example_1_modes_95_published": 30,
        "example_1_energy_of_30": kl.expand(covariance, (0.0,) * 3, extent, modes=30).variance_mean,
        "example_1_autocorrelation_error": worst,
    }, figure


def _modes_by_axis(covariance: tuple[Any, ...], extent: tuple[float, ...]) -> int:
    """Number of products when each axis alone keeps the cube root of 95 %, and every product is selected."""
    share = 0.95 ** (1 / 3)
    counts = [kl.expand((c,), (0.0,), (size,), energy=share).modes for c, size in zip(covariance, extent, strict=True)]
    return int(np.prod(counts))


def _example_2() -> dict[str, Any]:
    """Modes of the paper's second example: 50 x 50 x 15 m, lengths of 25, 25 and 2 m."""
    covariance = tuple(map(kl.SquaredExponential, (25.0, 25.0, 2.0)))
    box = ((0.0,) * 3, (50.0, 50.0, 15.0))
    energies = {
        f"example_2_modes_{percent}": kl.expand(covariance, *box, energy=percent / 100).modes for percent in (95, 99)
    }
    expansion_250 = kl.expand(covariance, *box, modes=250)
    captured = kl.captured_variance(expansion_250)
    return {
        **energies,
        "example_2_modes_95_by_axis": _modes_by_axis(covariance, box[1]),
        "example_2_modes_published": 250,
        "example_2_energy_of_250": captured.mean,
        "example_2_worst_variance_of_250": captured.worst,
    }


def run(quick: bool) -> Report:
    """All rows; `values` are the paper's field at 99.9 % of the variance, and the two examples."""
    # Other work on the machine spoils a whole process, so the figures that matter are the median of several.
    field = _median([_case("truncated", 0.999) for _ in range(1 if quick else 5)], "setup_s", "realisation_s")
    count = POINTS // 8 if quick else POINTS
    scattered = _median([_case("points", count, repeats=5) for _ in range(1 if quick else 3)], "realisation_s")
    short_points = _case("points", count, SHORT, repeats=3)
    rows = [field, *_curves(quick), scattered, short_points]
    example_1, figure = _example_1()

    def draw(folder: Path) -> None:
        save(_figure(rows), folder / "fields_error_time.png", dpi=90)
        save(figure, folder / "fields_example_1.png", dpi=90)

    short = next(row for row in rows if row["method"] == "truncated" and row["domain"] == SHORT["name"])
    values = {
        "setup_ms": field["setup_s"]["median"] * 1e3,
        "setup_error_in_correlation": field["error_worst"],
        "ms_per_realisation_999": field["realisation_s"]["median"] * 1e3,
        "ms_per_realisation_999_error_in_correlation": field["error_worst"],
        f"points_{POINTS}_s": scattered["realisation_s"]["median"] * POINTS / count,
        f"points_{POINTS}_error_in_correlation": scattered["error_worst"],
        "error_in_correlation_rms": field["error_rms"],
        "error_in_correlation_once_rescaled": field["error_rescaled"],
        "memory_of_points_mb": scattered["memory_mb"],
        "short_lengths_modes": short["modes"],
        "short_lengths_setup_ms": short["setup_s"]["median"] * 1e3,
        "short_lengths_ms_per_realisation": short["realisation_s"]["median"] * 1e3,
        "short_lengths_points_s": short_points["realisation_s"]["median"] * POINTS / count,
        "short_lengths_error_in_correlation": short["error_worst"],
        **example_1,
        **_example_2(),
    }
    return Report(values, rows, draw)
