"""The soil of a scene: numbers, and the parameters that vary as random fields; units that betray a slip."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

import kl
from cooperative.scene._schema import UNSAID
from foundation.text import shown
from jaxmpm import Believed, FrictionalSoil, Soil, soil_limits, unit_slip

BAND = 1 / 5
"""Thickness of the band to which softening refers, over the slope's height, where a scene does not say."""

TAIL = 4.0
"""Deviations from the middle of a field up to which its values must be within their limits: beyond lie 3 points in
100,000 on either side."""


LIMITS = soil_limits()

COV = Believed(most=3.0, above="it is a share, 1 for 100 per cent; were per cent meant?")
"""Coefficients of variation that are believed."""

_PER_METRE = "were kPa or MPa per metre meant?"
TRENDS = {
    "strength": Believed("Pa per metre", 50.0, _PER_METRE),
    "cohesion": Believed("Pa per metre", 50.0, _PER_METRE),
    "young": Believed("Pa per metre", 1e4, _PER_METRE),
    "unit_weight": Believed("N/m3 per metre", 1.0, "were kN/m3 per metre meant?"),
    "softening_modulus": Believed("Pa per metre", 50.0, _PER_METRE),
    "residual_cohesion": Believed("Pa per metre", 50.0, _PER_METRE),
}
"""Trends with depth that are believed, upwards or downwards."""

SOFTENED_BY = {
    "residual_ratio": ("softening_modulus", "strain_95"),
    "residual_cohesion": ("softening_strain",),
    "residual_friction": ("softening_strain",),
}
"""What is left of strength, and what else soil has that softens."""

OF_CLAY, OF_FRICTION = (
    tuple(each.name for each in fields(kind) if each.name not in {other.name for other in fields(beside)})
    for kind, beside in ((Soil, FrictionalSoil), (FrictionalSoil, Soil))
)
"""Keys of the soil that only undrained clay, or only soil with friction, has a use for."""


Span = tuple[float, float]
"""Elevations (m) of the base and of the highest point of ground."""


@dataclass(frozen=True)
class RandomField:
    """A parameter of the soil that varies: mean, cov, and per axis a correlation length (m; inf: constant along it).

    In the parameter's unit, angles in degrees. sampled_at: "particles", or "cells" for one value per cell of the
    background grid, that at its centre: then the grid of the field is the background grid, and all particles that
    start in a cell are alike. lower, upper: bounds of marginals that have some. trend: what mean and deviation, in
    proportion, grow by per metre of depth, from `mean` at depth 0. trend_from: where that is, at the "surface" of the
    ground, which follows the face of a cut, at the top of the "layer", or at an elevation (m), above which soil has no
    trend. bedding: of inclined strata; lengths are
    then down the dip, along strike and across. nataf: whether the parameter, not the Gaussian field behind it, has the
    correlation along each axis. boreholes: measured values, each a place (m) and the value there; borehole_error: their
    deviation, in standard deviations of the field.
    """

    mean: float
    cov: float
    marginal: type
    correlation: type
    length: tuple[float, ...]
    energy: float
    sampled_at: Literal["particles", "cells"]
    lower: float | None = None
    upper: float | None = None
    trend: float | None = None
    bedding: kl.Bedding | None = None
    nataf: bool = False
    boreholes: tuple[tuple[float, ...], ...] | None = None
    borehole_error: float = 0.0
    trend_from: Literal["surface", "layer"] | float = "surface"

    @property
    def distribution(self) -> Any:
        """The marginal, of the parameter at depth 0 where it has a trend."""
        bounds = {"lower": self.lower, "upper": self.upper}
        return self.marginal(self.mean, self.cov, **{end: at for end, at in bounds.items() if at is not None})

    @property
    def covariance(self) -> tuple[Any, ...]:
        """The correlation functions of the Gaussian field, one per axis."""
        plain = tuple(kl.Infinite() if length == math.inf else self.correlation(length) for length in self.length)
        if not self.nataf:
            return plain
        return tuple(
            axis if isinstance(axis, kl.Infinite) else kl.nataf_corrected(axis, self.distribution) for axis in plain
        )

    def deepest(self, span: Span) -> float:
        """Largest depth (m) of ground between two elevations, as the trend counts it."""
        base, top = span
        return (top if isinstance(self.trend_from, str) else self.trend_from) - base

    def grown(self, depth: Any) -> Any:
        """Mean at a depth (m) over that at depth 0."""
        return 1.0 if self.trend is None else 1.0 + self.trend / self.mean * depth


