"""Failure probabilities of slopes of the literature, by class and by the limit load.

Factors of safety alone are in `stability_of_slopes`.

Cho's slope with cohesion and friction, of the rows of `benchmarks.sites.cho_cphi`, and his undrained slope. Infinite
correlation lengths, where P_f is P(S_u < median / factor of safety), on the published section and on Griffiths and
Fenton's slope, there also with half of the scatter in soil of two stiffnesses, which share one answer; in 3D, of 100
rough and 24 refined runs each, Example 2 of the paper (random cohesion and friction) and the published slope without
softening, counterpart of the printed 0.231, between fixed ends and rollers; Example 2 and fixed ends also with all
strength multiplied so that the median soil has a printed factor of safety, which tells what of a difference is the
factor's. Reduced by R they are the soil of the case itself reduced by less, so that its limit load is known but for
that factor. All but the first are campaigns in out/random_slopes, which go on with the next command where they were
stopped; what has not ended is null. `--only NAMES` runs the cases whose names begin so, and takes the rows of others
from the kept answer.
`--quick` runs a few samples of each on coarse grids.
"""

from __future__ import annotations

import math
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.measure import ROOT, Report, beginning_so
from benchmarks.results import stored_rows
from benchmarks.sites import cho_cphi
from cooperative import run as run_campaign
from cooperative.folder import SUMMARY
from cooperative.runs import Stopped, cores_to_use
from cooperative.scene import LimitLoad, parse, to_toml
from cooperative.store import Store, read_rows, read_sample, read_store

SCENES = ROOT / "benchmarks" / "scenes"
Tables = dict[str, dict[str, Any]]


def as_printed(tables: Tables) -> None:
    """A scene as it stands."""


def in_part(tables: Tables) -> None:
    """So many samples of a scene in 3D as some hours of one core allow."""
    tables["campaign"] |= {"samples": 100, "refined_runs": 24}


def without_softening(tables: Tables) -> None:
    """The same soil, perfectly plastic, with the default cure of locking; failure by the limit load."""
    for key in ("softening_modulus", "residual_ratio", "softening_length", "plastic_strain", "tension_cutoff"):
        tables["soil"].pop(key, None)
    for grid in ("rough", "refined"):
        tables[grid].pop("fbar")
    tables["run"] = {"t_end": 20.0, "failure": "limit load"}
    plan = tables["campaign"]
    tables["campaign"] = {
        **{key: plan[key] for key in ("samples", "seed")}, "refined_runs": 60, "slides": 0, "fields": "none",
    }  # fmt: skip


def in_3d(tables: Tables) -> None:
    """As `without_softening`, and in part."""
    without_softening(tables)
    in_part(tables)


def on_rollers(tables: Tables) -> None:
    """As `in_3d`, with ends along y that do not hold the slope."""
    in_3d(tables)
    tables["slope"]["y_ends"] = "roller"


def without_softening_or_ends(tables: Tables) -> None:
    """As `without_softening`, with the same strength everywhere."""
    without_softening(tables)
    tables["strength"]["length"] = [math.inf] * len(tables["strength"]["length"])
    tables["campaign"] |= {"samples": 1000, "refined_runs": 100}


def of_half_the_scatter(young: float, tables: Tables) -> None:
    """A scene whose strength has a coefficient of variation of 0.25, in soil of a Young's modulus (Pa)."""
    tables["soil"]["young"] = young
    tables["strength"]["cov"] = 0.25


@dataclass(frozen=True)
class Case:
    """A slope. scene: of benchmarks/scenes. change: what is done to it. printed: P_f of the literature, None where the
    closed form holds. large: m3, from which on a slide counts as one of the whole slope, None for no such count. limit:
    of its median soil, None where its campaign measures it. factor: on all strength."""

    scene: str
    change: Callable[[Tables], None]
    printed: tuple[float, ...] | None
    large: float | None = None
    limit: LimitLoad | None = None
    factor: float = 1.0

    def at(self, factor: float, limit: LimitLoad) -> Case:
        """The case with its strength multiplied so that its median soil, of a limit load of its own, has a factor of
        safety."""
        return replace(self, limit=replace(limit, factor=factor), factor=factor / limit.factor)


EXAMPLE_2 = Case("example_2", in_part, (0.43,), large=2000.0)
FIXED = Case("paper", in_3d, (0.231,))
OF_EXAMPLE_2, OF_FIXED = LimitLoad(0.9798, 0.491, 50.0), LimitLoad(1.165, 0.303, 86.4)
"""Limit loads that the campaigns of these have measured."""

CASES = {
    "cho": Case("cho", as_printed, (0.079, 0.065, 0.078)),
    "section_infinite": Case("paper_section", without_softening_or_ends, None),
    "griffiths_fenton": Case("griffiths_fenton", as_printed, None),
    "griffiths_fenton_soft": Case("griffiths_fenton", partial(of_half_the_scatter, 2e7), None),
    "griffiths_fenton_stiff": Case("griffiths_fenton", partial(of_half_the_scatter, 1e8), None),
    "example_2": EXAMPLE_2,
    "example_2_at_1.08": EXAMPLE_2.at(1.08, OF_EXAMPLE_2),
    "example_2_at_1.03": EXAMPLE_2.at(1.031, OF_EXAMPLE_2),
    "pf_3d_limit_load": FIXED,
    "pf_3d_rollers": Case("paper", on_rollers, (0.231,)),
    "pf_3d_limit_load_at_1.14": FIXED.at(1.14, OF_FIXED),
}


