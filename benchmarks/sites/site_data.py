"""What a site's estimates are worth: do their intervals cover the truth, and do bands hold soundings left out?

300 made-up sites have a known mean, trend, coefficient of variation, correlation lengths and nugget; one to four
soundings are used and one is held out. A 95 % interval should hold the truth in 0.95 of them. The held-out sounding is
compared with its 95 % band, of all estimates and their uncertainty. Three public sets of soundings
(`benchmarks/data/soundings`) are treated alike: each sounding is left out once and compared with its 90 % band by the
others, in one layer by the logarithm of its cone resistance. Lengths count with the intervals that are given where they
are called unknown, too. `fos_seconds` is the time of `jaxmpm fos demo.toml --quick` from the scene to the critical
surface, in a process that has done so before.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, Report
from cooperative.example_scenes import example
from cooperative.scene import parse
from cooperative.tools import safety
from cooperative.tools.soundings import corrected_cone, read_files, thinned
from kl.estimation import FieldFit, fit_field, predicted

SITES = 300
SPACING = 0.5
"""Of readings of made-up soundings (m)."""
DRAWS = 400
"""Of a held-out sounding."""
LAYERS = {"dike": (-3.0, -10.5), "crest": (-2.7, -5.2), "polder": (-7.5, -16.0)}
"""Elevations (m) between which a public set is taken: a layer in which all its soundings have readings."""
APART = 0.25
"""Least distance (m) of readings that are used of a public sounding."""

Part = tuple[dict[str, float], list[dict[str, Any]]]


def run(quick: bool) -> Report:
    """The values and rows of every part."""
    values: dict[str, Any] = {}
    rows: list[dict[str, Any]] = []
    for part in PARTS:
        measured, described = part(quick)
        values |= measured
        rows += described
    return Report(values, rows)


def made_up(quick: bool) -> Part:
    """Coverage of intervals and of held-out soundings over sites of known truth."""
    random = np.random.default_rng(34)
    hits: dict[str, list[bool]] = {}
    by_count: dict[int, list[dict[str, float]]] = {}
    inside: list[float] = []
    for number in range(12 if quick else SITES):
        points, values, truth = _site(random)
        held_out = points[0] == points[0].max()
        fit = fit_field(points[:, ~held_out], values[~held_out], depth=-points[1, ~held_out], seed=number)
        hit_by_name = {
            name: _holds(fit, name, value) for name, value in truth.items() if getattr(fit, name) is not None
        }
        band = np.quantile(
            predicted(fit, points[:, held_out], -points[1, held_out], draws=DRAWS, seed=number), [0.025, 0.975], axis=0
        )
        inside.append(float(np.mean((band[0] <= values[held_out]) & (values[held_out] <= band[1]))))
        for name, hit in hit_by_name.items():
            hits.setdefault(name, []).append(hit)
        by_count.setdefault(len(np.unique(points[0])) - 1, []).append({**hit_by_name, "held_out": inside[-1]})
    lengths = hits["vertical"] + hits.get("horizontal", [])
    values_of = {
        "cov_coverage": float(np.mean(hits["cov"])),
        "mean_coverage": float(np.mean(hits["mean"])),
        "length_coverage": float(np.mean(lengths)),
        "held_out_coverage": float(np.mean(inside)),
    }
    rows = [
        {"soundings": count, "sites": len(sites)}
        | {
            name: round(float(np.mean([row[name] for row in sites])), 3) if name in sites[0] else "none"
            for name in ("mean", "trend", "cov", "vertical", "horizontal", "held_out")
        }
        for count, sites in sorted(by_count.items())
    ]
    return values_of, rows


def _site(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Points (2, n) m, values (n,) Pa and the truth of a made-up site of two to five soundings."""
    truth = {
        "mean": random.uniform(15e3, 40e3),
        "cov": random.uniform(0.15, 0.5),
        "vertical": float(np.exp(random.uniform(np.log(0.4), np.log(2)))),
        "horizontal": float(np.exp(random.uniform(np.log(10), np.log(60)))),
    }
    truth["trend"] = truth["mean"] * random.uniform(0, 0.1)
    depth = np.arange(SPACING / 2, random.uniform(8, 20), SPACING)
    x = np.cumsum(random.uniform(5, 30, random.integers(2, 6)))
    points = np.stack([np.repeat(x, depth.size), -np.tile(depth, x.size)])
    lags = np.abs(points[:, :, None] - points[:, None, :])
    correlation = np.exp(-lags[0] / truth["horizontal"] - lags[1] / truth["vertical"])
    noise = random.choice([0.0, 0.05, 0.15])
    deviation = np.sqrt(np.log1p(truth["cov"] ** 2))
    root = np.linalg.cholesky(correlation + (noise / (1 - noise) + 1e-9) * np.eye(len(correlation)))
    scores = root @ random.standard_normal(len(root))
    mean = truth["mean"] - truth["trend"] * points[1]
    return points, mean * np.exp(deviation * scores - deviation**2 / 2), truth


def _holds(fit: FieldFit, name: str, value: float) -> bool:
    interval = getattr(fit, name)
    return bool(interval.low <= value <= interval.high)


def public(quick: bool) -> Part:
    """Share of readings of public soundings, each left out once, within their 90 % band."""
    shares, rows = [], []
    for name, (top, bottom) in LAYERS.items():
        soundings, _ = read_files([ROOT / "benchmarks" / "data" / "soundings" / f"{name}.csv"])
        data = []
        for sounding in soundings:
            z, cone = sounding.z, corrected_cone(sounding)
            chosen = thinned(z, np.isfinite(cone) & (z < top) & (z > bottom), APART)
            data.append(
                (
                    np.stack([np.full(chosen.size, sounding.x), np.full(chosen.size, sounding.y), z[chosen]]),
                    cone[chosen],
                )
            )
        for number, (points, cone) in enumerate(data[:1] if quick else data):
            others = [sounding for k, sounding in enumerate(data) if k != number]
            used, values = (
                np.concatenate([sounding[0] for sounding in others], axis=1),
                np.concatenate([e[1] for e in others]),
            )
            fit = fit_field(used, values, depth=top - used[2])
            low, high = np.quantile(predicted(fit, points, top - points[2], draws=DRAWS), [0.05, 0.95], axis=0)
            shares.append(np.mean((low <= cone) & (cone <= high)))
            horizontal = None if "horizontal" in fit.unknown else fit.horizontal
            rows.append(
                {
                    "set": name, "left out": soundings[number].name, "readings": cone.size,
                    "within 90 %": round(float(shares[-1]), 3),
                    "band, high / low": round(float(np.median(high / low)), 2),
                    "cov": round(fit.cov.value, 2), "vertical (m)": round(fit.vertical.value, 2),
                    "horizontal (m)": "unknown" if horizontal is None else round(horizontal.value, 1),
                }
            )  # fmt: skip
    return {"public_held_out_coverage": float(np.mean(shares))}, rows


def equilibrium(quick: bool) -> Part:
    """Seconds of the demo's factor of safety by limit equilibrium, from its scene to the critical surface."""
    factor_of_safety = partial(safety.factor_of_safety, parse(example("demo")), solver=False)
    if not quick:
        factor_of_safety()  # compiled programs are loaded then
    return {"fos_seconds": round(factor_of_safety().seconds, 2)}, []


PARTS: tuple[Callable[[bool], Part], ...] = (made_up, public, equilibrium)
"""What is measured; each gives its values and rows."""
