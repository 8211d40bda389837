"""Cures of a run-out that depends on the cell, side by side on four small slides.

Each slide runs on three cells. `front_m`, where the deposit is as thick as a tenth of the slope's height, and
`front_95_m`, of 95 % of the soil that slid, stand coarse to fine, those of sand over the column's width. `last_halving`
is their largest change in the last halving, over the finest. `noise_m_s` is the root mean square, over the soil that
slid, of what its velocity differs from the grid's on the finest cells. `price` is the time of a step over that of the
case's own settings on the middle cells, the median of pairs of short runs, and `end_s` the time that the slide takes to
rest on the finest. Sand and slides that do not rest run to a given time. Rates of `pic_damping` are in units of sqrt(g
/ H), H the height of the slope.
Finished rows stay in out/runout_cures, and the next command goes on from there.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from benchmarks.accuracy.collapse import DEFAULTS, Numerics
from benchmarks.accuracy.runout_convergence import RUN_OUTS
from benchmarks.accuracy.runout_slides import LONG_TOE, SLIDES, Slide, Tables, clay_dam, column, of_scene
from benchmarks.measure import ROOT, Report, code_digest, sources, stored_row
from jaxmpm import GIMP, QuadraticBSpline, Scheme, diagnostics, solve

PAIRS, STEPS = 5, 200
"""Short runs that a price is the median of, and their steps."""


class Slides(Protocol):
    """A slide on cells of any size, with other numerical choices."""

    def __call__(self, cell: float, *, numerics: Numerics, gap_memory: bool) -> Slide:
        """The slide on cells of this size (m)."""


@dataclass(frozen=True)
class Cure:
    """What replaces a slide's own choices.

    Args:
        numerics: numerical choices.
        gap_memory: whether soil remembers its gap.
        decay: `pic_damping` times the slope's sqrt(H / g).
    """

    numerics: Numerics
    gap_memory: bool = True
    decay: float = 0.0


FLIP: Numerics = {"kernel": GIMP, "flip": 1.0, "apic": False}
CURES: Mapping[str, Cure] = {
    "flip": Cure(FLIP),
    "flip 0.99": Cure({**FLIP, "flip": 0.99}),
    "flip 0.97": Cure({**FLIP, "flip": 0.97}),
    "flip 0.9": Cure({**FLIP, "flip": 0.9}),
    "pic_damping 1/3": Cure(FLIP, decay=1 / 3),
    "pic_damping 1": Cure(FLIP, decay=1.0),
    "xpic(2), each step": Cure({**FLIP, "flip": 0.0, "xpic": 2}),
    "xpic(5), each step": Cure({**FLIP, "flip": 0.0, "xpic": 5}),
    "pic_damping 1, xpic(2)": Cure({**FLIP, "xpic": 2}, decay=1.0),
    "usl": Cure({**FLIP, "scheme": Scheme.USL, "cfl": 0.7}),
    "flip, b-spline": Cure({**FLIP, "kernel": QuadraticBSpline}),
    "apic": Cure({"kernel": QuadraticBSpline, "flip": 0.0, "apic": True}),
    "F-bar": Cure({"fbar": True, "cell_average": False}),
    "own settings, gap forgotten": Cure(DEFAULTS, gap_memory=False),
}


def _sand(cell: float, *, numerics: Numerics, gap_memory: bool) -> Slide:
    return column(1.0, cell, gap_memory=gap_memory, numerics=numerics)


def _section(cell: float, *, numerics: Numerics, gap_memory: bool) -> Slide:
    changes = {**LONG_TOE, **_soil(gap_memory)}
    return of_scene("section", cell, reduction=1.2, changes=changes, numerics=numerics)


def _retrogression(cell: float, *, numerics: Numerics, gap_memory: bool) -> Slide:
    return of_scene("sites/retrogression_5m_buoyant", cell, changes=_soil(gap_memory), numerics=numerics)


def _soil(gap_memory: bool) -> Tables:
    return {"soil": {"gap_memory": gap_memory}}


@dataclass(frozen=True)
class Case:
    """A slide. make: it. cells: halved (m). height: of the slope (m). gravity: m/s2."""

    make: Slides
    cells: tuple[float, ...]
    height: float
    gravity: float = 9.81


CASES: Mapping[str, Case] = {
    "sand": Case(_sand, (1 / 16, 1 / 32, 1 / 64), 1.0),
    "section": Case(_section, (2, 1, 0.5), 12.0),
    "clay dam": Case(clay_dam, (1, 0.5, 0.25), 5.0),
    "retrogression": Case(_retrogression, (1, 0.5, 0.25), 5.0, 5.247),
}


def noise(slide: Slide) -> float:
    """Root mean square of the velocity that the grid does not resolve, over the soil that slid (m/s)."""
    sliding = np.linalg.norm(np.asarray(slide.state.displacement), axis=0) >= slide.slid
    unresolved = np.asarray(slide.state.velocity - diagnostics.grid_velocity(slide.scene, slide.state))[:, sliding]
    return float(np.sqrt((unresolved**2).sum(axis=0).mean()))


def _seconds(slide: Slide) -> float:
    """Of a short run that goes on from the end of a slide."""
    state = replace(slide.state, step=jnp.zeros_like(slide.state.step), status=jnp.zeros_like(slide.state.status))
    start = time.perf_counter()
    solve(slide.scene, state, t_end=STEPS * float(slide.scene.numerics.time_step)).state.velocity.block_until_ready()
    return time.perf_counter() - start


def price(slide: Slide, reference: Slide) -> float:
    """Time of a step over that of another slide's, one run after the other so that both meet the same load."""
    _seconds(slide), _seconds(reference)  # these compile
    return statistics.median(_seconds(slide) / _seconds(reference) for _ in range(PAIRS))


