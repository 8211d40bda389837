"""What a scene may say: the keys of each of its tables, their names, types and defaults, and how a value is read."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import kl
from cooperative.estimate import ESTIMATORS
from foundation.text import shown
from jaxmpm import (
    GIMP,
    Decay,
    DruckerPrager,
    Linear,
    Matching,
    MohrCoulomb,
    PlasticStrain,
    QuadraticBSpline,
    Scheme,
    Soil,
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
MARGINALS = {
    "lognormal": kl.Lognormal,
    "truncated normal": kl.TruncatedNormal,
    "normal": kl.Normal,
    "uniform": kl.Uniform,
    "beta": kl.Beta,
    "gamma": kl.Gamma,
    "weibull": kl.Weibull,
    "gumbel": kl.Gumbel,
}
COEFFICIENTS = {"latin hypercube": kl.latin_hypercube, "monte carlo": kl.monte_carlo, "sobol": kl.sobol}
KERNELS = {"gimp": GIMP, "linear": Linear, "quadratic b-spline": QuadraticBSpline}
SCHEMES = {scheme.name.lower(): scheme for scheme in Scheme}
CRITERIA = {"mohr-coulomb": MohrCoulomb, "drucker-prager": DruckerPrager}
MATCHINGS = {matching.value: matching for matching in Matching}
DECAYS = {decay.name.lower(): decay for decay in Decay}
PLASTIC_STRAINS = {measure.value: measure for measure in PlasticStrain}
SAMPLED_AT = {"particles": "particles", "cells": "cells"}
Y_ENDS = {"fixed": "fixed", "roller": "roller"}
ENDS = {"roller": "roller", "fixed": "fixed"}
SECTION_ENDS = ENDS | {"left fixed": "left fixed", "right fixed": "right fixed"}
CUTS = {"fixed": "fixed", "free": "free"}
FIELDS = {"none": (), "refined": ("refined",), "both": ("rough", "refined")}
FAILURES = {"displacement": "displacement", "limit load": "limit load"}
MODES = {"refined": ("refined",), "both": ("rough", "refined")}

REQUIRED = object()
"""The default of a key that has to be there."""
UNSAID = object()
"""The default of a key that the rest of the scene decides, where it is not there."""

LINE = "line"
"""The kind of a key that holds points [x, z], or names a file of them."""
RASTER = "raster"
"""The kind of a key that names a file of heights."""
ROWS, NAMES, COUNTS = tuple[tuple[float, ...], ...], tuple[str, ...], tuple[int, ...]
"""Kinds of keys: a list of lists of numbers, a list of texts, and a list of whole numbers."""


@dataclass(frozen=True)
class Table:
    """The kind of a key that holds a table of its own."""

    keys: Mapping[str, Key]


@dataclass(frozen=True)
class Key:
    """What a key holds: a type, `choices` of names, numbers per axis, or a `Table`; its default; the word for having
    none. or_table: that it may hold instead of a number. infinite: whether a number may be inf. words:
    that it may hold instead of a number."""

    kind: Any
    default: Any = REQUIRED
    none: str | None = None
    or_table: Table | None = None
    infinite: bool = False
    words: tuple[str, ...] = ()


_SLOPE = {name: Key(float) for name in ("crest", "height", "run_per_rise", "toe", "foundation")} | {
    "width": Key(float, None),
    "y_ends": Key(Y_ENDS, "fixed"),
}
_GROUND = {
    "surface": Key(LINE),
    "base": Key(float, 0.0),
    "walls": Key(tuple, None),
    "toe": Key(float, None),
    "crest": Key(float, None),
    "ends": Key(SECTION_ENDS, "roller"),
    "interface": Key(Table({"friction": Key(float), "cohesion": Key(float, 0.0)}), None),
}
_TERRAIN = {
    "surface": Key(RASTER),
    "base": Key(float),
    "x": Key(tuple, None),
    "y": Key(tuple, None),
    "step": Key(float, None),
    "origin": Key(tuple, None),
    "ends": Key(ENDS, "roller"),
    "polygon": Key(ROWS, None),
    "depth": Key(float, None),
    "cut": Key(CUTS, "fixed"),
    "run_out_line": Key(ROWS, None),
}
_WATER = {
    "level": Key(float, None),
    "table": Key(LINE, None),
    "raster": Key(RASTER, None),
    "depth": Key(float, None),
    "r_u": Key(float, None),
}
_FIELD = {
    "mean": Key(float),
    "cov": Key(float),
    "marginal": Key(MARGINALS, "lognormal"),
    "correlation": Key(CORRELATIONS, "squared exponential"),
    "length": Key(tuple, infinite=True),
    "energy": Key(float, 0.999),
    "sampled_at": Key(SAMPLED_AT, "particles"),
    "lower": Key(float, None),
    "upper": Key(float, None),
    "trend": Key(float, None),
    "trend_from": Key(float, "surface", words=("surface", "layer")),
    "bedding": Key(Table({"dip": Key(float), "strike": Key(float, 90.0)}), None),
    "nataf": Key(bool, False),
    "boreholes": Key(ROWS, None),
    "borehole_error": Key(float, 0.0),
}


def _random(default: Any) -> Key:
    """A parameter of the soil: a number, or a table that says how it varies."""
    return Key(float, default, or_table=Table(_FIELD))


_SOIL = {
    "unit_weight": _random(REQUIRED),
    "saturated_unit_weight": Key(float, None),
    "young": _random(REQUIRED),
    "poisson": _random(REQUIRED),
    "strength": _random(None),
    "strength_ratio": _random(None),
    "strength_minimum": Key(float, None),
    "softening_modulus": _random(None),
    "residual_ratio": _random(1.0),
    "tension_cutoff": Key(float, None),
    "gap_memory": Key(bool, True),
    "plastic_strain": Key(PLASTIC_STRAINS, "engineering"),
    "strain_95": _random(None),
    "softening_length": Key(float, UNSAID, none="cell"),
    "rate_coefficient": _random(None),
    "reference_rate": Key(float, Soil.reference_rate),
    "cohesion": _random(None),
    "friction": _random(None),
    "dilation": _random(0.0),
    "criterion": Key(CRITERIA, "mohr-coulomb"),
    "matching": Key(MATCHINGS, "plane strain"),
    "residual_cohesion": _random(0.0),
    "residual_friction": _random(0.0),
    "softening_strain": _random(None),
    "decay": Key(DECAYS, "linear"),
    "unusual": Key(bool, False),
}
OF_A_FIELD = ("length", "correlation", "energy", "bedding", "nataf", "boreholes", "borehole_error")
"""What a layer says only of a field of its own, which stops at it: its length at least."""
_LAYER_FIELD = {
    name: replace(_FIELD[name], default=UNSAID)
    for name in ("mean", "cov", "marginal", "lower", "upper", "trend", "trend_from", *OF_A_FIELD)
}
"""What a layer may say of a parameter that varies."""
_LAYER = {
    "name": Key(str, None),
    "bottom": Key(LINE, None),
    "raster": Key(RASTER, None),
    "depth": Key(float, None),
    "thickness": Key(float, None),
    "rock": Key(bool, False),
} | {
    name: Key(key.kind, UNSAID, key.none, None if key.or_table is None else Table(_LAYER_FIELD))
    for name, key in _SOIL.items()
}
_CROSS_CORRELATION = {"parameters": Key(NAMES), "matrix": Key(ROWS), "nataf": Key(bool, False)}
_GRID = {
    "cell": Key(float),
    "spacing": Key(tuple),
    "kernel": Key(KERNELS, "gimp"),
    "scheme": Key(SCHEMES, "musl"),
    "cfl": Key(float, 0.9),
    "flip": Key(float, 1.0),
    "apic": Key(bool, False),
    "damping": Key(float, 0.0),
    "fbar": Key(bool, UNSAID),
    "cell_average": Key(bool, UNSAID),
    "internal_length": Key(float, UNSAID, none="none"),
    "air": Key(float, UNSAID),
}
_RUN = {
    "gravity": Key(float, 9.81),
    "t_end": Key(float, 20.0),
    "slides_t_end": Key(float, None),
    "failure": Key(FAILURES, "displacement"),
    "failure_displacement": Key(float, 1.0),
    "least_volume": Key(float, None),
    "settle": Key(bool, True),
    "rest": Key(bool, UNSAID),
}
_PLAN = {
    "samples": Key(int),
    "seed": Key(int, 0),
    "coefficients": Key(COEFFICIENTS, "latin hypercube"),
    "k_t": Key(int, None),
    "estimator": Key({name: name for name in ESTIMATORS}, "two-phase"),
    "refined_runs": Key(int, None),
    "target_cov": Key(float, None),
    "levels": Key(int, None),
    "replicates": Key(int, None),
    "lanes": Key(int, None),
    "look_ahead": Key(int, 1),
    "screening_stop": Key(float, None),
    "calibrate": Key(bool, False),
    "restart_every": Key(float, 600.0),
    "fields": Key(FIELDS, "refined"),
    "modes": Key(MODES, "refined"),
    "slides": Key(int, None, none="all"),
}
GIVEN = {"given": Key(str)}
"""The table [estimator] of a stored scene, whose estimator a script gave: how it describes itself."""
CALIBRATION = {"rough": Key(float), "refined": Key(float)}
LIMIT_LOAD = {"factor": Key(float), "displacement": Key(float), "volume": Key(float, None)}
FIELD_MODES = {"counts": Key(COUNTS)}
DEFAULTS = {"cfl": Key(float), "gap_memory": Key(bool, False)}
"""The table [defaults] of a stored scene: defaults of both grids and of the soil that were others once, as they were at
its start. A key that it lacks is younger than the campaign."""
SITES = ("slope", "ground", "terrain")
"""Tables of which a scene has one: it says what ground there is."""
OF_GROUND = ("layer", "water")
"""Tables that a scene may have that draws its own ground."""
LISTS = ("layer",)
"""Tables of which there may be several: `[[layer]]`."""
SECTIONS: dict[str, dict[str, Key]] = {
    "slope": _SLOPE,
    "ground": _GROUND,
    "terrain": _TERRAIN,
    "layer": _LAYER,
    "water": _WATER,
    "soil": _SOIL,
    "strength": _FIELD,
    "cross_correlation": _CROSS_CORRELATION,
    "rough": _GRID,
    "refined": _GRID,
    "run": _RUN,
    "campaign": _PLAN,
}
OPTIONAL = ("strength", "cross_correlation", *SITES, *OF_GROUND)
"""Tables that a scene may do without."""


def read(section: str, table: Any, keys: Mapping[str, Key]) -> dict[str, Any]:
    """The values of a table, defaults where it does not say; ValueError for what its keys do not know or allow."""
    if wrong := wrong_keys(section, table, keys):
        raise ValueError("; ".join(wrong))
    return {key: _value(section, key, table.get(key, what.default), what, key in table) for key, what in keys.items()}


def wrong_keys(section: str, table: Any, keys: Mapping[str, Key]) -> list[str]:
    """What is wrong with the keys of a table, in words: those that are not known, and those that lack."""
    if not isinstance(table, dict):
        return [f"{section} = {shown(table)} is {in_words(table)}: make it a table, [{section}]"]
    missing = [key for key, what in keys.items() if what.default is REQUIRED and key not in table]
    lacks = [f"[{section}] lacks {', '.join(missing)}: add it"] if missing else []
    return unknown_keys(f"[{section}]", table, keys) + lacks


def _value(section: str, name: str, value: Any, key: Key, given: bool) -> Any:
    kind, where = key.kind, f"[{section}] {name}"
    if value is UNSAID:
        return value
    if isinstance(kind, dict):
        if not isinstance(value, str) or value not in kind:
            known = ", ".join(map(repr, kind))
            raise ValueError(f"{where} = {shown(value)}: give one of {known}{_nearest(value, kind)}")
        return kind[value]
    if not given:
        return value
    if key.none is not None and value == key.none:
        return None
    if isinstance(value, str) and value in key.words:
        return value
    table = kind if isinstance(kind, Table) else key.or_table if isinstance(value, dict) else None
    if table is not None:
        return read(f"{section}.{name}", value, table.keys)
    if kind == LINE:
        return _line(where, value)
    if kind == RASTER and isinstance(value, str):
        return value
    numbers = list(_leaves(value))
    if any(isinstance(v, int) and not -(2**63) <= v < 2**63 for v in numbers):
        raise ValueError(f"{where} is a whole number beyond 64 bits: give a smaller one")
    if kind in (float, tuple, ROWS) and not all(_fits(v) or (key.infinite and v == math.inf) for v in numbers):
        raise ValueError(f"{where} = {shown(value)}: give finite values, in single precision (1e-30 to 1e30)")
    if kind is float and _is_number(value):
        return float(value)
    if kind is int and _is_number(value) and isinstance(value, int):
        return value
    if kind in (bool, str, list) and isinstance(value, kind):
        return value
    if kind is tuple and _is_list(value, _is_number):
        return tuple(map(float, value))
    if kind == ROWS and _is_list(value, lambda row: _is_list(row, _is_number)):
        return tuple(tuple(map(float, row)) for row in value)
    if kind == NAMES and _is_list(value, lambda name: isinstance(name, str)):
        return tuple(value)
    if kind == COUNTS and _is_list(value, lambda count: _is_number(count) and isinstance(count, int)):
        return tuple(value)
    otherwise = "".join(f", or {word!r}" for word in ([] if key.none is None else [key.none]) + [*key.words])
    otherwise += "" if key.or_table is None else ", or a table that says how it varies"
    raise ValueError(f"{where} = {shown(value)} is {in_words(value)}: give {_WANTED[kind]}{otherwise}")


_WANTED = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "text",
    tuple: "a list of numbers, one per axis",
    list: "a list",
    ROWS: "a list of lists of numbers",
    NAMES: "a list of texts",
    COUNTS: "a list of whole numbers",
    RASTER: "the name of a file of heights",
}


def _leaves(value: object) -> Iterator[object]:
    """What lists hold that are no lists."""
    if isinstance(value, list):
        for each in value:
            yield from _leaves(each)
    else:
        yield value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(value: object, of: Callable[[Any], bool]) -> bool:
    """Whether a value is a list, not empty, of such things."""
    return isinstance(value, list) and bool(value) and all(map(of, value))


def _is_finite(value: object) -> bool:
    return _is_number(value) and (value == 0 or 1e-30 <= abs(value) <= 1e30)  # type: ignore[arg-type]


def _line(where: str, value: Any) -> Any:
    """Points as tuples, or the name of a file."""
    if isinstance(value, str):
        return value
    if not isinstance(value, list) or len(value) < 2:
        raise ValueError(f"{where} = {shown(value)}: give points [[x, z], ...], two or more, or the name of a file")
    for number, point in enumerate(value, 1):
        if not (isinstance(point, list) and len(point) == 2 and all(map(_is_finite, point))):
            raise ValueError(f"{where}: point {number} is {shown(point)}: give [x, z] in metres, two finite numbers")
    return tuple((float(x), float(z)) for x, z in value)


def _fits(value: object) -> bool:
    """Whether single precision holds a number, with some room for products of it."""
    return not isinstance(value, float) or value == 0 or 1e-30 <= abs(value) <= 1e30


def unknown_keys(where: str, table: Mapping[str, object], known: Mapping[str, object]) -> list[str]:
    """What to say of each key that is not known: the nearest one that is, or all that are."""
    said = []
    for key in table:
        if key not in known:
            meant = _meant(key, known)
            said.append(f"{where} has an unknown key {shown(key)}" + (meant or f"; it knows {', '.join(known)}"))
    return said


MEANT = {
    "run_per_rise": "slope_ratio ratio angle slope_angle inclination cotangent",
    "length": "lx ly lz theta scale_of_fluctuation correlation_length correlation_lengths",
    "young": "e youngs_modulus young_modulus modulus stiffness",
    "poisson": "nu poisson_ratio poissons_ratio",
    "unit_weight": "gamma density rho weight",
    "saturated_unit_weight": "gamma_sat saturated_weight wet_unit_weight",
    "friction": "phi friction_angle",
    "cohesion": "c",
    "dilation": "psi dilatancy",
    "mean": "su s_u cu undrained_strength shear_strength average",
    "cov": "sd std sigma deviation coefficient_of_variation",
    "strain_95 (exponential) or softening_modulus (linear)": "softening exponential_softening linear_softening",
    "residual_ratio": "residual residual_strength",
    "cell": "h dx cell_size grid_size mesh_size",
    "spacing": "ppc particles_per_cell particle_size particles",
    "cfl": "dt time_step timestep",
    "t_end": "duration end_time total_time",
    "samples": "n count number runs realisations realizations",
    "failure_displacement": "threshold criterion limit",
    "foundation": "base_thickness bedrock_depth",
    "surface": "points polyline profile coordinates",
    "refined_runs": "budget",
}
"""Words of engineers and of other programs, by the key that they stand for here."""
WORDS = {word: key for key, words in MEANT.items() for word in words.split()}


def _meant(key: str, known: Mapping[str, object]) -> str:
    """What an unknown key may have meant, in words; empty where nothing is near."""
    word = WORDS.get(key.lower())
    if word is not None and word.split()[0] in known:
        return f" (did you mean {word if ' ' in word else repr(word)}?)"
    elsewhere = next((section for section, keys in SECTIONS.items() if (word or key) in keys), None)
    if elsewhere is not None:
        return f" (did you mean {word or key!r} of [{elsewhere}]?)"
    return _nearest(key, known)


def _nearest(word: object, known: Mapping[str, object]) -> str:
    close = difflib.get_close_matches(str(word), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def in_words(value: object) -> str:
    """What kind of TOML value this is."""
    names = {
        str: "text",
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        list: "a list",
        dict: "a table",
    }
    return names.get(type(value), f"a {type(value).__name__}")