def scene_text(case: Case, quick: bool) -> str:
    """The scene of a case; `quick` a section of it with a few samples on coarse grids."""
    tables = tomllib.loads((SCENES / f"{case.scene}.toml").read_text())
    case.change(tables)
    tables["run"]["strength_factor"] = round(case.factor, 4)
    if quick:
        tables["soil"]["young"] = min(tables["soil"]["young"], 2e7)  # softer, so that steps are longer
        for table in (
            tables.get("strength", {}),
            tables["soil"].get("cohesion", {}),
            tables["soil"].get("friction", {}),
        ):
            if "length" in table:
                table["length"] = [table["length"][0], table["length"][-1]]
        for key in ("width", "y_ends"):
            tables["slope"].pop(key, None)
        coarse = tables["rough"]
        coarse["spacing"] = [coarse["spacing"][0], coarse["spacing"][-1]]
        tables["refined"] = {**coarse}
        tables["campaign"] |= {"samples": 12, "refined_runs": 10}
    return to_toml(tables)


def closed_form(text: str, factor: float) -> float:
    """P(S_u < median / factor) of a lognormal strength that is the same everywhere."""
    return float(stats.norm.cdf(-math.log(factor) / math.sqrt(math.log1p(parse(text).random["strength"].cov ** 2))))


def row_of(name: str, case: Case, folder: Path, text: str, workers: int) -> dict[str, Any]:
    """The campaign of a case, run or gone on with, beside what the literature or theory has."""
    campaign = parse(text)
    with_limit_load = (
        campaign
        if case.limit is None
        else replace(campaign, measured=replace(campaign.measured, limit_load=case.limit))
    )
    summary = run_campaign(with_limit_load, folder / name, workers=workers)
    (low, high), limit = summary.probability.interval, summary.probability.limit_load
    assert limit is not None
    expected = closed_form(text, limit.factor) if case.printed is None else None
    store = read_store(folder / name)
    return {
        "case": name,
        "fos": limit.factor,
        "failure_displacement_m": limit.displacement,
        "least_volume": limit.volume,
        "pf": summary.probability.value,
        "low": low,
        "high": high,
        "printed": case.printed and list(case.printed),
        "closed_form": expected,
        "holds_closed_form": None if expected is None else bool(low <= expected <= high),
        "samples": summary.cost.samples,
        "refined_runs": summary.cost.refined_runs,
        **shares(store, limit.displacement, case.large),
        "hours": sum(summary.cost.seconds.values()) / 3600,
        "device": read_sample(store, "rough", 0).device,
        "ended": datetime.fromtimestamp((folder / name / SUMMARY).stat().st_mtime, UTC).date().isoformat(),
    }


def shares(store: Store, limit: float, large: float | None) -> dict[str, float | None]:
    """Shares of the rough samples that fail, whose soil runs out beyond the toe, and whose slides are large. Rough runs
    go on to their end, so this separates slides of the whole slope from slips within its face, which are failures too.
    """
    result = read_rows(store, "rough").columns
    counted = {"fails": result["displacement"] > limit, "beyond_toe": result["runout_foremost"] > 0}
    of_rough: dict[str, float | None] = {
        f"rough_{name}": round(float(np.mean(flags)), 3) for name, flags in counted.items()
    }
    return of_rough | {"rough_large": None if large is None else round(float(np.mean(result["volume"] > large)), 3)}


def run(quick: bool, only: Sequence[str] = ("",)) -> Report:
    """The cases that begin so, as far as they come; those that were stopped go on with the next command.

    Raises:
        Refused: If no case begins so.
    """
    chosen = beginning_so(CASES, only)
    kept = [] if len(chosen) == len(CASES) else stored_rows("random_slopes")
    rows = [row for row in kept if row["case"] not in chosen]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if quick else ROOT / "out" / "random_slopes"
        try:
            for name, case in chosen.items():
                workers = 1 if quick else len(cores_to_use())
                rows.append(row_of(name, case, folder, scene_text(case, quick), workers))
        except Stopped as stopped:
            print(stopped, file=sys.stderr)
    rows.sort(key=lambda row: list(CASES).index(row["case"]))
    return Report(summarised(rows), rows)


def summarised(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The named figures; None of what has not ended."""
    row_of_case = {one["case"]: one for one in rows}

    def of(case: str, key: str) -> Any:
        return row_of_case.get(case, {}).get(key)

    values = {f"example_2_{key}": of("example_2", key) for key in ("fos", "pf", "low", "high", "hours")}
    values |= {f"example_2_{key}": of("example_2", key) for key in ("rough_fails", "rough_beyond_toe", "rough_large")}
    for name in ("pf_3d_limit_load", "pf_3d_rollers"):
        values |= {name: of(name, "pf"), f"{name}_fos": of(name, "fos")}
    values |= {f"cho_{key}": of("cho", key) for key in ("pf", "low", "high", "fos")}
    values |= {f"cho_cphi_{key}": value for key, value in cho_cphi.summarised().items()}
    for name in (case for case in CASES if CASES[case].printed is None):
        values |= {f"{name}_{key}": of(name, key) for key in ("pf", "low", "high", "closed_form")}
    return values
