"""A campaign's scene: TOML in, checked once, typed values out. Nothing in the file is executed."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import kl
from jaxmpm import (
    GIMP,
    Discretisation,
    Linear,
    PlasticStrain,
    QuadraticBSpline,
    Scheme,
    Settle,
    Slope,
    Soil,
    cell_independent,
)

CORRELATIONS = {
    "squared exponential": kl.SquaredExponential,
    "exponential": kl.Exponential,
    "matern 3/2": kl.Matern32,
    "matern 5/2": kl.Matern52,
    "second-order markov": kl.SecondOrderMarkov,
    "cosine exponential": kl.CosineExponential,
    "triangular": kl.Triangular,
}
MARGINALS = {"lognormal": kl.Lognormal, "truncated normal": kl.TruncatedNormal}
COEFFICIENTS = {"latin hypercube": kl.latin_hypercube, "monte carlo": kl.monte_carlo, "sobol": kl.sobol}
KERNELS = {"gimp": GIMP, "linear": Linear, "quadratic b-spline": QuadraticBSpline}
SCHEMES = {scheme.name.lower(): scheme for scheme in Scheme}
PLASTIC_STRAINS = {measure.value: measure for measure in PlasticStrain}
Y_ENDS = {"fixed": "fixed", "roller": "roller"}
ESTIMATORS = {name: name for name in ("two-phase", "published", "control variate", "monte carlo", "subset")}
FIELDS = {"none": (), "refined": ("refined",), "both": ("rough", "refined")}
MODES = {"refined": ("refined",), "both": ("rough", "refined")}

REQUIRED = object()
UNSAID = object()
BAND = 1 / 5
"""Thickness of the band to which softening refers, over the slope's height, where a scene does not say."""


@dataclass(frozen=True)
class Strength:
    """The random field of undrained strength: mean (Pa), cov, and per axis a correlation length (m)."""

    mean: float
    cov: float
    marginal: type
    correlation: type
    length: tuple[float, ...]
    energy: float


@dataclass(frozen=True)
class Run:
    """How each sample runs: gravity (m/s2), t_end (s), what displacement is failure (m), when a lane has settled."""

    gravity: float
    t_end: float
    failure_displacement: float
    settle: Settle | None


@dataclass(frozen=True)
class Calibration:
    """Factors of safety of the homogeneous slope on both grids; the rough strength is multiplied by `factor`."""

    rough: float
    refined: float

    @property
    def factor(self) -> float:
        """Refined over rough factor of safety."""
        return self.refined / self.rough


@dataclass(frozen=True)
class Plan:
    """What the campaign does: samples and their coefficients, the stopping rule k_t, lanes of the screening.

    lanes: samples in one program at a time; None takes 1 on CPU, where lanes gain nothing, and 64 elsewhere.
    look_ahead: refined runs under way at once, in rank order; the answer depends on neither.
    estimator: "two-phase" audits the rough grid's answer; "published" stops at k_t and counts n/N; "control variate"
    and "monte carlo" refine the first samples; "subset" goes to rare failures by subset simulation on the rough grid,
    with `samples` per level in all `replicates`, and audits that. See `cooperative.designs`.
    refined_runs, target_cov: budget, and the coefficient of variation at which to stop before it is spent. Without
    either the budget is a fifth of the samples, at least 20 (all of them for "monte carlo").
    screening_stop: displacement (m) at which a rough lane is decided and ends, None runs it to its end.
    calibrate: measure the factors of safety of both grids first, and bring the rough strength down (or up) by them.
    restart_every: seconds of wall time after which a refined run writes a restart point, and again after as many.
    fields: grids whose final displacement and plastic strain are kept. modes: grids whose failures get a mode.
    """

    samples: int
    seed: int
    coefficients: Any
    k_t: int
    estimator: Literal["two-phase", "published", "control variate", "monte carlo", "subset"]
    refined_runs: int | None
    target_cov: float | None
    levels: int | None
    replicates: int | None
    lanes: int | None
    look_ahead: int
    screening_stop: float | None
    calibrate: bool
    restart_every: float
    fields: tuple[str, ...]
    modes: tuple[str, ...]