@cache
def default_slide(case: Case, cell: float) -> Slide:
    """The slide with its own choices on cells of this size (m)."""
    return case.make(cell, numerics=DEFAULTS, gap_memory=True)


def row(case: Case, cure: Cure, cells: tuple[float, ...]) -> dict[str, Any]:
    """What a cure does to a slide on cells that are halved.

    Args:
        case: the slide.
        cure: what is tried.
        cells: edges (m), coarse to fine.

    Returns:
        Run-outs on each, their change, noise, price and the time to rest.
    """
    numerics: Numerics = {**cure.numerics, "pic_damping": cure.decay * math.sqrt(case.gravity / case.height)}
    slides = [case.make(cell, numerics=numerics, gap_memory=cure.gap_memory) for cell in cells]
    rows = [slide.row() for slide in slides]
    middle = len(cells) // 2
    return {
        **{name: [round(line[name], 2) for line in rows] for name in RUN_OUTS},
        "last_halving": round(max(abs(rows[-2][name] / rows[-1][name] - 1) for name in RUN_OUTS), 3),
        "noise_m_s": round(noise(slides[-1]), 4),
        "price": round(price(slides[middle], default_slide(case, cells[middle])), 2),
        "end_s": round(float(slides[-1].state.step * slides[-1].scene.numerics.time_step), 1),
    }


def run(quick: bool) -> Report:
    """All cures of all slides; `quick` the two coarser cells of the dam."""
    if quick:
        dam = CASES["clay dam"]
        table = [{"case": "clay dam", "cure": tried} | row(dam, cure, dam.cells[:2]) for tried, cure in CURES.items()]
    else:
        folder = ROOT / "out" / "runout_cures" / code_digest(*sources(row, *SLIDES))
        table = [
            {"case": name, "cure": tried}
            | stored_row(folder, f"{name}, {tried.replace('/', ' over ')}", partial(row, case, cure, case.cells))
            for name, case in CASES.items()
            for tried, cure in CURES.items()
            if not (name == "sand" and cure.numerics.get("fbar"))
        ]
    values: dict[str, object] = {f"{line['case']}, {line['cure']}": line["last_halving"] for line in table}
    return Report(values, table)