class StrengthByStress(NamedTuple):
    """Undrained strength as a ratio of the effective vertical stress at rest, of `minimum` (Pa) at least."""

    ratio: float
    minimum: float


@dataclass(frozen=True)
class CrossCorrelation:
    """Parameters that vary together. matrix: their correlation, row by row. nataf: whether it is that of the parameters
    themselves, else that of the Gaussian fields behind them."""

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    nataf: bool = False


def soil_of(
    table: Mapping[str, Any],
    given: Collection[str],
    strength: Mapping[str, Any] | None,
    *,
    height: float,
    span: Span,
    must_vary: bool = True,
) -> tuple[Soil | FrictionalSoil, Mapping[str, RandomField]]:
    """The soil with the means of what varies, and the fields by parameter.

    table: values of `[soil]`. given: the keys that the scene says. strength: values of `[strength]`, None without.
    height: of the slope (m). span: of the ground. must_vary: whether something has to. Raises
    ValueError for parameters that no soil has, that do not go together or whose numbers betray another unit, and for
    fields whose values leave their limits.
    """
    said, random = {**table}, {}
    unusual, places = said["unusual"], {name: f"[soil.{name}]" for name in said}
    if strength is not None:
        if said["strength"] is not None:
            raise ValueError("both [strength] and [soil] strength are given: leave one of them out")
        said["strength"], places["strength"] = dict(strength), "[strength]"
    _check_kind(said, given)
    for name, value in said.items():
        if isinstance(value, Mapping):
            random[name] = _field(places[name], value)
            _check_field(places[name], name, random[name], span, unusual)
            said[name] = random[name].mean
        elif name in LIMITS and isinstance(value, float):
            _check_number(f"[soil] {name}", name, value, unusual)
    for name, others in SOFTENED_BY.items():
        if name in random and all(said[other] is None for other in others):
            raise ValueError(
                f"{places[name]} varies, but the soil does not soften: add {' or '.join(others)} to [soil], or leave "
                "it out"
            )
    _check_saturated(said, random, unusual)
    if must_vary and not random:
        raise ValueError(
            "nothing in the scene is random: give at least one parameter of the soil as a table, such as "
            "[soil.cohesion] with mean, cov and length"
        )
    _check_friction(said, random, span)
    return _built(said, height), MappingProxyType({name: random[name] for name in LIMITS if name in random})


def rock_of(table: Mapping[str, Any], *, height: float) -> Soil | FrictionalSoil:
    """A soil like that of the table, which does not yield: its strength is its Young's modulus, which no load of a
    slope can reach. What varies is at its mean. height: of the slope (m)."""
    said = {name: value["mean"] if isinstance(value, Mapping) else value for name, value in table.items()}
    said["unusual"] = True
    said |= {"strength_ratio": None, "strength_minimum": None}
    said["strength" if said["cohesion"] is None else "cohesion"] = said["young"]
    return _built(said, height)