@dataclass(frozen=True)
class Config:
    """A checked scene. `text` is the TOML it came from; `calibration` its own table, where the factors are known."""

    text: str
    name: str
    slope: Slope
    y_ends: Literal["fixed", "roller"]
    soil: Soil
    strength: Strength
    grids: Mapping[str, Discretisation]
    run: Run
    plan: Plan
    calibration: Calibration | None = None


@dataclass(frozen=True)
class _Key:
    """What a key holds: a type, `choices` of names, or numbers per axis; its default; the word for having none."""

    kind: Any
    default: Any = REQUIRED
    none: str | None = None


_SLOPE = {name: _Key(float) for name in ("crest", "height", "run_per_rise", "toe", "foundation")} | {
    "width": _Key(float, None),
    "y_ends": _Key(Y_ENDS, "fixed"),
}
_SOIL = {
    "unit_weight": _Key(float),
    "young": _Key(float),
    "poisson": _Key(float),
    "softening_modulus": _Key(float, None),
    "residual_ratio": _Key(float, 1.0),
    "tension_cutoff": _Key(float, None),
    "plastic_strain": _Key(PLASTIC_STRAINS, "engineering"),
    "strain_95": _Key(float, None),
    "softening_length": _Key(float, UNSAID, none="cell"),
    "rate_coefficient": _Key(float, None),
    "reference_rate": _Key(float, Soil.reference_rate),
}
_STRENGTH = {
    "mean": _Key(float),
    "cov": _Key(float),
    "marginal": _Key(MARGINALS, "lognormal"),
    "correlation": _Key(CORRELATIONS, "squared exponential"),
    "length": _Key(tuple),
    "energy": _Key(float, 0.999),
}
_GRID = {
    "cell": _Key(float),
    "spacing": _Key(tuple),
    "kernel": _Key(KERNELS, "gimp"),
    "scheme": _Key(SCHEMES, "musl"),
    "cfl": _Key(float, 0.5),
    "flip": _Key(float, 1.0),
    "apic": _Key(bool, False),
    "damping": _Key(float, 0.0),
    "fbar": _Key(bool, UNSAID),
    "internal_length": _Key(float, UNSAID, none="none"),
}
_RUN = {
    "gravity": _Key(float, 9.81),
    "t_end": _Key(float, 20.0),
    "failure_displacement": _Key(float, 1.0),
    "settle": _Key(bool, True),
}
_PLAN = {
    "samples": _Key(int),
    "seed": _Key(int, 0),
    "coefficients": _Key(COEFFICIENTS, "latin hypercube"),
    "k_t": _Key(int),
    "estimator": _Key(ESTIMATORS, "two-phase"),
    "refined_runs": _Key(int, None),
    "target_cov": _Key(float, None),
    "levels": _Key(int, None),
    "replicates": _Key(int, None),
    "lanes": _Key(int, None),
    "look_ahead": _Key(int, 1),
    "screening_stop": _Key(float, None),
    "calibrate": _Key(bool, False),
    "restart_every": _Key(float, 600.0),
    "fields": _Key(FIELDS, "refined"),
    "modes": _Key(MODES, "refined"),
}
_CALIBRATION = {"rough": _Key(float), "refined": _Key(float)}
_SECTIONS = {
    "slope": _SLOPE,
    "soil": _SOIL,
    "strength": _STRENGTH,
    "rough": _GRID,
    "refined": _GRID,
    "run": _RUN,
    "campaign": _PLAN,
}


