"""Tables of water that moves: `[rain]` and `[drawdown]`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Literal, Self, TypeVar

import jax.numpy as jnp
import numpy as np
from annotated_types import GroupedMetadata, MaxLen, MinLen
from pydantic import AfterValidator, Field, PlainValidator, Strict, ValidationInfo
from pydantic import model_validator as validates

from cooperative.scene.tables._key import (
    MOST_TABLES,
    AboveZero,
    Flag,
    Length,
    Metres,
    Name,
    OrTable,
    Pair,
    Part,
    PerAxis,
    Raster,
    Rows,
    Text,
    Within,
    key,
    of_file,
    table,
)
from cooperative.scene.tables._varying import CONDUCTIVITY, RandomField
from jaxmpm.support.check import Invalid, Limit, above_zero, from_zero
from jaxmpm.support.table import LENGTHS
from jaxmpm.support.text import shown

HEAVIEST = 1e-4
"""Rate of rain (m/s) that is plausible, 360 mm/h: no longer rain has been measured."""
FASTEST = 1e-3
"""Rate (m/s) of rain or of a drawdown that is plausible on a chart: no dam is drawn down by 86 m a day."""
MOST_LOADS = 40
"""Along an axis of a chart."""
COARSEST = 0.1
"""Conductivity (m/s) of clean gravel."""
OFF = 1e3
"""Factor between a conductivity and that of its kind of soil from which on one of them has another unit."""

Series = tuple[tuple[float, float], ...]
"""Times (s) and values."""


def _read(value: object, of: str, what: str) -> float:
    """A number, or a text with a unit of `jaxmpm.seepage`, in SI units."""
    from jaxmpm import seepage  # the flow of water costs nothing where a scene has none

    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise Invalid((), shown(value), "", f"give {what}")
    units = {"m": LENGTHS, "s": seepage.TIMES, "m/s": seepage.RATES}[of]
    try:
        return seepage.quantity("", value, units)
    except Invalid as error:
        raise Invalid((), shown(value), "", f"give {what}; {error.remedy}") from error


def _within(value: object, number: float, limit: Limit, remedy: str) -> float:
    if not limit.holds(number):
        words = f"is {number:.4g} {limit.unit}" if isinstance(value, str) else f"{limit.unit}"
        raise Invalid((), shown(value), words, f"give {limit}{remedy}")
    return number


_EXAMPLES = {"s": "12 h", "m/s": "14 mm/h", "m": "3 m"}


@dataclass(frozen=True)
class Quantity(GroupedMetadata):
    """Of a type: a number in SI units within a limit, or a text with another unit.

    Args:
        limit: of the number, in its unit.
        remedy: what else to do about one beyond it.
    """

    limit: Limit
    remedy: str = ""

    def __iter__(self) -> Iterator[object]:
        unit = self.limit.unit
        what = f'a number in {unit}, or a text with its unit such as "{_EXAMPLES[unit]}"'

        def read(value: object) -> float:
            return _within(value, _read(value, unit, what), self.limit, self.remedy)

        yield PlainValidator(read, json_schema_input_type=float | str)
        yield Field(json_schema_extra={"unit": unit, "allowed": what})


@dataclass(frozen=True)
class TimeSeries(GroupedMetadata):
    """Of a type: a quantity, pairs of times and quantities, or the name of a CSV file of them.

    Args:
        limit: of the quantity, in its unit.
        file: what the file holds, "rain" or "level".
        remedy: what else to do about a number beyond the limit.
    """

    limit: Limit
    file: str
    remedy: str = ""

    @property
    def what(self) -> str:
        """What it takes, in words."""
        usual = _EXAMPLES[self.limit.unit]
        pairs = f'[["0 h", "{usual}"], ["6 h", "{usual}"]]'
        return f'a number in {self.limit.unit}, a text such as "{usual}", pairs such as {pairs}, or a CSV file'

    def __iter__(self) -> Iterator[object]:
        yield PlainValidator(self._series, json_schema_input_type=float | str | list[tuple[float | str, float | str]])
        yield Field(json_schema_extra={"unit": self.limit.unit, "allowed": self.what})

    def _one(self, value: object) -> float:
        return _within(value, _read(value, self.limit.unit, self.what), self.limit, self.remedy)

    def _series(self, value: object, info: ValidationInfo) -> Series:
        if isinstance(value, str) and value.lower().endswith((".csv", ".txt")):
            if info.context is None:
                raise Invalid((), shown(value), "", "give pairs of times (s) and values, as jaxmpm.seepage reads them")
            value = info.context.series(value, self.file)
        if not isinstance(value, list | tuple):
            return ((0.0, self._one(value)),)
        if not value or any(not isinstance(item, list | tuple) or len(item) != 2 for item in value):
            raise Invalid((), shown(value), "", f"give {self.what}")
        series = tuple((_read(t, "s", 'times in s, or texts such as "12 h"'), self._one(item)) for t, item in value)
        for number, ((before, _), (after, _)) in enumerate(pairwise(series), 2):
            if after <= before:
                raise Invalid(
                    (), None, f"goes from t = {shown(value[number - 2][0])} back to {shown(value[number - 1][0])}",
                    "give times in order, each once: a storm begins before it ends",
                )  # fmt: skip
        return series


Time = Annotated[float, Quantity(from_zero("s"))]
RAIN = Limit(above=-HEAVIEST, most=HEAVIEST, unit="m/s")
Rate = Annotated[Series, TimeSeries(RAIN, "rain", ', up to 360 mm/h; was mm/h meant? Write "14 mm/h"')]
Conductivity = Annotated[
    float,
    Quantity(Limit(above=0.0, most=COARSEST, unit="m/s"), ', that of clean gravel; was m/day meant? Write "0.9 m/day"'),
]
Level = Annotated[Series, TimeSeries(Limit(unit="m"), "level")]
STEADY = Limit(least=0.0, most=HEAVIEST, unit="m/s")
Steady = Annotated[float, Quantity(STEADY, ', up to 360 mm/h; was mm/h or mm a year meant? Write "300 mm/year"')]


Loaded = Annotated[
    float,
    Quantity(Limit(above=0.0, most=FASTEST, unit="m/s"), '; was another unit meant? Write "14 mm/h", or "0.5 m/day"'),
]
Duration = Annotated[float, Quantity(above_zero("s"))]


def _class(name: str) -> str:
    from jaxmpm.seepage import CARSEL_PARRISH

    if name not in CARSEL_PARRISH:
        raise Invalid((), shown(name), "", f"give one of {', '.join(CARSEL_PARRISH)}")
    return name


@table
class RandomConductivity(RandomField):
    """The random field of the conductivity of saturated soil, at the centres of the cells of the flow.

    Each sample has a flow of its own. Keys as in `[strength]`, in m/s.
    """

    mean: Conductivity = key("Mean; with a trend, the mean at depth 0.", "25 cm/day", units="m/s")

    @validates(mode="after")
    def _at_centres(self) -> Self:
        if self.sampled_at != "particles":
            rule = "is of particles; conductivity is taken at the centres of the cells of the flow"
            raise Invalid(("sampled_at",), repr(self.sampled_at), rule, "leave it out")
        return self


@table
class Hydraulics(Part):
    """How soil holds water and lets it through: by a class of soil, by its own numbers, or by both."""

    soil_class: Annotated[Text, AfterValidator(_class)] | None = key(
        "Class of the USDA, whose mean numbers hold for what is not given (Carsel and Parrish 1988).",
        "sandy loam", None, otherwise="none: give all numbers",
        allowed="sand, loamy sand, sandy loam, loam, silt, silt loam, sandy clay loam, clay loam, silty clay loam, "
        "sandy clay, silty clay or clay",
    )  # fmt: skip
    conductivity: OrTable[Conductivity, RandomConductivity] | None = key(
        "Upright conductivity of saturated soil, or a table of how it varies: `[rain.soil.conductivity]` with the keys "
        "of `[strength]`, which `cross_correlation` calls `conductivity`. That of `soil` goes through all layers that "
        "have it, that of a layer stops there.",
        "1e-6 m/s", None, otherwise="that of the class",
        synonyms="k ksat k_sat k_s permeability hydraulic_conductivity",
    )  # fmt: skip
    anisotropy: AboveZero | None = key(
        "Level over upright conductivity.", 3.0, None, otherwise="`1.0`", synonyms="k_h/k_v kh/kv k_ratio"
    )
    model: Literal["van genuchten", "gardner"] = key(
        "Retention curve; `gardner` has no `n` and no `air_entry`.", "van genuchten", "van genuchten"
    )
    alpha: Annotated[float, Within(above_zero("1/m"))] | None = key(
        "Of the curve: 1 over the suction at which soil drains.", 3.6, None, otherwise="that of the class"
    )
    n: Annotated[float, Within(Limit(above=1.0))] | None = key(
        "Of the curve: how evenly large its pores are.", 1.56, None, otherwise="that of the class"
    )
    porosity: Annotated[float, Within(Limit(above=0.0, below=1.0))] | None = key(
        "Water content of saturated soil.", 0.43, None, otherwise="that of the class",
        synonyms="theta_s saturated_water_content",
    )  # fmt: skip
    residual: Annotated[float, Within(Limit(least=0.0, below=1.0))] | None = key(
        "Water content of dry soil.", 0.078, None, otherwise="that of the class, or `0.0`", synonyms="theta_r"
    )
    air_entry: Annotated[float, Within(from_zero("m"))] | None = key(
        "Suction up to which soil stays saturated.", 0.02, None, otherwise="`0.02` where `n` is below 2, else `0.0`"
    )
    storage: Annotated[float, Within(from_zero("1/m"))] | None = key(
        "Specific storage.", 1e-5, None, otherwise="`1e-5`"
    )

    @validates(mode="after")
    def _of_its_kind(self) -> Self:
        """Conductivity goes with the class; in similar pores with the square of alpha (Miller and Miller 1956)."""
        conductivity = self.conductivity
        if conductivity is None or (self.soil_class is None and self.alpha is None):
            return self
        from jaxmpm.seepage import CARSEL_PARRISH

        mean = conductivity.mean if isinstance(conductivity, RandomField) else conductivity
        classes = {name: (alpha, per_day / 100 / 86400) for name, (_, _, alpha, _, per_day) in CARSEL_PARRISH.items()}
        if self.soil_class is not None:
            like, usual, least = self.soil_class, classes[self.soil_class][1], classes[self.soil_class][1] / OFF
            remedy = "leave soil_class out"
        else:
            assert self.alpha is not None
            like, least = f"soil with alpha = {self.alpha:g} 1/m", 0.0  # a liner lets less through
            remedy = "give it the alpha of such soil"
            usual = float(np.median([rate / alpha**2 for alpha, rate in classes.values()])) * self.alpha**2
        if not least < mean < usual * OFF:
            raise Invalid(
                ("conductivity",), f"{mean:.3g} m/s", f"is {mean / usual:.2g} times that of {like}, {usual:.2g} m/s",
                f'was another unit meant? Write it as a text, "0.9 m/day", or {remedy}',
            )  # fmt: skip
        return self

    @property
    def numbers(self) -> dict[str, float]:
        """What is given of the retention and the conductivity, which is its median where it varies."""
        names = ("conductivity", "anisotropy", "alpha", "n", "porosity", "residual", "air_entry", "storage")
        numbers = {name: value for name in names if (value := getattr(self, name)) is not None}
        if isinstance(varies := self.conductivity, RandomField):
            numbers[CONDUCTIVITY] = float(varies.distribution.transform(jnp.zeros(())))
        return numbers


@table
class HydraulicLayer(Hydraulics):
    """What a layer has of its own; the rest is that of the whole ground."""

    name: Name = key("Of the `[[layer]]`.", "soft clay", "")
    model: Literal["van genuchten", "gardner"] | None = key(  # type: ignore[assignment]
        "Retention curve.", "van genuchten", None, otherwise="that of the whole ground"
    )


H = TypeVar("H", bound=Hydraulics)
Keys = tuple[str | int, ...]


Pressure = Annotated[
    Rows,
    of_file(lambda files, name: files.pressure(name)),
    Field(json_schema_extra={"allowed": "rows of a point, a time (s) and the total head, or the name of a CSV file"}),
]
"""Total heads (m) of another program: rows [x, z, t, head], in 3D [x, y, z, t, head]."""


WaterTables = Annotated[
    tuple[Annotated[tuple[Time, Raster], Strict(False)], ...],
    Strict(False),
    MinLen(1),
    Field(json_schema_extra={"allowed": 'pairs of a time and a file, [["0 h", "water.asc"], ["12 h", "wet.tif#2"]]'}),
]
"""Heights of the water table (m) at times (s), each by the name of a raster, or of a band of it."""


def _check_rising(values: tuple[float, ...], where: str, unit: str) -> None:
    """Raise Invalid for numbers of a key that do not rise."""
    for before, after in pairwise(values):
        if after <= before:
            raise Invalid((where,), None, f"go from {before:g} to {after:g} {unit}", "give them rising, each once")


@table
class ChartedLoads(Part):
    """Loads of `jaxmpm seepage --chart`: rain of each rate and duration, or drawdowns at each rate.

    A drawdown goes from the first level to the lowest.
    """

    rates: Annotated[tuple[Loaded, ...], Strict(False), MinLen(2), MaxLen(MOST_LOADS)] = key(
        "Of the rain, or of the fall of the level.", ["5 mm/h", "10 mm/h", "20 mm/h"],
        allowed='two rates in m/s or more, or texts such as "10 mm/h" or "0.5 m/day", rising', units="m/s",
    )  # fmt: skip
    durations: Annotated[tuple[Duration, ...], Strict(False), MaxLen(MOST_LOADS)] = key(
        "How long it rains.", ["6 h", "12 h", "24 h"], (),
        allowed='times in s, or texts such as "12 h", rising', units="s",
    )  # fmt: skip
    after: Annotated[tuple[Duration, ...], Strict(False), MaxLen(MOST_LOADS)] = key(
        "How long after the rain the slope is asked too; at its end it always is.", ["12 h"], (21600.0, 86400.0),
        allowed='times in s, or texts such as "12 h", rising', units="s",
    )  # fmt: skip

    @validates(mode="after")
    def _rising(self) -> Self:
        _check_rising(self.rates, "rates", "m/s")
        _check_rising(self.durations, "durations", "s")
        _check_rising(self.after, "after", "s")
        return self


@table
class Seepage(Part):
    """Water that moves in the ground while nothing slides.

    At a time the slope rests under the pore pressure of that time, and is then asked whether it stands.
    """

    times: Annotated[tuple[Time, ...], Strict(False)] = key(
        "Times at which the slope is asked.", ["0 h", "6 h", "12 h", "24 h"],
        allowed='times in s, or texts such as "12 h", rising', units="s",
    )  # fmt: skip
    at: Time | None = key(
        "Time at which the samples of a campaign rest, and the slope of `jaxmpm slide` and `fos`.", "12 h", None,
        otherwise="the last of `times`",
    )  # fmt: skip
    rate: Rate | None = key(
        "Rain, per level area; a rate holds until the next time. A CSV has columns such as `t [h]` and `rain [mm/h]`. "
        "Below 0 it evaporates.",
        "14 mm/h", None, otherwise="none", synonyms="rain intensity precipitation hyetograph rainfall",
    )  # fmt: skip
    level: Level | None = key(
        "Height of the river or reservoir that stands on the ground, linear between times. A CSV has columns such as "
        "`t [d]` and `level [m]`.",
        [["0 d", 8.0], ["5 d", 2.0]], None, otherwise="no pool", synonyms="pool reservoir water_level",
    )  # fmt: skip
    pressure: Pressure | None = key(
        "In place of all flow: CSV file of the pore pressure that another program has computed, with columns such as "
        "`x [m]`, `z [m]`, in 3D `y [m]`, `t [h]` and one of `total head [m]`, `pressure head [m]`, `pressure [kPa]`.",
        [[0.0, 0.0, 0.0, 4.0], [36.0, 0.0, 0.0, 2.0], [0.0, 10.0, 0.0, 4.0]],
        None,
        otherwise="none",
    )
    water_tables: WaterTables | None = key(
        "Likewise, under a terrain: times and rasters of the heights of the water table, which is linear between them. "
        "Water is at rest along each upright line.",
        [["0 h", "water.asc"], ["12 h", "wet.asc"]],
        None,
        units="m",
        otherwise="none",
        synonyms="heads head_rasters pressure_rasters water_table rasters",
    )
    soil: Hydraulics | None = key("Of the ground, `[rain.soil]`.", {"soil_class": "loam"}, None, otherwise="none")
    layer: Annotated[tuple[HydraulicLayer, ...], Strict(False), MaxLen(MOST_TABLES)] = key(
        "Of layers that differ, `[[rain.layer]]` with the name of each.",
        [{"name": "soft clay", "soil_class": "clay"}],
        (),
        allowed="tables with the keys of `[rain.soil]`",
    )
    suction: Flag = key(
        "Whether suction holds grains together: Bishop's effective stress with the effective saturation.", True, True
    )
    initial_rate: Steady | None = key(
        "Steady rain before time 0, whose flow is the initial state.", "300 mm/year", None,
        otherwise="water at rest, at the height of `[water]`, or of `level` at time 0",
    )  # fmt: skip
    left: Level | Literal["closed"] | None = key(
        "Level of the groundwater beyond the left end, or `closed`.", 6.0, None,
        otherwise="the water at rest there, closed with `initial_rate`",
    )  # fmt: skip
    right: Level | Literal["closed"] | None = key("Likewise beyond the right end.", 1.0, None, otherwise="likewise")
    base: Literal["closed", "free drainage"] = key("Whether water falls out of the base.", "closed", "closed")
    drains: Annotated[tuple[Pair[Metres], ...], Strict(False)] = key(
        "Drain pipes along y, at points (x, z).", [[30.0, 1.0]], (), allowed="points [[x, z], ...]", units="m"
    )
    drain_radius: Length = key("Of these pipes.", 0.05, 0.05)
    cell: PerAxis[Length] | None = key(
        "Edges of a cell of the flow.", [1.0, 0.5], None, otherwise="the cell of the refined grid, half of it upright"
    )
    tolerance: AboveZero = key("Error of a step in water content.", 0.005, 0.005)
    chart: ChartedLoads | None = key(
        "Loads of `jaxmpm seepage --chart` in place of `rate`, or of `level`, and `times`; `[rain.chart]`.",
        {"rates": ["5 mm/h", "10 mm/h"], "durations": ["6 h", "24 h"]}, None, otherwise="none",
    )  # fmt: skip

    @validates(mode="after")
    def _times(self) -> Self:
        if not self.times:
            raise Invalid((), None, "lacks times", 'add when the slope is asked, times = ["0 h", "12 h"]')
        _check_rising(self.times, "times", "s")
        if self.times[-1] <= 0:
            raise Invalid(("times",), None, "end at 0 s, when nothing has moved yet", "give later ones")
        if self.at is not None and self.at > self.times[-1]:
            raise Invalid(
                ("at",), f"{self.at:g} s", f"is after the last of times, {self.times[-1]:g} s", "give it there"
            )
        if self.rate is not None and all(t >= self.times[-1] or rate == 0 for t, rate in self.rate):
            raise Invalid(
                ("rate",), None, f"is 0 up to the last of times, {self.times[-1]:g} s",
                "give later times, or an earlier storm; are times in hours and the storm in seconds?",
            )  # fmt: skip
        return self

    @validates(mode="after")
    def _one_source(self) -> Self:
        if self.water_tables is not None:
            _check_rising(tuple(time for time, _ in self.water_tables), "water_tables", "s")
        if (source := self.given_by) is not None:
            names = ("water_tables", "rate", "level", "initial_rate", "left", "right")
            sources = [name for name in names if name != source and getattr(self, name) is not None]
            sources += ["drains"] if self.drains else []
            sources += ["chart"] if self.chart is not None else []
            if sources and sources != ["level"]:
                raise Invalid(
                    (sources[0],), None, f"has no effect beside {source}, which another program has computed",
                    "leave one of them out",
                )  # fmt: skip
        return self

    @property
    def given_by(self) -> str | None:
        """The key of the pressure that another program has computed, None where the scene has its flow."""
        return next((name for name in ("pressure", "water_tables") if getattr(self, name) is not None), None)

    @property
    def moment(self) -> float:
        """Time (s) at which samples rest."""
        return self.times[-1] if self.at is None else self.at

    def check_complete(self) -> None:
        """Check that there is something that moves the water, and soil through which it flows.

        Raises:
            ValueError: there is not.
        """
        name, needed, example = (
            ("[rain]", "rate", '"14 mm/h"')
            if isinstance(self, Rain)
            else ("[drawdown]", "level", '[["0 d", 8.0], ["5 d", 2.0]]')
        )
        if self.given_by is not None:
            return
        if getattr(self, needed) is None:
            raise Invalid((), name, f"lacks {needed}", f"add {needed} = {example}, or the pressure of another program")
        if self.soil is None and not self.layer:
            raise Invalid(
                (),
                name,
                "lacks the soil through which water flows",
                'add soil = { soil_class = "loam" }, or a conductivity and a retention',
            )

    def hydraulics(self, layer: str | None = None, *, rock: bool = False) -> tuple[Hydraulics, ...]:
        """The tables from which a layer, or ground without layers, has its numbers, its own first; none without water.

        Args:
            layer: its name, None in ground without layers.
            rock: whether it is rock, which lets no water through unless it is named.
        """
        of_layer = next((table for table in self.layer if table.name == layer), None)
        inherits = not rock if of_layer is None else of_layer.soil_class is None
        return tuple(table for table in (of_layer, self.soil if inherits else None) if table is not None)

    def with_conductivities(self, change: Callable[[RandomConductivity, Keys], RandomConductivity]) -> Self:
        """The table with another field in place of that of each conductivity that varies.

        Args:
            change: gives it, by the field and the keys that lead to it in this table.
        """

        def changed(part: H, *path: str | int) -> H:
            varies = part.conductivity
            if not isinstance(varies, RandomConductivity):
                return part
            return replace(part, conductivity=change(varies, (*path, CONDUCTIVITY)))

        soil = None if self.soil is None else changed(self.soil, "soil")
        return replace(self, soil=soil, layer=tuple(changed(layer, "layer", n) for n, layer in enumerate(self.layer)))

    def level_at(self, time: float) -> float | None:
        """Level (m) of the pool at a time (s), None without."""
        if self.level is None:
            return None
        times, levels = np.array(self.level).T
        return float(np.interp(time, times, levels))


@table
class Rain(Seepage):
    """Rain that soaks into the ground, see [water that moves](seepage.md#in-a-scene).

    At a time the slope rests under the pore pressure of that time, and is then asked whether it stands. The scene has
    soil with cohesion and friction, in one layer at least. Without `pressure` or `water_tables` it also has a state
    before time 0: `[water]` at rest below the ground, or `initial_rate`. `r_u`, `strength_ratio`, random unit weights
    and a random `[water.level]` are refused. A layer that `layer` does not name has `soil`; rock that it does not name
    lets no water through. A layer with a `soil_class` takes no number from `soil`. [Curves of the
    soil](seepage.md#soil) have their symbols. A text holds a unit, such as "14 mm/h", "12 h" or "0.9 m/day"; a number
    is in SI units.
    """

    @validates(mode="after")
    def _storms(self) -> Self:
        if self.chart is not None and not self.chart.durations:
            raise Invalid(("chart",), None, "lacks durations", 'add how long it rains, durations = ["6 h", "24 h"]')
        return self


@table
class Drawdown(Seepage):
    """A river or reservoir that is drawn down, or rises. Keys as in `[rain]`, with `level` in place of `rate`.

    The ground begins with the water at rest at the first level, unless `[water]` or `initial_rate` gives another state.
    """

    @validates(mode="after")
    def _falls(self) -> Self:
        if self.chart is not None and self.chart.durations:
            raise Invalid(
                ("chart", "durations"), None, "is of rain: a drawdown lasts until its level has fallen", "leave it out"
            )
        if self.chart is not None and self.level is not None and min(z for _, z in self.level) >= self.level[0][1]:
            raise Invalid(("level",), None, "does not fall, as chart has it do", "give lower ones, or leave chart out")
        return self