def _check_kind(said: dict[str, Any], given: Collection[str]) -> None:
    """Clay has a strength, other soil cohesion and friction; ValueError for what has no say."""
    frictional = [name for name in ("cohesion", "friction") if said[name] is not None]
    undrained = [name for name in ("strength", "strength_ratio") if said[name] is not None]
    if frictional and undrained:
        raise ValueError(
            f"[soil] {frictional[0]} is given beside a {undrained[0]}: undrained soil has a strength, other soil "
            "cohesion and friction; leave one of them out"
        )
    if len(undrained) == 2:
        raise ValueError(
            "[soil] strength_ratio is given beside a strength, in whose place it is: leave one of them out"
        )
    if ("strength_ratio" in undrained) != (said["strength_minimum"] is not None):
        lacking, beside = ("minimum", "ratio") if undrained == ["strength_ratio"] else ("ratio", "minimum")
        raise ValueError(
            f"[soil] lacks strength_{lacking}, which goes with strength_{beside}: add it; at the surface, where the "
            "stress is 0, soil has its strength_minimum (Pa)"
        )
    if not frictional and not undrained:
        raise ValueError(
            "the scene says neither what strength nor what cohesion and friction its soil has: add [strength] with "
            "mean, cov and length, or cohesion and friction to [soil]"
        )
    if len(frictional) == 1:
        lacking = {"cohesion": "friction", "friction": "cohesion"}[frictional[0]]
        raise ValueError(f"[soil] lacks {lacking}, which goes with {frictional[0]}: add it")
    for name in OF_CLAY if frictional else OF_FRICTION:
        if name in given:
            kind = "soil with cohesion and friction" if frictional else "undrained soil"
            raise ValueError(f"[soil] {name} has no say in {kind}: leave it out")


def _field(where: str, table: Mapping[str, Any]) -> RandomField:
    """A field whose own numbers are in range."""
    bedding = table["bedding"]
    field = RandomField(**{**table, "bedding": None if bedding is None else kl.Bedding(**bedding)})
    for name, value in (("mean", field.mean), *((f"length of axis {a}", each) for a, each in enumerate(field.length))):
        if not value > 0 or (name == "mean" and value == math.inf):
            raise ValueError(f"{where} {name} = {value:g}: give a finite value above 0")
    if not 0 <= field.cov < math.inf:
        raise ValueError(f"{where} cov = {field.cov:g}: give a coefficient of variation of 0 or more")
    if not 0 < field.energy <= 1:
        raise ValueError(f"{where} energy = {field.energy:g}: give a share of the variance above 0, up to 1")
    known = {each.name for each in fields(field.marginal)}
    for end in ("lower", "upper"):
        if getattr(field, end) is not None and end not in known:
            raise ValueError(f"{where} {end} = {getattr(field, end):g}: {field.marginal.__name__} has no such bound, "
                             "leave it out, or give marginal = 'truncated normal' or 'beta'")  # fmt: skip
    if field.marginal is kl.Beta and (field.lower is None or field.upper is None):
        raise ValueError(f"{where} lacks lower or upper, between which a beta distribution lies: add both")
    if field.borehole_error < 0:
        raise ValueError(f"{where} borehole_error = {field.borehole_error:g}: give a deviation of 0 or more")
    if field.bedding is not None and not 0 <= field.bedding.dip <= 90:
        raise ValueError(f"{where[:-1]}.bedding] dip = {field.bedding.dip:g}: give degrees from 0 to 90")
    return field


def _check_field(where: str, name: str, field: RandomField, span: Span, unusual: bool) -> None:
    """Whether the values of a field stay within the limits of its parameter."""
    if not unusual:
        _ask_of_field(where, name, field)
    kl.check_marginal(field.distribution)
    _check_trend(where, field, span)
    depth = field.deepest(span)
    if field.grown(depth) <= 0:
        raise ValueError(
            f"{where} trend = {field.trend:g} per metre brings the mean of {field.mean:g} to "
            f"{field.mean * field.grown(depth):.3g} at a depth of {depth:g} m: give a smaller one"
        )
    limit = LIMITS[name]
    for value in extremes(field, span):
        if not limit.holds(value):
            said = f"{value:.3g} {limit.unit}".rstrip()
            raise ValueError(
                f"{where} has values of {said}, {TAIL:g} deviations from the middle: give {limit} by a "
                "smaller cov, or marginal = 'truncated normal' with lower and upper"
            )
    for row in field.boreholes or ():
        if len(row) != len(field.length) + 1:
            raise ValueError(
                f"{where} boreholes hold {list(row)}: give {len(field.length) + 1} numbers, the place and the value"
            )


