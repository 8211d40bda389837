"""Flow in the ground against exact answers and independent ones, with its time, its order and its extremes.

Errors are the largest ones over heights and times. Each row is a run of its own in float64, whose CPU seconds are those
of a second call. Groups of rows that are done are kept in out/seepage, from which a run that was stopped goes on.
Sources: Celia, Bouloutas and Zarba (1990), 10.1029/WR026i007p01483; Srivastava and Yeh (1991), 10.1029/90WR02772;
Philip (1957); Charny (1951); Kirkham (1949); Tracy (2006), 10.1029/2005WR004638.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.accuracy import seepage_exact as exact
from benchmarks.accuracy.seepage_campaigns import rain_cost_rows
from benchmarks.accuracy.seepage_in_time import chart_coverage_rows, coverage_rows
from benchmarks.accuracy.seepage_slopes import drawdown_rows, free_surface_row
from benchmarks.measure import ROOT, Report, code_digest, stored_row
from cooperative import runs
from jaxmpm import seepage

Row = dict[str, Any]

DAY, YEAR = 86400.0, 365.25 * 86400.0
CM_PER_HOUR = 0.01 / 3600
FIELD_SOIL = exact.Curves(conductivity=9.22e-5, alpha=3.35, n=2.0, porosity=0.368, residual=0.102)
"""The field soil of Celia et al. (1990), section 4."""


def clocked(run: Callable[[], Any]) -> tuple[Any, float]:
    """What a run gives, and the CPU seconds of its second call, for which nothing is compiled."""
    jax.block_until_ready(run())
    start = time.process_time()
    answer = jax.block_until_ready(run())
    return answer, round(time.process_time() - start, 4)


def inflow(problem: seepage.Problem, head: jax.Array) -> float:
    """Discharge through the faces of a section (m2/s)."""
    return float(seepage.infiltration(problem, head)[0].sum())


def marched(problem: seepage.Problem, initial: Any, times: list[float], tolerance: float) -> seepage.Flow:
    """Flow with the tolerance of its steps, which has to reach its end."""
    return seepage.run(problem, initial, times, tolerance=tolerance, max_steps=4000).raise_if_failed()


def lost(flow: seepage.Flow) -> float:
    """Largest error of the water balance over all steps, as a share of what has crossed faces."""
    return float(jnp.max(flow.balance_error[: int(flow.steps)]))


def same_soil(curves: exact.Curves, **values: float) -> seepage.VanGenuchten:
    """The soil of an independent answer."""
    return seepage.van_genuchten(
        conductivity=curves.conductivity,
        alpha=curves.alpha,
        n=curves.n,
        porosity=curves.porosity,
        residual=curves.residual,
        **{"storage": 0.0, **values},
    )


def celia_rows(quick: bool) -> Iterator[Row]:
    """A metre of the field soil, wetted from its top for a day: where the head is -5 m, against the method of lines."""
    fine = 100 if quick else 400
    heads = exact.column(FIELD_SOIL, 1.0, fine, -0.75, -10.0, -10.0, [DAY])[-1]
    half = exact.column(FIELD_SOIL, 1.0, fine // 2, -0.75, -10.0, -10.0, [DAY])[-1]
    fronts = [1 - exact.front((np.arange(h.size) + 0.5) / h.size, h, -5.0) for h in (half, heads)]
    depth = fronts[1] + (fronts[1] - fronts[0]) / 3
    for cells, tolerance in (
        ((40, 1e-2),) if quick else ((40, 1e-2), (100, 1e-2), (100, 1e-3), (400, 1e-3), (400, 1e-4))
    ):
        column = seepage.cells((1.0,), (cells,))
        problem = seepage.problem(
            column,
            same_soil(FIELD_SOIL),
            seepage.held_head("surface", pressure_head=-0.75),
            seepage.held_head("base", pressure_head=-10.0),
        )
        flow, seconds = clocked(partial(marched, problem, -10.0, [DAY], tolerance))
        found = 1 - exact.front(column.centres()[0], np.asarray(flow.head[-1]), -5.0)
        yield _row("Celia's column", cells, tolerance, depth, found, flow, seconds)


def _row(case: str, cells: int, tolerance: float, reference: float, found: float, flow: seepage.Flow, s: float) -> Row:
    return {
        "case": case,
        "cells": cells,
        "tolerance": tolerance,
        "reference": round(reference, 6),
        "found": round(found, 6),
        "error": abs(found / reference - 1),
        "steps": int(flow.steps),
        "water_lost": lost(flow),
        "seconds": s,
    }


def gardner(conductivity: float, **values: float) -> seepage.Gardner:
    """The soils of Srivastava and Yeh, with alpha of 0.1/cm."""
    return seepage.gardner(
        **{"conductivity": conductivity, "alpha": 10.0, "porosity": 0.4, "residual": 0.06, "storage": 0.0, **values}
    )


def rain_on(layers: exact.Layered, cells: int) -> tuple[seepage.Cells, Callable[[float], seepage.Problem]]:
    """A column of the layers, and its problem under a rate of rain (m/s)."""
    column = seepage.cells((float(layers.tops[-1]),), (cells,))
    number = np.searchsorted(layers.tops, column.centres()[0])
    soil = seepage.zoned([gardner(k) for k in layers.conductivity], number)
    table = seepage.held_head("base", pressure_head=0.0)
    return column, lambda rain: seepage.problem(column, soil, seepage.open_face(rain=rain), table)


def srivastava_yeh_rows(quick: bool) -> Iterator[Row]:
    """Rain that grows from 0.1 to 0.9 cm/h, or falls back: largest error of head over the largest suction."""
    fast, slow = 10 * CM_PER_HOUR, CM_PER_HOUR
    cases = {
        "one layer, wetted": (exact.Layered(10.0, [1.0], [slow], [0.34]), 0.1, 0.9),
        "one layer, drained": (exact.Layered(10.0, [1.0], [slow], [0.34]), 0.9, 0.1),
        "two layers, wetted": (exact.Layered(10.0, [1.0, 1.0], [fast, slow], [0.34, 0.34]), 0.1, 0.9),
        "two layers, slow below": (exact.Layered(10.0, [1.0, 1.0], [slow, fast], [0.34, 0.34]), 0.1, 0.9),
    }
    times = [3600.0, 5 * 3600.0, 10 * 3600.0, 50 * 3600.0]
    for name, (layers, before, rain) in list(cases.items())[: 1 if quick else None]:
        for cells, tolerance in ((50, 1e-2),) if quick else ((50, 1e-2), (200, 1e-4), (400, 4e-5)):
            column, problem = rain_on(layers, cells * len(layers.thickness))
            initial, _ = seepage.steady(problem(before * CM_PER_HOUR), -0.3)
            wet = problem(rain * CM_PER_HOUR)
            flow, seconds = clocked(partial(marched, wet, initial, times, tolerance))
            z = column.centres()[0]
            right = np.stack([layers.heads(before * CM_PER_HOUR, rain * CM_PER_HOUR, z, t) for t in times])
            difference = np.abs(np.asarray(flow.head) - right)
            worst, scale = float(difference.max()), float(np.abs(right).max())
            row = _row(f"Srivastava and Yeh, {name}", z.size, tolerance, scale, scale + worst, flow, seconds)
            yield row | {"reference": 0.0, "found": round(worst, 5)}


def philip_rows(quick: bool) -> Iterator[Row]:
    """Sorptivity of level soil: what has entered after a time, over the root of the time."""
    loam = exact.Curves(conductivity=2.89e-6, alpha=3.6, n=1.56, porosity=0.43, residual=0.078)
    for name, dry, length, at in (("loam", -10.0, 0.2, 1800.0), ("Gardner's soil", -1.0, 1.0, 3600.0)):
        if name == "loam":
            soil: Any = same_soil(loam)
            right = exact.sorptivity(loam, -1e-3, dry)
        else:
            # D = K / (alpha dtheta) is constant: the equation of heat.
            soil = gardner(CM_PER_HOUR)
            wet, less = math.exp(-10.0 * 1e-3), math.exp(10.0 * dry)
            right = 2 * 0.34 * (wet - less) * math.sqrt(CM_PER_HOUR / (10.0 * 0.34) / math.pi)
        for cells, tolerance in ((50, 1e-2),) if quick else ((50, 1e-2), (400, 1e-3)):
            level = seepage.cells((length, 1.0), (cells, 1))
            problem = seepage.problem(
                level,
                soil,
                seepage.held_head("left", pressure_head=-1e-3),
                seepage.held_head("right", pressure_head=dry),
            )
            flow, seconds = clocked(partial(marched, problem, dry, [at], tolerance))
            found = float(jnp.sum(flow.record.inflow - flow.record.outflow)) / math.sqrt(at)
            row = _row(f"Philip's sorptivity, {name}", cells, tolerance, right, found, flow, seconds)
            yield row | {"reference": right, "found": found}


def steady_row(case: str, problem: seepage.Problem, initial: Any, right: float, of: Callable[[Any], float]) -> Row:
    """A steady flow, and how far a number of it is off."""
    (head, converged), seconds = clocked(lambda: seepage.steady(problem, initial))
    if not converged:
        raise ValueError(f"{case}: the steady flow did not converge")
    found = of(head)
    return {
        "case": case,
        "cells": math.prod(problem.shape),
        "reference": right,
        "found": found,
        "error": abs(found / right - 1),
        "seconds": seconds,
    }


def dupuit_rows(quick: bool) -> Iterator[Row]:
    """Discharge through a dam 12 m long from 10 to 2 m of water, with a seepage face above the lower level.

    The fringe of soil with alpha of 50/m, 2 cm high, carries little.
    """
    for n in (12,) if quick else (12, 48):
        dam = seepage.cells((12.0, 10.0), (n, n))
        soil = seepage.gardner(conductivity=1e-4, alpha=50.0, porosity=0.3)
        problem = seepage.problem(
            dam, soil, seepage.held_head("left", level=10.0), seepage.open_face("right", level=2.0)
        )
        right = exact.dupuit(1e-4, 10.0, 2.0, 12.0)
        yield steady_row(
            "Dupuit's dam",
            problem,
            seepage.hydrostatic(problem, 6.0),
            right,
            partial(inflow, problem),
        )


def drain_rows(quick: bool) -> Iterator[Row]:
    """Discharge of drains 10 m apart and 1 m deep in 2 m of soil, ponded to its surface."""
    for n in (10,) if quick else (10, 40):
        soil = gardner(1e-5, alpha=5.0)
        half = seepage.cells((10.0, 2.0), (5 * n + 1, n))
        z = float(half.centres()[-1, 0, n // 2])
        problem = seepage.problem(
            half,
            soil,
            seepage.held_head("surface", pressure_head=0.0),
            seepage.drain([(5.0, z)], radius=0.005),
        )
        right = exact.kirkham(1e-5, 2.0 - z, 2.0, 10.0, 0.005)
        yield steady_row("Kirkham's drains", problem, 0.5, right, partial(inflow, problem))


def parallel_row(quick: bool) -> Row:
    """Soil 4 m deep on a slope of 1 in 4, full of water that flows along it: pressure in its middle at 2 m of depth."""
    n = 40 if quick else 80
    box, edges = (20.0, 9.0), (n, int(4.5 * n / 5))
    x, z = seepage.cells(box, edges).centres()
    top, share = 9.0 - x / 4, 1 / (1 + 1 / 16)
    slope = seepage.cells(box, edges, active=(z < top) & (z > top - 4.0))

    def hydrostatic(at: np.ndarray) -> np.ndarray:
        return np.asarray((9.0 - at[0] / 4 - at[1]) * share)

    problem = seepage.problem(
        slope,
        gardner(1e-5),
        seepage.open_face(),
        seepage.held_head("left", pressure_head=hydrostatic),
        seepage.held_head("right", pressure_head=hydrostatic),
    )
    at = np.array([[9.0, 10.0, 11.0], [9.0 - 9 / 4 - 2, 9.0 - 10 / 4 - 2, 9.0 - 11 / 4 - 2]])
    return steady_row(
        "Infinite slope, parallel seepage",
        problem,
        jnp.asarray((top - z) * share),
        2 * share,
        lambda h: float(seepage.Heads.of(problem, h).at(at).mean()),
    )


def tracy_rows(quick: bool) -> Iterator[Row]:
    """A section and a solid wetted from the top: error of head, and order of it in the cell."""
    for d, counts in ((2, (8,)),) if quick else ((2, (8, 16, 32)), (3, (6, 12, 24))):
        edges, errors = (1.25,) * (d - 1) + (1.0,), []
        for n in counts:
            solid = seepage.cells(edges, (n,) * d)
            soil = seepage.gardner(conductivity=1e-5, alpha=2.0, porosity=0.45, residual=0.15, storage=0.0)
            sides: tuple[seepage.Side, ...] = ("left", "right", "front", "back")
            problem = seepage.problem(
                solid,
                soil,
                seepage.held_head("surface", pressure_head=exact.tracy_top(2.0, edges, -1.0)),
                seepage.held_head("base", pressure_head=-1.0),
                *(seepage.held_head(side, pressure_head=-1.0) for side in sides[: 2 * d - 2]),
            )
            (head, _), seconds = clocked(partial(seepage.steady, problem, -1.0))
            right = exact.tracy(2.0, 1e-5, 0.3, edges, -1.0, solid.centres().reshape(d, -1), 1e9)
            # Heads of the dry rim are logarithms of small numbers: the error of water content weighs them alike.
            wet = np.exp(2.0 * np.asarray(head).ravel()), np.exp(2.0 * right)
            errors.append(float(np.sqrt(np.mean((wet[0] - wet[1]) ** 2)) / wet[1].max()))
            order = math.log2(errors[-2] / errors[-1]) if len(errors) > 1 else None
            yield {
                "case": f"Tracy's {'section' if d == 2 else 'solid'}",
                "cells": n**d,
                "error": errors[-1],
                "order": order,
                "seconds": seconds,
            }


def order_rows(quick: bool) -> Iterator[Row]:
    """A manufactured steady head in loam, and rain of Srivastava and Yeh in equal steps: order in cell and step."""
    loam, errors = exact.Curves(2.89e-6, 3.6, 1.56, 0.43, 0.078), []
    for n in (16, 32) if quick else (16, 32, 64, 128):
        column = seepage.cells((1.0,), (n,))
        z = column.centres()[0]
        head, slope, bend = -1 - 0.5 * np.sin(3 * z), -1.5 * np.cos(3 * z), 4.5 * np.sin(3 * z)
        step = 1e-5
        by_head = (loam.k(head + step) - loam.k(head - step)) / (2 * step)
        source = -(by_head * slope * (slope + 1) + loam.k(head) * bend)
        problem = seepage.problem(
            column,
            same_soil(loam),
            seepage.held_head("surface", pressure_head=float(-1 - 0.5 * np.sin(3.0))),
            seepage.held_head("base", pressure_head=-1.0),
            source=jnp.asarray(source),
        )
        (found, _), seconds = clocked(partial(seepage.steady, problem, -1.0))
        errors.append(float(np.abs(np.asarray(found) - head).max()))
        order = math.log2(errors[-2] / errors[-1]) if len(errors) > 1 else None
        yield {
            "case": "manufactured, order in the cell",
            "cells": n,
            "error": errors[-1],
            "order": order,
            "seconds": seconds,
        }
    layers, errors = exact.Layered(10.0, [1.0], [CM_PER_HOUR], [0.34]), []
    column, made = rain_on(layers, 100)
    initial, _ = seepage.steady(made(0.1 * CM_PER_HOUR), -0.3)
    wet, end = made(0.9 * CM_PER_HOUR), 4 * 3600.0
    # The error of the cells is the same in all: a reference with steps that are far shorter takes it out.
    ends = [np.asarray(seepage.replay(wet, initial, np.full(n, end / n))[-1]) for n in (20, 40, 80, 160, 2560)]
    for n, found in zip((20, 40, 80, 160), ends, strict=False):
        errors.append(float(np.abs(found - ends[-1]).max()))
        order = math.log2(errors[-2] / errors[-1]) if len(errors) > 1 else None
        yield {"case": "equal steps, order in the step", "steps": n, "error": errors[-1], "order": order}


def hillside(nx: int, nz: int) -> tuple[seepage.Cells, seepage.VanGenuchten]:
    """A slope of 1 in 2 in sandy loam, 20 m long and 10 m high."""
    x, z = seepage.cells((20.0, 10.0), (nx, nz)).centres()
    slope = seepage.cells((20.0, 10.0), (nx, nz), active=z < np.clip(10.0 - (x - 4) / 2, 4.0, 10.0))
    return slope, seepage.soil_class("sandy loam")


def storm(slope: seepage.Cells, soil: seepage.VanGenuchten, rate: float) -> seepage.Problem:
    """Rain on the slope for half a day, then none, above groundwater that enters at the left end."""
    return seepage.problem(
        slope,
        soil,
        seepage.open_face(rain=([0.0, DAY / 2], [rate, 0.0])),
        seepage.held_head("left", level=4.0),
        seepage.open_face("right", level=2.0),
    )


def gradient_rows(quick: bool) -> Iterator[Row]:
    """Derivative of the mean pressure after a storm by conductivities, against differences over the same steps."""
    for name, cells in (("column", None), ("section", (12, 8))):
        if cells is None:
            column = seepage.cells((1.0,), (40,))
            problem = seepage.problem(
                column, seepage.soil_class("loam"), seepage.open_face(rain=5e-6), seepage.held_head("base", level=0.0)
            )
            initial: Any = seepage.hydrostatic(problem, 0.0)
        else:
            problem = storm(*hillside(*cells), 1e-6)
            initial = seepage.hydrostatic(problem, 3.0)
        flow = seepage.run(problem, initial, [DAY], tolerance=0.05).raise_if_failed()
        weight = problem.volume / jnp.sum(problem.volume)
        pattern = jnp.asarray(np.random.default_rng(7).normal(size=problem.shape))

        def mean(log: jax.Array, p=problem, h=initial, flow=flow, weight=weight) -> jax.Array:
            soil = replace(p.soil, conductivity=p.soil.conductivity * jnp.exp(log))
            return jnp.sum(weight * seepage.replay(replace(p, soil=soil), h, flow.durations)[-1])

        zero = jnp.zeros(problem.shape)
        start = time.process_time()
        slope = float(jnp.sum(jax.grad(mean)(zero) * pattern))
        seconds = time.process_time() - start
        step = 1e-4
        ahead, behind = float(mean(step * pattern)), float(mean(-step * pattern))
        wide = float(mean(2 * step * pattern)) - float(mean(-2 * step * pattern))
        right = (8 * (ahead - behind) - wide) / (12 * step)
        yield {
            "case": f"gradient, {name}",
            "cells": math.prod(problem.shape),
            "reference": right,
            "found": slope,
            "error": abs(slope / right - 1),
            "seconds": round(seconds, 2),
        }


def precision_rows(quick: bool) -> Iterator[Row]:
    """The storm on the slope in float32 against float64: largest difference of head."""
    heads = {}
    for name in ("float64", "float32"):
        with jax.enable_x64(name == "float64"):
            problem = storm(*hillside(20, 20), 1e-6)
            flow, seconds = clocked(partial(seepage.run, problem, seepage.hydrostatic(problem, 3.0), [DAY / 2, DAY]))
            flow.raise_if_failed()
            heads[name] = np.where(np.asarray(problem.active) > 0, np.asarray(flow.head, float), 0)
        error = float(np.abs(heads[name] - heads["float64"]).max())
        yield {
            "case": f"storm, {name}",
            "cells": 400,
            "error": error,
            "steps": int(flow.steps),
            "water_lost": lost(flow),
        } | {"seconds": seconds}


def extreme_rows(quick: bool) -> Iterator[Row]:
    """What is stiff or extreme: each converges, and loses no water."""
    column = seepage.cells((5.0,), (50,))
    sand, loam = seepage.soil_class("sand"), seepage.soil_class("loam")
    gravel = seepage.gardner(conductivity=1e-2, alpha=50.0, porosity=0.3)
    liner = seepage.gardner(conductivity=1e-10, alpha=0.5, porosity=0.4)
    z = column.centres()[0]
    layered = seepage.zoned([gravel, liner], ((z > 2) & (z < 3)).astype(int))
    falls = seepage.free_drainage()
    cases: dict[str, tuple[Any, Any, float, dict[str, float]]] = {
        "dry sand at -1000 m under rain": (sand, seepage.open_face(rain=1e-5), -1000.0, {}),
        "dry clay at -1000 m under rain": (seepage.soil_class("clay"), seepage.open_face(rain=1e-7), -1000.0, {}),
        "liner of 1e-10 m/s between gravel": (layered, seepage.open_face(rain=1e-7, ponding=0.1), -0.5, {}),
        "rain at ten times the conductivity": (
            loam,
            seepage.open_face(rain=10 * float(loam.conductivity)),
            -5.0,
            {},
        ),
        "evaporation of 5 mm a day for a month": (loam, seepage.open_face(rain=-5e-3 / DAY), -1.0, {}),
        "a step of a year": (loam, seepage.open_face(rain=1e-8), -1.0, {"tolerance": 10.0, "first_step": YEAR}),
    }
    for name, (soil, surface, initial, options) in cases.items():
        problem = seepage.problem(column, soil, surface, falls)
        end = YEAR if options else 30 * DAY if "month" in name else 10 * DAY
        settings: dict[str, Any] = options
        flow, seconds = clocked(partial(seepage.run, problem, initial, [end], **settings))
        status = seepage.FlowStatus(int(flow.status)).name
        tries = {"steps": int(flow.steps), "tries": int(flow.tries)}
        yield {"case": f"extreme: {name}", "status": status, **tries, "water_lost": lost(flow), "seconds": seconds}


def cost_rows(quick: bool) -> Iterator[Row]:
    """Seconds a sample of the storm with random conductivities, lanes together and one by one."""
    for name, shape in (("section", (20, 10) if quick else (100, 50)), ("solid", (50, 20, 40))):
        if quick and name == "solid":
            continue
        if name == "section":
            cells, soil = hillside(*shape)
        else:
            x, _, z = seepage.cells((20.0, 10.0, 10.0), shape).centres()
            active = z < np.clip(10.0 - (x - 4) / 2, 4.0, 10.0)
            cells, soil = seepage.cells((20.0, 10.0, 10.0), shape, active=active), seepage.soil_class("sandy loam")
        problem = storm(cells, soil, 1e-6)
        initial = seepage.hydrostatic(problem, 3.0)
        lanes = 2 if quick or name == "solid" else 4
        logs = np.random.default_rng(3).normal(size=(lanes, *shape)) * 0.5

        def one(log: jax.Array, p=problem, h=initial) -> seepage.Flow:
            soil = replace(p.soil, conductivity=p.soil.conductivity * jnp.exp(log))
            return seepage.run(replace(p, soil=soil), h, [DAY / 2, DAY], tolerance=0.02, max_steps=500)

        run = jax.jit(jax.vmap(lambda log, one=one: (lambda f: (f.status, f.steps, f.record.iterations))(one(log))))
        (status, steps, iterations), seconds = clocked(partial(run, jnp.asarray(logs)))
        yield {
            "case": f"storm on a {name}",
            "cells": math.prod(shape),
            "lanes": lanes,
            "done": int(np.sum(np.asarray(status) == seepage.FlowStatus.DONE)),
            "steps": int(np.max(steps)),
            "iterations": int(np.max(np.sum(iterations, axis=-1))),
            "seconds_per_sample": round(seconds / lanes, 2),
        }


FLOW: dict[str, Callable[[bool], Iterable[Row]]] = {
    "celia": celia_rows,
    "srivastava_yeh": srivastava_yeh_rows,
    "philip": philip_rows,
    "dupuit": dupuit_rows,
    "drains": drain_rows,
    "parallel": lambda quick: [parallel_row(quick)],
    "tracy": tracy_rows,
    "orders": order_rows,
    "gradients": gradient_rows,
    "precision": precision_rows,
    "extremes": extreme_rows,
    "surface": lambda quick: [free_surface_row(2.0 if quick else 1.0)],
    "cost": cost_rows,
}
"""Groups of rows about the flow alone."""
CAMPAIGNS: dict[str, Callable[[bool], Iterable[Row]]] = {
    "coverage": coverage_rows,
    "chart": chart_coverage_rows,
    "drawdown": lambda quick: [] if quick else drawdown_rows(),
    "rain_cost": rain_cost_rows,
}
"""Those about what a campaign makes of it."""
SINGLE = ("surface", "cost")
"""Groups of FLOW that begin in float32."""


def _made(make: Callable[[bool], Iterable[Row]], quick: bool, x64: bool) -> Row:
    with jax.enable_x64(x64):
        rows = list(make(quick))
    jax.clear_caches()
    return {"rows": rows}


def groups(quick: bool) -> dict[str, list[Row]]:
    """Rows of all groups, those that are done from out/seepage."""
    runs.keep_compiled()
    code = [path.read_text() for path in sorted(Path(__file__).parent.glob("seepage*.py"))]
    found = {}
    for made, folders in ((FLOW, ("jaxmpm/seepage",)), (CAMPAIGNS, ("jaxmpm", "kl", "cooperative"))):
        stored = ROOT / "out" / "seepage" / code_digest(*code, folders=folders)
        for name, make in made.items():
            print(f"{name} ...", file=sys.stderr, flush=True)
            x64 = made is FLOW and name not in SINGLE
            found[name] = stored_row(stored, f"{name}{' quick' if quick else ''}", partial(_made, make, quick, x64))[
                "rows"
            ]
    return found


def largest(rows: Iterable[Row], name: str = "error") -> float | None:
    """The largest of a column, whatever its sign; None without rows."""
    return max((abs(row[name]) for row in rows), default=None)


def run(quick: bool) -> Report:
    """All cases; each named figure is the largest error of its finest rows."""
    rows = groups(quick)
    finest = {row["case"]: row for row in (*rows["srivastava_yeh"], *rows["philip"])}
    last = {row["case"]: row for row in (*rows["tracy"], *rows["orders"])}
    balanced = [row for name in ("celia", "srivastava_yeh", "philip", "extremes") for row in rows[name]]
    values: dict[str, Any] = {
        "celia_front_error": rows["celia"][-1]["error"],
        "srivastava_yeh_error_max": largest(row for case, row in finest.items() if "Yeh" in case),
        "sorptivity_error_max": largest(row for case, row in finest.items() if "sorptivity" in case),
        "dupuit_discharge_error": rows["dupuit"][-1]["error"],
        "drain_discharge_error": rows["drains"][-1]["error"],
        "parallel_seepage_error": rows["parallel"][0]["error"],
        "order_in_cell_min": min(row["order"] for case, row in last.items() if "step" not in case and row["order"]),
        "order_in_step": last["equal steps, order in the step"]["order"],
        "water_balance_max": largest((*balanced, rows["precision"][0]), "water_lost"),
        "gradient_error": largest(rows["gradients"]),
        "float32_head_error_m": rows["precision"][-1]["error"],
        "free_surface_error": rows["surface"][0]["error"],
        "slow_drawdown_error_max": largest(rows["drawdown"]),
        "pf_in_time_coverage_min": min(row["coverage"] for row in rows["coverage"]),
        "chart_coverage_min": min(row["coverage"] for row in rows["chart"]),
        "rain_cost_ratio": rows["rain_cost"][-1]["ratio"],
        "extremes_not_done": sum(row["status"] != "DONE" for row in rows["extremes"]),
    }
    values |= {f"seconds_per_sample_{row['cells']}_cells": row["seconds_per_sample"] for row in rows["cost"]}
    return Report(values, [row for group in rows.values() for row in group])
