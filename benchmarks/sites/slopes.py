"""Slopes with known factors of safety, as sections from their published coordinates.

Lengths m, stresses Pa, angles degrees. Slopes drawn towards -x are mirrored; those drawn in feet have cells that divide
feet. Young's modulus 1e8 Pa, Poisson's ratio 0.3, no dilation. `cases` are slopes that the usual cells and settings
serve, `special_cases` those that ask for more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jaxmpm as mpm
from jaxmpm import FrictionalSoil, Interface, Layer, Section, Soil

FOOT = 0.3048


@dataclass(frozen=True)
class Case:
    """A slope and the factor of safety to hold it against.

    reference: by strength reduction where published. cells: m, the coarsest first. source: of section and answer.
    loads: of the section. choices: of the discretisation, beside the usual ones. figure: what a benchmark calls its
    error, where it has a name of its own. highest: factor up to which it is looked for, over the reference.
    """

    name: str
    reference: float
    source: str
    shape: Section
    soil: FrictionalSoil | Soil | Sequence[Layer]
    cells: tuple[float, ...]
    loads: dict[str, Any] = field(default_factory=dict)
    choices: dict[str, Any] = field(default_factory=dict)
    figure: str = ""
    highest: float = 1.25

    def built(
        self, cell: float, *, across: int = 2, at_rest: bool = True, **choices: Any
    ) -> tuple[mpm.Scene, mpm.State]:
        """The section on cells of this size (m) with so many particles across.

        Strain is averaged over cells. Soil with friction has a share of PIC, without which grains at its surface creep
        on.
        """
        soil = self.soil[0].soil if isinstance(self.soil, Sequence) else self.soil
        usual = {"cell_average": True} if isinstance(soil, Soil) else {"flip": 0.99}
        numerics = mpm.Discretisation(cell, (cell / across,) * 2, **(usual | self.choices | choices))
        return mpm.section(self.shape, self.soil, numerics, at_rest=at_rest, **self.loads)


def _mirrored(line: Sequence[Sequence[float]], end: float) -> list[tuple[float, float]]:
    """The line drawn from the wall at x = end (m) backwards."""
    return [(end - x, z) for x, z in reversed(line)]


def _acads() -> list[Case]:
    source = "Giam and Donald (1989), ACADS"
    end = 70.0
    shape = Section(_mirrored([(20, 25), (30, 25), (50, 35), (70, 35)], end), base=20.0)
    second = _mirrored([(30, 25), (50, 29), (54, 31), (70, 31)], end)
    third = _mirrored([(20, 25), (30, 25), (40, 27), (52, 24), (70, 24)], end)
    layers = [
        Layer(FrictionalSoil(0.0, 38.0, unit_weight=19.5e3), second),
        Layer(FrictionalSoil(5.3e3, 23.0, unit_weight=19.5e3), third),
        Layer(FrictionalSoil(7.2e3, 20.0, unit_weight=19.5e3)),
    ]
    hill = Section(_mirrored([(20, 27.75), (43, 27.75), (67.5, 40), (84, 40)], 84.0), base=20.0)
    soil = FrictionalSoil(28.5e3, 20.0, unit_weight=18.84e3)
    band = [
        Layer(soil, [(0, 27), (64, 27)]),
        Layer(FrictionalSoil(0.0, 10.0, unit_weight=18.84e3, unusual=True), [(0, 26.5), (64, 26.5)]),
        Layer(soil),
    ]
    plain, cells = FrictionalSoil(3e3, 19.6, unit_weight=20e3), (1.0, 0.5)
    return [
        Case("ACADS 1a", 0.988, source, shape, plain, cells),
        Case("ACADS 1c", 1.35, source, shape, layers, cells),
        Case("ACADS 1d", 0.96, source, shape, layers, cells, {"k_h": 0.15}),
        Case("ACADS 3a", 1.26, source, hill, band, (0.5, 0.25), {"water": 26.5}),
    ]


def _griffiths_lane() -> list[Case]:
    source, height = "Griffiths and Lane (1999), 10.1680/geot.1999.49.3.387", 50 * FOOT
    # The rigid base is at the level of the toe; 1:2, then 100 feet of base before it.
    fill = Section([(0, height), (18.288, height), (48.768, 0), (79.248, 0)])
    soil = FrictionalSoil(14963.0, 20.0, unit_weight=19636.0)
    cells = (10 * FOOT / 3, 5 * FOOT / 3)
    cases = [Case("Griffiths and Lane 1", 1.38, source, fill, soil, cells)]
    cut = Section([(0, 30.48), (30.48, 30.48), (60.96, 15.24), (91.44, 15.24)])
    for ratio, reference in ((1, 1.46), (2, 2.04)):
        layers = [
            Layer(Soil(19636.0, strength=74813.0, tension_cutoff=None), [(0, 15.24), (91.44, 15.24)]),
            Layer(Soil(19636.0, strength=74813.0 * ratio, tension_cutoff=None)),
        ]
        name = f"Griffiths and Lane 4, ratio {ratio}"
        cases.append(Case(name, reference, source, cut, layers, (5 * FOOT, 2.5 * FOOT)))
    for share, reference in ((-0.2, 1.83), (0.0, 1.83), (0.4, 1.40), (0.7, 1.30), (1.0, 1.38)):
        loads = {"water": height * (1 - share)}
        cases.append(Case(f"Griffiths and Lane 5, L/H {share:g}", reference, source, fill, soil, cells, loads))
    return cases


def _fredlund_krahn() -> list[Case]:
    shape = Section([(0, 18.288), (18.288, 18.288), (42.672, 6.096), (54.864, 6.096)])
    soil = FrictionalSoil(28728.0, 20.0, unit_weight=18850.0)
    line = [(0, 12.192), (42.672, 6.096), (54.864, 6.096)]
    loads: list[tuple[str, float, dict[str, Any]]] = [
        ("dry", 1.98, {}),
        ("r_u 0.25", 1.68, {"r_u": 0.25}),
        ("piezometric line", 1.77, {"water": line}),
    ]
    source = "Fredlund and Krahn (1977), 10.1139/t77-045; strength reduction as published since"
    return [
        Case(f"Fredlund and Krahn, {name}", answer, source, shape, soil, (4 * FOOT, 2 * FOOT), load)
        for name, answer, load in loads
    ]


def _submerged() -> list[Case]:
    shape = Section(_mirrored([(0, 4.572), (9.144, 4.572), (32.004, 13.716), (42.672, 13.716)], 42.672))
    soil = FrictionalSoil(4788.0, 20.0, unit_weight=20107.0)
    source = "Duncan and Wright (2005), Soil Strength and Slope Stability"
    cells = (5 * FOOT, 2.5 * FOOT)
    return [
        Case(f"Submerged face, pool {pool:g} m", 1.59, source, shape, soil, cells, {"water": pool})
        for pool in (22.86, 32.004)
    ]


def _published() -> list[Case]:
    shape = Section([(0, 16), (30, 16), (54, 4), (96, 4)])
    source = "Jiang et al. (2024), 10.1016/j.compgeo.2024.106413, without softening; slip circles"
    return [Case("Published section", 1.142, source, shape, Soil(strength=42e3, tension_cutoff=0.0), (2.0, 1.0))]


def _verification() -> list[Case]:
    """Slopes by which programs for slices are verified, from their published coordinates.

    The cut of Low (1989) has clay whose strength grows by 3.75 kPa/m, in layers of 0.5 m. The section in feet is drawn
    both ways.
    """
    low = "Low (1989), 10.1061/(ASCE)0733-9410(1989)115:2(211), as verification problem of Slide and xslope"
    end, fill = 60.0, FrictionalSoil(95e3, 15.0, unit_weight=20e3)
    banks = Section(_mirrored([(0, 8), (20, 8), (36, 16), (60, 16)], end))
    over = [Layer(fill, [(0, 8), (end, 8)]), Layer(Soil(20e3, strength=15e3, tension_cutoff=0.0), [(0, 4), (end, 4)])]
    growing = [*over, *_growing(20e3, 15e3, 3750.0, 4.0, 8, end)]
    hill = Section([(0, 14), (20, 14), (34, 9), (38, 8), (60, 8)])
    three = [
        Layer(Soil(18e3, strength=30e3, tension_cutoff=0.0), [(0, 9), (34, 9), (38, 8), (60, 8)]),
        Layer(Soil(18e3, strength=20e3, tension_cutoff=0.0), [(0, 5), (60, 5)]),
        Layer(Soil(18e3, strength=150e3, tension_cutoff=0.0)),
    ]
    plain = Section(_mirrored([(0, 5), (5, 5), (15, 10), (25, 10)], 25.0))
    greco = Section(_mirrored([(0, 40), (60, 40), (180, 100), (200, 100), (260, 70)], 260.0), toe=200.0, crest=80.0)
    soils = [(49e3, 29.0, 20380.0), (0.0, 30.0, 17640.0), (7840.0, 20.0, 20380.0), (0.0, 30.0, 17640.0)]
    four = [
        Layer(FrictionalSoil(c, phi, unit_weight=weight), None if bottom is None else [(0, bottom), (260, bottom)])
        for (c, phi, weight), bottom in zip(soils, (40, 35, 26, None), strict=True)
    ]
    return [
        Case("Low 1989, clay that grows with depth", 1.14, low, banks, growing, (1.0, 0.5)),
        Case("Low 1989, three clays", 1.44, low, hill, three, (1.0, 0.5)),
        Case("Yamagami and Ueta 1988", 1.33, "Yamagami and Ueta (1988); Greco (1996), "
             "10.1061/(ASCE)0733-9410(1996)122:7(517)", plain, FrictionalSoil(9.8e3, 10.0, unit_weight=17640.0),
             (0.5, 0.25)),
        Case("Greco 1996, example 4", 1.40, "Greco (1996), 10.1061/(ASCE)0733-9410(1996)122:7(517)", greco, four,
             (4.0, 2.0)),
        *_soft_foundation(),
        *_two_ways("Silt over sand and clay", 0.762),
    ]  # fmt: skip


def _growing(unit_weight: float, strength: float, rate: float, top: float, count: int, end: float) -> list[Layer]:
    """Clay from a top (m) down to the base at 0 whose strength (Pa) grows at a rate (Pa/m), in layers of one."""
    thickness = top / count
    return [
        Layer(
            Soil(unit_weight, strength=strength + rate * thickness * (number + 0.5), tension_cutoff=0.0),
            None
            if number == count - 1
            else [(0, top - thickness * (number + 1)), (end, top - thickness * (number + 1))],
        )
        for number in range(count)
    ]


def _soft_foundation() -> list[Case]:
    """A fill of sand on clay, whose strength grows with depth in one of both."""
    source, end, psf = "Duncan and Wright (2005), Soil Strength and Slope Stability, Fig. 15.9", 150 * FOOT, 47.880
    ground = _mirrored([(0, 20 * FOOT), (50 * FOOT, 20 * FOOT), (100 * FOOT, 40 * FOOT), (end, 40 * FOOT)], end)
    sand = Layer(FrictionalSoil(0.0, 35.0, unit_weight=19636.0), [(0, 20 * FOOT), (end, 20 * FOOT)])
    return [
        Case(f"Duncan and Wright 15.9, {rate:g} psf/ft", reference, source, Section(ground),
             [sand, *_growing(15709.0, 300 * psf, rate * psf / FOOT, 20 * FOOT, count, end)], (2.5 * FOOT, 1.25 * FOOT))
        for rate, count, reference in ((0.0, 1, 0.75), (15.0, 8, 1.13))
    ]  # fmt: skip


def _two_ways(name: str, reference: float) -> list[Case]:
    """One slope drawn so that it falls to the right and to the left."""
    end, source = 97.536, "xslope, input_template_rface6 and lface6; the reference is Spencer's method on circles"
    surface = [(0, 25.603), (45.72, 25.603), (53.249, 19.507), (62.271, 12.192), (end, 12.192)]
    soils = [
        (FrictionalSoil(9576.0, 28.0, unit_weight=20421.0), [(0, 19.507), (53.249, 19.507)]),
        (FrictionalSoil(4788.0, 32.0, unit_weight=18850.0), [(0, 12.192), (62.271, 12.192), (end, 12.192)]),
        (FrictionalSoil(19152.0, 27.0, unit_weight=20736.0), None),
    ]
    water = [(0, 24.384), (22.86, 24.079), (34.138, 23.165), (42.672, 21.336), (51.816, 18.593), (57.76, 15.85),
             (62.271, 12.192), (end, 12.192)]  # fmt: skip
    right = [Layer(soil, line) for soil, line in soils]
    left = [Layer(soil, None if line is None else _mirrored(line, end)) for soil, line in soils]
    cells = (end / 48, end / 96)
    return [
        Case(f"{name}, to the right", reference, source, Section(surface), right, cells, {"water": water}),
        Case(f"{name}, to the left", reference, source, Section(_mirrored(surface, end)), left, cells,
             {"water": _mirrored(water, end)}),
    ]  # fmt: skip


FAMILIES: tuple[Callable[[], list[Case]], ...] = (
    _acads, _griffiths_lane, _fredlund_krahn, _submerged, _published, _verification,
)  # fmt: skip


def cases() -> list[Case]:
    """All of them."""
    return [case for family in FAMILIES for case in family()]


SOFT = 1e7
"""Young's modulus (Pa) of special cases on small cells, whose time step it lets be three times as long: the factor of
the weak seam in half a cell is 1.72 with it and 1.73 with 1e8 Pa."""


def _weak_seam(r_u: float | None, reference: float) -> list[Case]:
    """A weak seam a foot thick on rock, drawn as a layer, and as the strength of the base in its place."""
    surface, seam = [(0, 18.288), (18.288, 18.288), (42.672, 6.096), (54.864, 6.096)], (0.0, 10.0)
    base, water = 4.572, "dry" if r_u is None else f"r_u {r_u:g}"
    line = [(0, base + FOOT), (54.864, base + FOOT)]
    soil, weak = (FrictionalSoil(*strength, unit_weight=18850.0, young=SOFT) for strength in ((28728.0, 20.0), seam))
    loads = {} if r_u is None else {"r_u": r_u}
    source = "Fredlund and Krahn (1977), 10.1139/t77-045; strength reduction as published since"
    rock = Section(surface, base=base, interface=Interface(cohesion=seam[0], friction=seam[1]))
    name, figure = "Fredlund and Krahn, weak seam", f"fos_error_weak_seam_{water.split()[0]}"
    layers = [Layer(soil, line), Layer(replace(weak, unusual=True))]
    return [
        Case(f"{name}, {water}", reference, source, Section(surface, base=base), layers, (2 * FOOT, FOOT), loads,
             figure=figure, highest=1.5),
        Case(f"{name} as the strength of the base, {water}", reference, source, rock, soil, (3 * FOOT, 2 * FOOT), loads,
             figure=f"{figure}_on_base"),
    ]  # fmt: skip


def special_cases() -> list[Case]:
    """A seam thinner than a cell, a thin weak band, and sand half of whose weight the water bears."""
    end, unit_weight = 96.0, 18820.0
    surface = _mirrored([(0, 15), (18, 15), (48, 35), (96, 35)], end)
    bottoms = [_mirrored(line, end) for line in ([(18, 15), (24, 19), (72, 35), (96, 35)], [(0, 3), (96, 35)])]
    strengths = ((29.4e3, 12.0), (9.8e3, 5.0), (294e3, 40.0))
    soils = [FrictionalSoil(*strength, unit_weight=unit_weight, young=SOFT) for strength in strengths]
    band = [Layer(soil, bottom) for soil, bottom in zip(soils, [*bottoms, None], strict=True)]
    face = Section([(0, 40), (10, 40), (70, 10), (80, 10)])
    sand = FrictionalSoil(10.8e3, 40.0, unit_weight=18e3)
    return [
        *_weak_seam(None, 1.34),
        *_weak_seam(0.25, 1.05),
        Case("Arai and Tagyo 2", 0.417, "Arai and Tagyo (1985); strength reduction",
             Section(surface), band, (1.5, 0.75), figure="fos_error_arai_tagyo_2"),
        Case("Spencer 1969, r_u 0.5", 0.98, "Spencer (1969); strength reduction",
             face, sand, (2.0,), {"r_u": 0.5}, {"flip": 0.95}, "fos_error_spencer_1969"),
    ]  # fmt: skip
