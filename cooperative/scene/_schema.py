"""What a scene may say: the keys of each of its tables, their names, types and defaults, and how a value is read."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import kl
from cooperative.estimate import ESTIMATORS
from foundation.text import shown
from jaxmpm import GIMP, Linear, PlasticStrain, QuadraticBSpline, Scheme, Soil

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
SAMPLED_AT = {"particles": "particles", "cells": "cells"}
Y_ENDS = {"fixed": "fixed", "roller": "roller"}
FIELDS = {"none": (), "refined": ("refined",), "both": ("rough", "refined")}
MODES = {"refined": ("refined",), "both": ("rough", "refined")}

REQUIRED = object()
"""The default of a key that has to be there."""
UNSAID = object()
"""The default of a key that the rest of the scene decides, where it is not there."""


@dataclass(frozen=True)
class Key:
    """What a key holds: a type, `choices` of names, or numbers per axis; its default; the word for having none."""

    kind: Any
    default: Any = REQUIRED
    none: str | None = None


_SLOPE = {name: Key(float) for name in ("crest", "height", "run_per_rise", "toe", "foundation")} | {
    "width": Key(float, None),
    "y_ends": Key(Y_ENDS, "fixed"),
}
_SOIL = {
    "unit_weight": Key(float),
    "young": Key(float),
    "poisson": Key(float),
    "softening_modulus": Key(float, None),
    "residual_ratio": Key(float, 1.0),
    "tension_cutoff": Key(float, None),
    "plastic_strain": Key(PLASTIC_STRAINS, "engineering"),
    "strain_95": Key(float, None),
    "softening_length": Key(float, UNSAID, none="cell"),
    "rate_coefficient": Key(float, None),
    "reference_rate": Key(float, Soil.reference_rate),
}
_STRENGTH = {
    "mean": Key(float),
    "cov": Key(float),
    "marginal": Key(MARGINALS, "lognormal"),
    "correlation": Key(CORRELATIONS, "squared exponential"),
    "length": Key(tuple),
    "energy": Key(float, 0.999),
    "sampled_at": Key(SAMPLED_AT, "particles"),
}
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
    "internal_length": Key(float, UNSAID, none="none"),
}
_RUN = {
    "gravity": Key(float, 9.81),
    "t_end": Key(float, 20.0),
    "failure_displacement": Key(float, 1.0),
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
DEFAULTS = {"cfl": Key(float)}
"""The table [defaults] of a stored scene: defaults of both grids that were others once, as they were at its start."""
SECTIONS = {
    "slope": _SLOPE,
    "soil": _SOIL,
    "strength": _STRENGTH,
    "rough": _GRID,
    "refined": _GRID,
    "run": _RUN,
    "campaign": _PLAN,
}


def read(section: str, table: Any, keys: Mapping[str, Key]) -> dict[str, Any]:
    """The values of a table, defaults where it does not say; ValueError for what its keys do not know or allow."""
    if not isinstance(table, dict):
        raise ValueError(f"{section} = {shown(table)} is {in_words(table)}: make it a table, [{section}]")
    refuse_unknown(f"[{section}]", table, keys)
    missing = [key for key, what in keys.items() if what.default is REQUIRED and key not in table]
    if missing:
        raise ValueError(f"[{section}] lacks {', '.join(missing)}: add it")
    return {
        key: _value(f"[{section}] {key}", table.get(key, what.default), what, key in table)
        for key, what in keys.items()
    }


def _value(where: str, value: Any, key: Key, given: bool) -> Any:
    kind = key.kind
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, dict):
        if not isinstance(value, str) or value not in kind:
            known = ", ".join(map(repr, kind))
            raise ValueError(f"{where} = {shown(value)}: give one of {known}{_nearest(value, kind)}")
        return kind[value]
    if not given:
        return value
    if key.none is not None and value == key.none:
        return None
    if any(isinstance(v, int) and not -(2**63) <= v < 2**63 for v in (value if isinstance(value, list) else [value])):
        raise ValueError(f"{where} is a whole number beyond 64 bits: give a smaller one")
    if kind in (float, tuple) and not all(_fits(v) for v in (value if isinstance(value, list) else [value])):
        raise ValueError(f"{where} = {shown(value)}: give finite values, in single precision (1e-30 to 1e30)")
    if kind is float and number:
        return float(value)
    if kind is int and number and isinstance(value, int):
        return value
    if kind in (bool, str) and isinstance(value, kind):
        return value
    if (
        kind is tuple
        and isinstance(value, list)
        and value
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
    ):
        return tuple(map(float, value))
    wanted = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "text",
        tuple: "a list of numbers, one per axis",
    }
    otherwise = "" if key.none is None else f", or {key.none!r}"
    raise ValueError(f"{where} = {shown(value)} is {in_words(value)}: give {wanted[kind]}{otherwise}")


def _fits(value: object) -> bool:
    """Whether single precision holds a number, with some room for products of it."""
    return not isinstance(value, float) or value == 0 or 1e-30 <= abs(value) <= 1e30


def refuse_unknown(where: str, table: Mapping[str, object], known: Mapping[str, object]) -> None:
    """Raise ValueError for the first key that is not known, naming the nearest one that is."""
    for key in table:
        if key not in known:
            meant = _nearest(key, known)
            raise ValueError(f"{where} has an unknown key {shown(key)}{meant}; it knows {', '.join(known)}")


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
