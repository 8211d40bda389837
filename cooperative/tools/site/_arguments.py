"""Arguments of `jaxmpm site`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from cooperative.scene import national_origin
from cooperative.scene.tables import CORRELATIONS
from cooperative.tools.site._assumed import Assumed
from cooperative.tools.site._estimate import estimate_site
from cooperative.tools.site._section import read_section
from cooperative.tools.site._write import words, write_site
from cooperative.tools.soundings import SiteError
from jaxmpm import read_raster
from jaxmpm.support.text import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command.

    Args:
        parser: of the command.
    """
    parser.add_argument("files", type=Path, nargs="+", help="soundings and laboratory values: GEF, BRO XML, AGS4, CSV")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument(
        "--n-kt", type=float, nargs="+", metavar="N", help="cone factor of undrained strength, and its deviation"
    )
    parser.add_argument(
        "--layers", type=float, nargs="*", metavar="Z", help="elevations between layers, from the top down (proposed)"
    )
    parser.add_argument("--unit-weight", type=float, default=18e3, metavar="N/M3", help="of the soil (%(default)g)")
    parser.add_argument(
        "--area-ratio", type=float, metavar="A", help="net, of cones whose file has u_2 and none, such as 0.8"
    )
    parser.add_argument("--water", type=float, default=1.0, metavar="M", help="depth of the water table (%(default)g)")
    parser.add_argument("--line", type=float, nargs=4, metavar=("X0", "Y0", "X1", "Y1"), help="of a section")
    parser.add_argument(
        "--origin",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="to subtract in 3D (with --surface in a national grid a round corner of it, else 0 0)",
    )
    parser.add_argument(
        "--surface", type=Path, metavar="RASTER", help="heights of the ground, for a whole scene: ASCII grid or GeoTIFF"
    )
    parser.add_argument(
        "--section", type=Path, metavar="TOML", help="scene with [ground] and without soil, for a whole scene"
    )
    parser.add_argument(
        "--base", type=float, metavar="Z", help="elevation of the scene's base: none below conditions it"
    )
    parser.add_argument("--marginal", choices=("lognormal", "normal"), default="lognormal", help="(%(default)s)")
    parser.add_argument(
        "--correlation", choices=tuple(CORRELATIONS), default="exponential", metavar="FAMILY", help="(%(default)s)"
    )
    parser.add_argument(
        "--units", nargs="+", default=(), metavar="COLUMN=UNIT", help="of CSV columns whose header has none"
    )


def answer(given: argparse.Namespace) -> list[str]:
    """Estimate and write a site; the estimates in words, and what was written.

    Args:
        given: on the command line.

    Raises:
        ValueError: files or numbers that cannot be used.
    """
    if given.section is not None and given.surface is not None:
        raise SiteError("--section is ground of a section and --surface that of a terrain: give one of them")
    units = dict(each.partition("=")[::2] for each in given.units)
    line = None if given.line is None else (tuple(given.line[:2]), tuple(given.line[2:]))
    origin = given.origin
    if origin is None and given.surface is not None and line is None:
        origin = national_origin(read_raster(given.surface))
    section = None if given.section is None else read_section(given.section)
    assumed = Assumed(
        cone_factor(given.n_kt), given.unit_weight, given.water, given.marginal, given.correlation, line,
        tuple(origin or (0.0, 0.0)), given.base, given.area_ratio, section,
    )  # fmt: skip
    site = estimate_site(given.files, assumed, boundaries=given.layers, units=units, progress=_told)
    return [words(site), *map(str, write_site(site, given.out, given.surface))]


def _told(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)


def cone_factor(given: Sequence[float] | None) -> tuple[float, float] | None:
    """A cone factor N_kt with its standard deviation, 0 where one number is given; None for none.

    Args:
        given: one or two numbers.

    Raises:
        SiteError: others, or a deviation that no cone factor has.
    """
    if given is None:
        return None
    if len(given) > 2 or (len(given) == 2 and not 0 <= given[1] < given[0] / 2):
        raise SiteError(
            f"N_kt = {' '.join(f'{each:g}' for each in given)}: give its mean, such as 14, or mean and standard "
            "deviation, such as 14 2"
        )
    return float(given[0]), float(given[1]) if len(given) == 2 else 0.0