def parse(text: str) -> Config:
    """Read and check a scene.

    Raises ValueError for TOML that does not parse, unknown keys (naming the nearest one), missing keys, wrong
    types and values out of range. What depends on the geometry is checked when the grids are built.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"the scene is not valid TOML: {error}") from error
    name = tables.pop("name", "campaign")
    if not isinstance(name, str):
        raise ValueError(f"name = {name!r} is {_article(name)}: give text in quotes")
    if "sweep" in tables:
        raise ValueError("the scene has a table [sweep], so it is many campaigns: run it as a sweep")
    _refuse_unknown("the scene", tables, {**_SECTIONS, "calibration": None, "name": None})
    read = {section: _read(section, tables.get(section, {}), keys) for section, keys in _SECTIONS.items()}
    slope, y_ends = read["slope"], read["slope"].pop("y_ends")
    plan, run, strength = read["campaign"], read["run"], read["strength"]
    soil = _soil({**read["soil"], "strength": strength["mean"]}, slope["height"])
    config = Config(
        text=text,
        name=name,
        slope=Slope(**slope),
        y_ends=y_ends,
        soil=soil,
        strength=Strength(**strength),
        grids={grid: _grid(read[grid], soil) for grid in ("rough", "refined")},
        run=Run(**{**run, "settle": Settle() if run["settle"] else None}),
        plan=Plan(**plan),
        calibration=(
            Calibration(**_read("calibration", tables["calibration"], _CALIBRATION))
            if "calibration" in tables
            else None
        ),
    )
    _check(config)
    return config


def _soil(table: dict[str, Any], height: float) -> Soil:
    """Softening refers to a band of known thickness, unless the scene has it follow the cell."""
    if table["softening_length"] is not UNSAID:
        return Soil(**table)
    soil = Soil(**{**table, "softening_length": None})
    return replace(soil, softening_length=BAND * height) if soil.softens else soil


def _grid(table: dict[str, Any], soil: Soil) -> Discretisation:
    """Answers do not follow the cell, unless the scene says so."""
    said = {key: value for key, value in table.items() if value is not UNSAID}
    return replace(cell_independent(Discretisation(**said, dtype="float32"), soil), **said)


def _read(section: str, table: Any, keys: Mapping[str, _Key]) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise ValueError(f"{section} = {table!r} is {_article(table)}: make it a table, [{section}]")
    _refuse_unknown(f"[{section}]", table, keys)
    missing = [key for key, what in keys.items() if what.default is REQUIRED and key not in table]
    if missing:
        raise ValueError(f"[{section}] lacks {', '.join(missing)}: add it")
    return {
        key: _value(f"[{section}] {key}", table.get(key, what.default), what, key in table)
        for key, what in keys.items()
    }


def _value(where: str, value: Any, key: _Key, given: bool) -> Any:
    kind = key.kind
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, dict):
        if not isinstance(value, str) or value not in kind:
            raise ValueError(f"{where} = {value!r}: give one of {', '.join(map(repr, kind))}{_nearest(value, kind)}")
        return kind[value]
    if not given:
        return value
    if key.none is not None and value == key.none:
        return None
    if kind is float and number:
        return float(value)
    if kind is int and number and isinstance(value, int):
        return value
    if kind is bool and isinstance(value, bool):
        return value
    if (
        kind is tuple
        and isinstance(value, list)
        and value
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
    ):
        return tuple(map(float, value))
    wanted = {float: "a number", int: "a whole number", bool: "true or false", tuple: "a list of numbers, one per axis"}
    otherwise = "" if key.none is None else f", or {key.none!r}"
    raise ValueError(f"{where} = {value!r} is {_article(value)}: give {wanted[kind]}{otherwise}")


def _refuse_unknown(where: str, table: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    for key in table:
        if key not in known:
            raise ValueError(f"{where} has an unknown key {key!r}{_nearest(key, known)}; it knows {', '.join(known)}")


def _nearest(word: Any, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(str(word), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _article(value: Any) -> str:
    names = {
        str: "text",
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        list: "a list",
        dict: "a table",
    }
    return names.get(type(value), f"a {type(value).__name__}")


def _check(config: Config) -> None:
    """Ranges that no builder looks at."""
    config.slope.check()
    strength, run, plan, dimension = config.strength, config.run, config.plan, config.slope.dimension
    for name, value in (
        ("[strength] mean", strength.mean),
        ("[run] t_end", run.t_end),
        ("[run] gravity", run.gravity),
        ("[run] failure_displacement", run.failure_displacement),
        ("[campaign] restart_every", plan.restart_every),
        *((f"[calibration] {grid}", factor) for grid, factor in vars(config.calibration or Calibration(1, 1)).items()),
        *((f"[strength] length of axis {axis}", length) for axis, length in enumerate(strength.length)),
    ):
        if not 0 < value < float("inf"):
            raise ValueError(f"{name} = {value:g}: give a finite value above 0")
    if len(strength.length) != dimension:
        raise ValueError(f"[strength] length has {len(strength.length)} values: give {dimension}, one per axis")
    if not 0 <= strength.cov < float("inf"):
        raise ValueError(f"[strength] cov = {strength.cov:g}: give a coefficient of variation of 0 or more")
    if not 0 < strength.energy <= 1:
        raise ValueError(f"[strength] energy = {strength.energy:g}: give a share of the variance above 0, up to 1")
    for name, value in (
        ("samples", plan.samples),
        ("k_t", plan.k_t),
        ("lanes", 1 if plan.lanes is None else plan.lanes),
        ("look_ahead", plan.look_ahead),
    ):
        if value < 1:
            raise ValueError(f"[campaign] {name} = {value}: give 1 or more")
    _check_estimator(plan)
    if plan.refined_runs is not None and plan.refined_runs < 10:
        raise ValueError(f"[campaign] refined_runs = {plan.refined_runs}: give 10 or more, the audit needs some")
    if plan.estimator == "two-phase" and plan.samples < 10:
        raise ValueError(
            f"[campaign] samples = {plan.samples}: give 10 or more for the audit, or estimator = 'published'"
        )
    if plan.target_cov is not None and not 0 < plan.target_cov < 1:
        raise ValueError(f"[campaign] target_cov = {plan.target_cov:g}: give a value above 0 and below 1")
    if plan.seed < 0:
        raise ValueError(f"[campaign] seed = {plan.seed}: give 0 or more")
    if plan.screening_stop is not None and plan.screening_stop < run.failure_displacement:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m is below the failure displacement of "
            f"{run.failure_displacement:g} m: give more, or leave it out"
        )
    if plan.screening_stop is not None and "rough" in plan.modes:
        raise ValueError(
            f"[campaign] screening_stop = {plan.screening_stop:g} m ends rough runs before their mode shows: "
            "leave it out, or modes = 'both'"
        )


def _check_estimator(plan: Plan) -> None:
    """What goes with which estimator."""
    if plan.estimator == "published" and (plan.refined_runs is not None or plan.target_cov is not None):
        raise ValueError(
            "[campaign] refined_runs and target_cov do not rule estimator = 'published', k_t does: leave them out"
        )
    if plan.estimator != "subset":
        for name, value in (("levels", plan.levels), ("replicates", plan.replicates)):
            if value is not None:
                raise ValueError(f"[campaign] {name} = {value} is for estimator = 'subset': leave it out")
        return
    replicates = 8 if plan.replicates is None else plan.replicates
    if replicates < 2 or (plan.levels is not None and plan.levels < 1):
        raise ValueError(f"[campaign] replicates = {replicates}, levels = {plan.levels}: give 2 or more, 1 or more")
    if plan.samples % (10 * replicates) or plan.samples < 20 * replicates:
        raise ValueError(
            f"[campaign] samples = {plan.samples} per level with {replicates} replicates: give a multiple of "
            f"{10 * replicates}, at least {20 * replicates}"
        )
    if plan.screening_stop is not None:
        raise ValueError("[campaign] screening_stop cuts off what subset simulation ranks by: leave it out")
