"""Tables of hazard and risk: `[hazard]` and `[[exposed]]`."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal, Self

from annotated_types import MaxLen, MinLen
from pydantic import AfterValidator, PlainValidator, Strict, ValidationInfo
from pydantic import model_validator as validates

from cooperative.measure import PUBLISHED, ElementAtRisk, Intensity, Vulnerability, quantity
from cooperative.scene.tables._key import (
    LONGEST_LABEL,
    Count,
    FromZero,
    Label,
    Metres,
    Number,
    OrFile,
    Pair,
    Part,
    Polygon,
    key,
    of_features,
    table,
)
from jaxmpm.support.check import Invalid


def _threshold(text: str) -> str:
    if not quantity(text)[1] > 0:
        raise Invalid((), repr(text), "", "give more than 0, what is reached is reported anyway")
    return text


def _quantity(text: str) -> str:
    quantity(text)
    return text


Threshold = Annotated[str, PlainValidator(_threshold, json_schema_input_type=str)]
Quantity = Annotated[str, PlainValidator(_quantity, json_schema_input_type=str)]
"""A text of a thickness or a speed and its unit."""


_NAMES = " or ".join(f'"{name}"' for name in PUBLISHED)
Pairs = Annotated[tuple[Annotated[tuple[Quantity, Number], Strict(False)], ...], Strict(False), MinLen(1)]
Curve = Pairs | Literal["totschnig 2011", "papathoma-koehle 2015"]


def _of_name(features: Any, info: ValidationInfo) -> Any:
    """The points of a polygon; of a file's, that of the element's name."""
    return of_features(features, info.data.get("name"), holes=True)


@table
class Hazard(Part):
    """Hazard maps.

    With this table, or `[[exposed]]`, each refined slide stores, for each column of cells, the largest thickness, the
    largest speed and the arrival of the soil above the surface that was there before, and how far that ground moved.
    Both keys have defaults.
    """

    thresholds: Annotated[tuple[Threshold, ...], Strict(False)] = key(
        "Thicknesses of the deposit (m, cm) and speeds (m/s, km/h) to map.",
        ["0.5 m", "1 m/s"],
        ("0.5 m", "1 m", "1 m/s"),
        units="in each",
        allowed="texts: a number above 0 and its unit",
    )
    every: Count = key("Steps between two evaluations of the columns.", 20, 20)

    @property
    def thickness(self) -> tuple[float, ...]:
        """Thresholds (m) whose exceedance is mapped, ascending."""
        return self._levels("thickness")

    @property
    def speed(self) -> tuple[float, ...]:
        """Thresholds (m/s) whose exceedance is mapped, ascending."""
        return self._levels("speed")

    def _levels(self, of: Intensity) -> tuple[float, ...]:
        levels = map(quantity, self.thresholds)
        return tuple(sorted({level for what, level in levels if what == of}))


@table
class Exposed(Part):
    """An element at risk, which a slide may reach: one table for each, with one of `at`, `between` and `polygon`.

    x and y are those of the scene, not counted from the toe.
    """

    name: Label = key("Its name, of which there is one.", "road", allowed=f"text of up to {LONGEST_LABEL} characters")
    at: Annotated[tuple[Metres, ...], Strict(False), MinLen(1), MaxLen(2)] | None = key(
        "A point: `[x]` in a section, `[x, y]` in 3D.", [72.0], None, allowed="[x] in a section, [x, y] in 3D"
    )
    between: Pair[Metres] | None = key(
        "In a section, the two ends of a stretch.", [70.0, 76.0], None, allowed="[from, to]"
    )
    polygon: Annotated[OrFile[Polygon] | None, AfterValidator(_of_name)] = key(
        "In 3D, the corners of a polygon in order. Or a polygon of a GeoPackage, shapefile or GeoJSON, whose holes are "
        "kept: that whose column `name`, in any case, is the name of the element, or the only one.",
        [[70, 5], [76, 5], [73, 12]],
        None,
        allowed='three or more corners [x, y], or a file and its layer, "site.gpkg#houses"',
    )
    value: FromZero | None = key("Value of what stands there, in any currency.", 250e3, None)
    vulnerability: Curve | None = key(
        "Share of the value that is lost, at values of the largest thickness or of the largest speed of the soil that "
        "comes above the element's ground. The curve has straight lines between its points and does not fall. Or the "
        "name of a [published curve](report.md#published-vulnerability-curves).",
        [["0 m", 0.0], ["1 m", 0.4], ["3 m", 1.0]],
        None,
        units="in each",
        allowed=f'pairs such as ["0.5 m", 0.2], a number with its unit and a share from 0 to 1, or {_NAMES}',
    )

    @validates(mode="after")
    def _complete(self) -> Self:
        shapes = [key for key in ("at", "between", "polygon") if getattr(self, key) is not None]
        if len(shapes) != 1:
            raise Invalid(
                (), None, f"has {' and '.join(shapes) or 'no position'}",
                "give one of at = [x] or [x, y], between = [from, to] in a section, polygon = [[x, y], ...] in 3D, in "
                "metres",
            )  # fmt: skip
        if (self.value is None) != (self.vulnerability is None):
            raise Invalid((), None, "has a value or a vulnerability alone", "give both together, or neither")
        if not isinstance(self.polygon, str):  # the name of a file that is not read
            self.element  # noqa: B018, raises for one that is none
        return self

    @cached_property
    def element(self) -> ElementAtRisk:
        """With its corners and its curve.

        Raises:
            ValueError: a curve that falls or leaves [0, 1], or corners that are no stretch and no polygon.
        """
        if self.polygon is not None:
            corners: Any = self.polygon
        else:
            corners = (self.at,) if self.between is None else tuple((x,) for x in self.between)
        return ElementAtRisk(self.name, corners, self.value, self._curve)

    @property
    def _curve(self) -> Vulnerability | None:
        if self.vulnerability is None:
            return None
        if isinstance(self.vulnerability, str):
            return PUBLISHED[self.vulnerability].curve
        quantities, lost = zip(*((quantity(text), share) for text, share in self.vulnerability), strict=True)
        kinds = {of for of, _ in quantities}
        if len(kinds) != 1:
            raise Invalid(("vulnerability",), None, f"is of {' and '.join(sorted(kinds))}", "give one of them")
        return Vulnerability(kinds.pop(), tuple(level for _, level in quantities), lost)