def _check_trend(where: str, field: RandomField, span: Span) -> None:
    """Whether the depth that a trend counts is one that the ground has."""
    if field.trend_from == "surface":
        return
    if field.trend is None:
        raise ValueError(f"{where} trend_from = {field.trend_from!r} without a trend: add trend, or leave it out")
    if field.deepest(span) <= 0:
        raise ValueError(
            f"{where} trend_from = {field.trend_from:g} m is not above the base of the ground at {span[0]:g} m: give "
            "an elevation within the ground or above it"
        )


def extremes(field: RandomField, span: Span) -> tuple[float, float]:
    """Least and largest value of a field within `TAIL` deviations, in ground between two elevations (m)."""
    at = np.asarray(field.distribution.transform(jnp.asarray([-TAIL, 0.0, TAIL])), float)
    ends = [float(value) for value in np.outer(at[[0, 2]], [1.0, field.grown(field.deepest(span))]).ravel()]
    return min(ends), max(ends)


def steepest(soil: Any, random: Mapping[str, RandomField], span: Span) -> Any:
    """The soil where it softens most steeply beside its shear modulus: what varies at such ends of its values."""

    def steepness(each: Any) -> float:
        law = each.material(np.dtype("float32"), 1.0)
        return 0.0 if law.steepest_softening is None else float(law.steepest_softening / law.shear)

    names = [name for name in random if hasattr(soil, name) and name != "strength_ratio"]
    ends = product(*(extremes(random[name], span) for name in names))
    return max((replace(soil, **dict(zip(names, each, strict=True))) for each in ends), key=steepness)


def _check_number(where: str, name: str, value: float, unusual: bool) -> None:
    limit = LIMITS[name]
    if not limit.holds(value):
        raise ValueError(f"{where} = {value:g} {limit.unit}".rstrip() + f": give {limit}")
    if not unusual:
        ask(where, name, value)


def _ask_of_field(where: str, name: str, field: RandomField) -> None:
    """Raise ValueError for a number of a field that betrays another unit."""
    ask(f"{where} mean", name, field.mean)
    ask(f"{where} cov", name, field.cov, COV)
    # Angles may well come down to a degree.
    for end in ("upper",) if LIMITS[name].unit == "degrees" else ("lower", "upper"):
        ask(f"{where} {end}", name, getattr(field, end) or 0.0)
    if field.trend is not None and name in TRENDS:
        ask(f"{where} {'-' if field.trend < 0 else ''}trend", name, abs(field.trend), TRENDS[name])
    for row in field.boreholes or ():
        ask(f"{where} boreholes, value", name, row[-1])


def ask(where: str, name: str, value: float, believed: Believed | None = None) -> None:
    """Raise ValueError for a number that betrays another unit, see `jaxmpm.unit_slip`."""
    if slip := unit_slip(name, value, believed):
        raise ValueError(f"{where} = {slip} If it is meant as it is, say unusual = true in [soil]")


def _check_saturated(said: Mapping[str, Any], random: Mapping[str, RandomField], unusual: bool) -> None:
    """Water in its pores does not make soil lighter."""
    saturated, weight = said["saturated_unit_weight"], said["unit_weight"]
    if saturated is None:
        return
    if "unit_weight" in random:
        raise ValueError(
            f"[soil] saturated_unit_weight = {saturated:g} N/m3 beside a unit_weight that varies, which is that of all "
            "soil, wet or dry: give unit_weight as a number, or leave saturated_unit_weight out"
        )
    if saturated < weight and not unusual:
        raise ValueError(
            f"[soil] saturated_unit_weight = {saturated:g} N/m3 is below unit_weight = {weight:g} N/m3, that of soil "
            "above the water: give at least that. If it is meant as it is, say unusual = true in [soil]"
        )


