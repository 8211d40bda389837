"""Layers of a site from its files, each with the random field of its soundings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from cooperative.scene.tables import CORRELATIONS, MARGINALS
from cooperative.tools.site._assumed import Assumed
from cooperative.tools.soundings import (
    FEWEST,
    FRICTION,
    STRENGTH,
    TYPES,
    PointValues,
    ProposedLayer,
    Sounding,
    Values,
    corrected_cone,
    extent_of,
    friction_of,
    kind_between,
    proposed_layers,
    read_files,
    require_elevations,
    strength_of,
    thinned,
    types_of,
)
from jaxmpm.soil import soil_limits
from jaxmpm.support import check
from jaxmpm.support.values import by_value
from kl.estimation import FieldFit, Interval, fit_field, interval_of
from kl.marginal import Lognormal

UNDRAINED = ("clay", "peat")
"""Types of soil that have an undrained strength; others have an angle of friction."""
MOST = 240
"""Values of a layer that are used at most: the time of an estimate grows with their third power."""
MOST_CONDITIONING = 120
"""Values of a layer that condition the field at most."""
CLOSEST = 0.1
"""Least distance (m) of readings that are used."""
UNKNOWN = 1.0
"""Thickness (m) without a reading from which on the output names it."""
PLAUSIBLE = {"strength": (300e3, 0.8), "friction": (50.0, 0.25)}
"""Mean at the middle of a layer, and coefficient of variation, from which on no soil has them: 300 kPa is the limit of
soil to soft rock (EN ISO 14688-2), the coefficients lie above those of Phoon and Kulhawy (1999)."""
LEAST_ERROR = 0.1
"""Deviation of the conditioning values over that of the field, at least: a field of finitely many terms needs some."""


@by_value
@dataclass(frozen=True)
class SiteLayerFit:
    """A layer of a site with its random parameter.

    Args:
        name: of the layer.
        top: elevation (m).
        bottom: elevation (m).
        parameter: of a scene's soil: "strength" or "friction".
        points: (d, n) m, those that the estimate rests on.
        values: (n,) there, in SI units and degrees.
        conditioning: numbers of the points that condition the field.
        fit: estimates with intervals.
        mean: at the top, with the scatter of the cone factor.
        mean_error: standard error by which the mean and its trend are uncertain together, the cone factor apart.
        scatter: of the cone factor, over its mean, by which all values are uncertain together.
        young: stiffness (Pa) that the table proposes.
        remarks: in words.
    """

    name: str
    top: float
    bottom: float
    parameter: str
    points: Values
    values: Values
    conditioning: np.ndarray
    fit: FieldFit
    mean: Interval
    mean_error: float
    scatter: float
    young: float
    remarks: tuple[str, ...]

    @property
    def error(self) -> float:
        """Deviation of the conditioning values over that of the field."""
        nugget = self.fit.nugget.value
        return max(LEAST_ERROR, math.sqrt(nugget / (1 - nugget)))


@by_value
@dataclass(frozen=True)
class SiteEstimate:
    """What the files of a site hold.

    Args:
        soundings: that were read.
        measured: laboratory values.
        layers: from the top down.
        assumed: what the interpretation rests on.
    """

    soundings: tuple[Sounding, ...]
    measured: tuple[PointValues, ...]
    layers: tuple[SiteLayerFit, ...]
    assumed: Assumed


def estimate_site(
    paths: Sequence[Path | str],
    assumed: Assumed | None = None,
    *,
    boundaries: Sequence[float] | None = None,
    units: Mapping[str, str] | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> SiteEstimate:
    """Read the files of a site, and estimate the random field of each layer.

    Args:
        paths: soundings (.gef, .xml, .ags, .csv) and laboratory values (.ags, .csv).
        assumed: what the interpretation rests on beside them; None for its defaults.
        boundaries: elevations (m) between layers from the top down, in place of those proposed; none for one layer.
        units: of columns of CSV files whose header has none.
        progress: takes a line before each layer, whose estimate may take seconds.

    Raises:
        ValueError: files that cannot be used, clay without a cone factor, or layers with too few values.
    """
    assumed = assumed or Assumed()
    soundings, measured = read_files([Path(path) for path in paths], units)
    soundings = [_with_ratio(sounding, assumed.area_ratio) for sounding in soundings]
    require_elevations(soundings)
    if assumed.section is not None:
        _require_section(soundings, measured, assumed)
    _require_alike(soundings, measured)
    layers = _layers(soundings, measured, assumed, boundaries)
    inner = {layer.bottom for layer in layers[:-1]}
    layers = [replace(layer, meets=tuple(at for at in (layer.top, layer.bottom) if at in inner)) for layer in layers]
    for measurements in measured:
        if beyond := int(((measurements.z >= layers[0].top) | (measurements.z < layers[-1].bottom)).sum()):
            check.warn(
                f"{measurements.file}: {beyond} values of {measurements.parameter} are left out, which lie above or "
                f"below the layers, {layers[0].top:g} to {layers[-1].bottom:g} m"
            )
    if unused := [sounding.name for sounding in soundings if _bare(sounding) and np.isfinite(sounding.pore).any()]:
        check.warn(
            f"u_2 of {', '.join(unused)} is not used, since no area ratio of the cone is known, and q_c stands for "
            "q_t: give --area-ratio, such as 0.8"
        )
    fits = []
    for number, layer in enumerate(layers, 1):
        progress(f"layer {number} of {len(layers)}, {layer.kind} from {layer.top:.2f} to {layer.bottom:.2f} m")
        fits.append(_fit(number, layer, soundings, measured, assumed))
    return SiteEstimate(tuple(soundings), tuple(measured), tuple(fits), assumed)


def _bare(sounding: Sounding) -> bool:
    """Whether q_c stands for q_t."""
    corrected = sounding.area_ratio is not None and np.isfinite(sounding.pore).any()
    return sounding.corrected is None and not corrected


def _with_ratio(sounding: Sounding, ratio: float | None) -> Sounding:
    """The sounding with an area ratio, where its file has none."""
    lacks = sounding.area_ratio is None and sounding.corrected is None
    return replace(sounding, area_ratio=ratio) if lacks else sounding


def _require_section(soundings: list[Sounding], measured: list[PointValues], assumed: Assumed) -> None:
    """Raise ValueError for positions in 3D beside a section, or of which none lies between its walls."""
    assert assumed.section is not None
    low, *_, high = assumed.section.surface[0]
    every: list[Sounding | PointValues] = [*soundings, *measured]
    x, y = (np.concatenate([np.atleast_1d(getattr(record, axis)) for record in every]) for axis in "xy")
    placed = assumed.placed(x, y)
    if len(placed) > 1:
        raise ValueError(f"{assumed.section.path} is a section, the files have x and y: give --line, on which they lie")
    if not ((placed[0] >= low) & (placed[0] <= high)).any():
        raise ValueError(
            f"no position lies in {assumed.section.path}, from x = {low:g} to {high:g} m, but from "
            f"{placed[0].min():g} to {placed[0].max():g} m: is --line that of the section?"
        )


def _require_alike(soundings: Sequence[Sounding], measured: Sequence[PointValues]) -> None:
    """Raise ValueError for files of which some have y and others not."""
    every: list[Sounding | PointValues] = [*soundings, *measured]
    files = {record.file: bool(np.isfinite(record.y).any()) for record in every if np.isfinite(record.x).any()}
    if lacking := sorted(file for file, has in files.items() if has != any(files.values())):
        raise ValueError(f"{lacking[0]} has no y, which other files have: add the column y [m] to it, or leave it out")


def _layers(
    soundings: list[Sounding], measured: list[PointValues], assumed: Assumed, boundaries: Sequence[float] | None
) -> list[ProposedLayer]:
    if boundaries is None and soundings:
        proposed = proposed_layers(soundings, assumed.stresses)
        # As they are written: a value at a boundary is of the layer above.
        return [replace(layer, top=round(layer.top, 2), bottom=round(layer.bottom, 2)) for layer in proposed]
    if soundings:
        top, bottom = extent_of(soundings)
    else:
        z = np.concatenate([measurements.z for measurements in measured])
        if not z.size:
            raise ValueError(
                f"no value is left of {', '.join(sorted({values.file for values in measured}))}: correct them"
            )
        top, bottom = float(z.max()) + 0.01, float(z.min())
    edges = [top, *(boundaries or ()), bottom]
    if any(one <= other for one, other in pairwise(edges)) and len(edges) > 2:
        raise ValueError(
            f"layers = {list(boundaries or ())}: give elevations between {top:g} and {bottom:g} m that fall, from the "
            "top down"
        )
    default = "clay" if assumed.n_kt is not None or not soundings else "sand"
    return [
        ProposedLayer(kind_between(soundings, assumed.stresses, *ends) or default, *ends) for ends in pairwise(edges)
    ]


def _fit(
    number: int, layer: ProposedLayer, soundings: list[Sounding], measured: list[PointValues], assumed: Assumed
) -> SiteLayerFit:
    parameter = "strength" if layer.kind in UNDRAINED else "friction"
    name = f"{layer.kind} {number}"
    where = f"layer {name!r} from {layer.top:.4g} to {layer.bottom:.4g} m"
    if parameter == "strength" and soundings and assumed.n_kt is None:
        raise ValueError(
            f"{where} is of {layer.kind}, whose strength needs a cone factor: give --n-kt, such as 14, or 14 2 for a "
            "mean of 14 with a standard deviation of 2"
        )
    points, values, cones = _values(layer, parameter, soundings, measured, assumed)
    if values.size < FEWEST:
        raise ValueError(
            f"{where} has {values.size} values of {parameter}, the limit is {FEWEST}: give other boundaries by --layers"
        )
    try:
        fit = fit_field(
            points, values,
            # The angle of friction has the stress taken out of it.
            depth=layer.top - points[-1] if parameter == "strength" else None,
            marginal=MARGINALS[marginal_of(parameter, assumed)], correlation=CORRELATIONS[assumed.correlation],
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    mean_factor, deviation = assumed.n_kt if parameter == "strength" and soundings and assumed.n_kt else (1.0, 0.0)
    scatter = deviation / mean_factor
    scores = np.random.default_rng(0).standard_normal(fit.draws.mean.size)
    factors = np.asarray(Lognormal(1.0, scatter).transform(jnp.asarray(scores))) if scatter else 1.0
    middle = interval_of(fit.draws.mean + fit.draws.trend * float(np.mean(layer.top - points[-1])))
    mean = interval_of(factors * fit.draws.mean)
    young = 500 * mean.value if parameter == "strength" else 2.5 * float(np.median(cones))
    used = assumed.in_ground(points)
    conditioning = _spread(points, fit, used)
    remarks = tuple(_remarks(layer, parameter, soundings, measured, assumed, values.size))
    if outside := int((~used).sum()):
        remarks = (*remarks, f"{outside} values beside the ground or above its surface do not condition the field")
    if odd := _implausible(parameter, middle.value, fit.cov.value):
        remarks = (*remarks, odd)
        check.warn(f"{where}: {odd}")
    return SiteLayerFit(
        name, layer.top, layer.bottom, parameter, points, values, conditioning, fit, mean,
        fit.mean.value * middle.error / middle.value, scatter, young, remarks,
    )  # fmt: skip


def _implausible(parameter: str, mean: float, cov: float) -> str | None:
    """What no soil has of an estimate, in words; None where it is plausible."""
    most, widest = PLAUSIBLE[parameter]
    unit = "kPa" if parameter == "strength" else "degrees"
    scale = 1e3 if parameter == "strength" else 1.0
    wrong = [f"a mean of {mean / scale:.3g} {unit}, above {most / scale:g}"] if mean > most else []
    wrong += [f"a cov of {cov:.2g}, above {widest:g}"] if cov > widest else []
    if not wrong:
        return None
    return (
        f"{' and '.join(wrong)}, which no such soil has: look for another soil in it, at units, weight and water, and "
        "bound layers by --layers"
    )


def marginal_of(parameter: str, assumed: Assumed) -> str:
    """Marginal of a parameter, by its name in scenes: angles of friction vary so little that a normal one serves.

    Args:
        parameter: "strength" or "friction".
        assumed: with the marginal of strength.
    """
    return assumed.marginal if parameter == "strength" else "normal"


def _values(
    layer: ProposedLayer, parameter: str, soundings: list[Sounding], measured: list[PointValues], assumed: Assumed
) -> tuple[Values, Values, Values]:
    """Points (d, n) m and values (n,) of a layer, and the cone resistance (n,) Pa there.

    Of the soundings; where there are none, of the laboratory.
    """
    if not soundings:
        parts = []
        for lab in measured:
            valid = (lab.z < layer.top) & (lab.z >= layer.bottom) & np.isfinite(lab.x) & (lab.parameter == parameter)
            position = assumed.placed(lab.x[valid], lab.y[valid])
            none = np.full(position.shape[1], np.nan)
            parts.append((np.concatenate([position, lab.z[None, valid]]), lab.value[valid], none))
    else:
        inside = [(sounding, _parameter(sounding, parameter, assumed)) for sounding in soundings]
        masks = [
            np.isfinite(value) & layer.inside(sounding.z) & ~layer.of_another(sounding, assumed.stresses)
            for sounding, value in inside
        ]
        thickness = sum(
            float(np.ptp(sounding.z[mask])) for sounding, mask in zip(soundings, masks, strict=True) if mask.any()
        )
        apart = max(CLOSEST, thickness / MOST)
        parts = []
        for (sounding, value), mask in zip(inside, masks, strict=True):
            used = thinned(sounding.z, mask, apart)
            position = assumed.placed(np.full(used.size, sounding.x), np.full(used.size, sounding.y))
            parts.append(
                (np.concatenate([position, sounding.z[None, used]]), value[used], corrected_cone(sounding)[used])
            )
    # A sounding that does not reach the layer has no axes to tell a section from 3D.
    parts = [part for part in parts if part[1].size] or parts[:1]
    return tuple(np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))  # type: ignore[return-value]


def _parameter(sounding: Sounding, parameter: str, assumed: Assumed) -> Values:
    if parameter == "friction":
        return friction_of(sounding, assumed.stresses)
    assert assumed.n_kt is not None
    return strength_of(sounding, assumed.stresses, assumed.n_kt[0])


def _spread(points: Values, fit: FieldFit, used: np.ndarray) -> np.ndarray:
    """Numbers of the points (d, n) m that condition the field: a quarter of the vertical length apart, or farther."""
    apart = fit.vertical.value / 4
    while True:
        chosen = []
        for position in np.unique(points[:-1], axis=1).T:
            column = np.flatnonzero((points[:-1] == position[:, None]).all(axis=0) & used)
            column = column[np.argsort(-points[-1, column])]
            chosen.append(column[thinned(points[-1, column], np.ones(column.size, bool), apart)])
        numbers = np.concatenate(chosen)
        if numbers.size <= MOST_CONDITIONING:
            return numbers
        apart *= 1.25


def _remarks(
    layer: ProposedLayer, parameter: str, soundings: list[Sounding], measured: list[PointValues], assumed: Assumed,
    count: int,
) -> Iterator[str]:  # fmt: skip
    """What an engineer should know of how the values came about."""
    if soundings:
        yield STRENGTH if parameter == "strength" else FRICTION
        tables = {sounding.name: assumed.stresses.water_of(sounding) for sounding in soundings}
        water = "; ".join(
            f"{depth:g} m below the surface at {', '.join(name for name, level in tables.items() if level == depth)}"
            for depth in dict.fromkeys(tables.values())
        )
        yield f"unit weight {assumed.unit_weight / 1e3:g} kN/m3, water {water}"
        yield from _of_readings(layer, parameter, soundings, assumed, count)
    for name in dict.fromkeys(measurements.parameter for measurements in measured):
        of_parameter = [measurements for measurements in measured if measurements.parameter == name]
        values = np.concatenate([measurements.value[layer.inside(measurements.z)] for measurements in of_parameter])
        if values.size and (soundings or name != parameter):
            line = f"{values.size} laboratory values of {name}, mean {values.mean():.4g} {soil_limits()[name].unit}"
            yield f"{line}, not part of the estimate: {_unused(name, parameter)}"


def _of_readings(
    layer: ProposedLayer, parameter: str, soundings: list[Sounding], assumed: Assumed, count: int
) -> Iterator[str]:
    """Which readings of a layer are used, and what takes the place of those that lack."""
    if parameter == "strength" and (bare := [sounding.name for sounding in soundings if _bare(sounding)]):
        yield f"q_c in place of q_t, without u_2 or area ratio: {', '.join(bare)}"
    for high, low in _unknown(layer, soundings):
        yield f"no reading from {high:.2f} to {low:.2f} m: the soil there is taken to be that of the layer"
    others = [layer.of_another(sounding, assumed.stresses) for sounding in soundings]
    types = [types_of(sounding, assumed.stresses)[mask] for sounding, mask in zip(soundings, others, strict=True)]
    z = np.concatenate([sounding.z[mask] for sounding, mask in zip(soundings, others, strict=True)])
    for kind in np.unique(np.concatenate(types)):
        at = z[np.concatenate(types) == kind]
        yield (
            f"{at.size} readings of {TYPES[kind]} from {at.max():.2f} to {at.min():.2f} m are left out: give --layers "
            "if it is a layer of its own"
        )
    inside = [layer.inside(sounding.z) & np.isfinite(corrected_cone(sounding)) for sounding in soundings]
    bad = [np.isnan(_parameter(sounding, parameter, assumed)) for sounding in soundings]
    if nothing := sum(int((one & other).sum()) for one, other in zip(inside, bad, strict=True)):
        yield (
            f"{nothing} readings that give no {parameter} above 0 are left out: check N_kt, unit weight, water and "
            "gaps in u_2"
        )
    readings = sum(int(mask.sum()) for mask in inside)
    if count < readings - z.size:
        yield f"{count} of {readings} readings used, thinned, none averaged or filled in"


def _unknown(layer: ProposedLayer, soundings: list[Sounding]) -> Iterator[tuple[float, float]]:
    """Elevations (m) between which a layer has no reading of any sounding, from the top down."""
    read = np.concatenate(
        [sounding.z[layer.inside(sounding.z) & np.isfinite(corrected_cone(sounding))] for sounding in soundings]
    )
    ends = np.r_[layer.top, -np.sort(-read), layer.bottom]
    yield from ((float(high), float(low)) for high, low in pairwise(ends) if high - low > UNKNOWN)


def _unused(name: str, parameter: str) -> str:
    """Why laboratory values are not used in a layer of strength or friction, and what to do."""
    if name == parameter:
        return "compare N_kt" if name == "strength" else "compare"
    if name == "unit_weight":
        return "the weight is that of --unit-weight"
    if name == "young" or (name, parameter) == ("cohesion", "friction"):
        return "site.toml has a guess, replace it"
    return f"the layer has {parameter} in its place"
