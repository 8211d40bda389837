"""Tables of hazard and risk: `[hazard]` and `[[exposed]]`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from annotated_types import Ge, MaxLen, MinLen
from pydantic import PlainValidator, Strict
from pydantic import model_validator as validates

from cooperative.measure import PUBLISHED, Intensity, Vulnerability, quantity
from cooperative.scene.tables._key import (
    FromZero,
    Metres,
    Number,
    OrFile,
    Pair,
    Polygon,
    Table,
    key,
    of_features,
    plain_name,
)

LONGEST_NAME = 60


def _threshold(value: object) -> tuple[Intensity, float]:
    of, level = quantity("", value)
    if not level > 0:
        raise ValueError(f" = {value!r}: give more than 0, what is reached is reported anyway")
    return of, level


Threshold = Annotated[tuple[Intensity, float], PlainValidator(_threshold, json_schema_input_type=str)]
Quantity = Annotated[
    tuple[Intensity, float], PlainValidator(lambda value: quantity("", value), json_schema_input_type=str)
]
"""What a text measures, thickness or speed, and how much of it (m, m/s)."""


_NAMES = " or ".join(f'"{name}"' for name in PUBLISHED)
Pairs = Annotated[tuple[Annotated[tuple[Quantity, Number], Strict(False)], ...], Strict(False)]
Curve = Pairs | Literal["totschnig 2011", "papathoma-koehle 2015"]


class Hazard(Table):
    """Hazard maps.

    With this table, or `[[exposed]]`, each refined slide stores, for each column of cells, the largest thickness, the
    largest speed and the arrival of the soil above the surface that was there before, and how far that ground moved.
    Both keys may be left out.
    """

    thresholds: Annotated[tuple[Threshold, ...], Strict(False)] = key(
        "Thicknesses of the deposit (m, cm) and speeds (m/s, km/h) to map.",
        ["0.5 m", "1 m/s"],
        ["0.5 m", "1 m", "1 m/s"],
        units="in each",
        allowed="texts: a number above 0 and its unit",
    )
    every: Annotated[int, Ge(1)] = key("Steps between two evaluations of the columns.", 20, 20)


class Exposed(Table):
    """An element at risk, which a slide may reach: one table for each, with one of `at`, `between` and `polygon`."""

    name: Annotated[str, plain_name(LONGEST_NAME)] = key(
        "Its name, of which there is one.", "road", allowed=f"text of up to {LONGEST_NAME} characters"
    )
    at: Annotated[tuple[Metres, ...], Strict(False), MinLen(1), MaxLen(2)] | None = key(
        "A point: `[x]` in a section, `[x, y]` in 3D.", [72.0], None, allowed="[x] in a section, [x, y] in 3D"
    )
    between: Pair[Metres] | None = key(
        "In a section, the two ends of a stretch.", [70.0, 76.0], None, allowed="[from, to]"
    )
    polygon: OrFile[Polygon] | None = key(
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
            raise ValueError(
                f" has {' and '.join(shapes) or 'no position'}: give one of at = [x] or [x, y], between = [from, to] "
                "in a section, polygon = [[x, y], ...] in 3D, in metres"
            )
        if (self.value is None) != (self.vulnerability is None):
            raise ValueError(": give value and vulnerability together, or neither")
        self.curve  # noqa: B018, raises for one that is none
        return self

    @property
    def corners(self) -> tuple[tuple[float, ...], ...]:
        """Of the position: one point, the two ends of a stretch, or the corners of a polygon."""
        if self.between is not None:
            return tuple((x,) for x in self.between)
        if self.at is not None:
            return (self.at,)
        return of_features(self.polygon, "[[exposed]] polygon", self.name, holes=True)

    @property
    def curve(self) -> Vulnerability | None:
        """Of the vulnerability.

        Raises:
            ValueError: the end of a message, for one that falls or leaves [0, 1].
        """
        if self.vulnerability is None:
            return None
        if isinstance(self.vulnerability, str):
            return PUBLISHED[self.vulnerability].curve
        kinds = {of for (of, _), _ in self.vulnerability}
        if len(kinds) != 1:
            raise ValueError(f" vulnerability is of {' and '.join(sorted(kinds)) or 'nothing'}: give one of them")
        levels, lost = zip(*((level, share) for (_, level), share in self.vulnerability), strict=True)
        try:
            return Vulnerability(kinds.pop(), levels, lost)
        except ValueError as error:
            raise ValueError(f" {error}") from error