def _check_friction(said: dict[str, Any], random: Mapping[str, RandomField], span: Span) -> None:
    """Soil that dilates by more than its friction would gain work by sliding; none gains strength by softening."""
    if said["friction"] is None:
        return

    def ends(name: str) -> tuple[float, float]:
        return extremes(random[name], span) if name in random else (said[name], said[name])

    for name in ("cohesion", "friction") if said["softening_strain"] is not None else ():
        (least, _), (_, residual) = ends(name), ends(f"residual_{name}")
        if residual > least:
            goes = "reaches" if f"residual_{name}" in random else "="
            raise ValueError(
                f"[soil] residual_{name} {goes} {residual:.4g} {LIMITS[name].unit}, but {name} comes down to "
                f"{least:.3g}: give a residual of at most that"
            )
    friction, dilation = ends("friction"), ends("dilation")
    if dilation[1] > friction[0]:
        raise ValueError(
            f"[soil] dilation reaches {dilation[1]:.3g} degrees, friction comes down to {friction[0]:.3g}: give a "
            "dilation of at most the friction"
        )


def _built(said: dict[str, Any], height: float) -> Soil | FrictionalSoil:
    """Softening refers to a band of known thickness, unless the scene has it follow the cell."""
    frictional = said["cohesion"] is not None
    kept = {name: value for name, value in said.items() if name not in (OF_CLAY if frictional else OF_FRICTION)}
    length = kept.pop("softening_length")
    if length is UNSAID and not height > 0:
        length = None
    soil: Soil | FrictionalSoil = (FrictionalSoil if frictional else Soil)(**kept)
    if length is UNSAID:
        length = BAND * height if soil.softens else None
    return replace(soil, softening_length=length)


def check_cross_correlation(found: CrossCorrelation, random: Mapping[str, RandomField]) -> None:
    """Raise ValueError for parameters that do not vary, or not alike, and for a matrix that is no correlation."""
    for name in found.parameters:
        if name not in random:
            raise ValueError(
                f"[cross_correlation] parameters hold {shown(name)}, which is no parameter that varies: give some of "
                f"{', '.join(random)}"
            )
    if len(set(found.parameters)) != len(found.parameters) or len(found.parameters) < 2:
        raise ValueError(f"[cross_correlation] parameters = {list(found.parameters)}: give two or more, each once")
    if {len(row) for row in found.matrix} | {len(found.matrix)} != {len(found.parameters)}:
        raise ValueError(
            f"[cross_correlation] matrix has {len(found.matrix)} rows of {len(found.matrix[0])} numbers for "
            f"{len(found.parameters)} parameters: give a row and a column for each"
        )
    first, *others = (random[name] for name in found.parameters)
    for name, other in zip(found.parameters[1:], others, strict=True):
        if _shape(other) != _shape(first):
            raise ValueError(
                f"[cross_correlation] {name} has not the length, correlation, bedding, energy and nataf of "
                f"{found.parameters[0]}: fields that correlate need the same"
            )
    gaussian_root(found, random)


def _shape(field: RandomField) -> Any:
    """What fields that correlate have in common: their expansion."""
    told = (field.correlation, field.length, field.bedding, field.energy, field.nataf)
    bounds = (None if end is None else end / field.mean for end in (field.lower, field.upper))
    return (*told, field.marginal, field.cov, *bounds) if field.nataf else told


def gaussian_root(found: CrossCorrelation, random: Mapping[str, RandomField]) -> np.ndarray:
    """What independent Gaussian fields (P,) are multiplied by, to be correlated (P, P). Raises ValueError for a matrix
    that is no correlation, or that the marginals cannot have."""
    try:
        root = kl.correlation_root(found.matrix)
        if found.nataf:
            marginals = tuple(random[name].distribution for name in found.parameters)
            root = kl.correlation_root(kl.nataf_matrix(found.matrix, marginals))
    except ValueError as error:
        raise ValueError(f"[cross_correlation] {error}") from error
    return root
