"""Answers of `jaxmpm site` to its arguments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from cooperative.scene import national_origin
from cooperative.scene.tables import CORRELATIONS
from cooperative.tools.site._assumed import Assumed
from cooperative.tools.site._estimate import estimate_site
from cooperative.tools.site._section import read_section
from cooperative.tools.site._write import words, write_site
from jaxmpm import read_raster
from jaxmpm.support.text import printable


def answer(arguments: argparse.Namespace) -> list[str]:
    """Estimate and write a site; the estimates in words, and what was written.

    Args:
        arguments: of the command line.

    Raises:
        ValueError: files or numbers that cannot be used.
    """
    if arguments.section is not None and arguments.surface is not None:
        raise ValueError("--section is ground of a section and --surface that of a terrain: give one of them")
    if arguments.correlation not in CORRELATIONS:
        raise ValueError(f"--correlation {arguments.correlation}: give one of {', '.join(CORRELATIONS)}")
    units = dict(pair.partition("=")[::2] for pair in arguments.units)
    line = None if arguments.line is None else (tuple(arguments.line[:2]), tuple(arguments.line[2:]))
    origin = arguments.origin
    if origin is None and arguments.surface is not None and line is None:
        origin = national_origin(read_raster(arguments.surface))
    section = None if arguments.section is None else read_section(arguments.section)
    assumed = Assumed(
        cone_factor(arguments.n_kt), arguments.unit_weight, arguments.water, arguments.marginal,
        arguments.correlation, line,
        tuple(origin or (0.0, 0.0)), arguments.base, arguments.area_ratio, section,
    )  # fmt: skip
    site = estimate_site(arguments.files, assumed, boundaries=arguments.layers, units=units, progress=_told)
    return [words(site), *map(str, write_site(site, arguments.out, arguments.surface))]


def _told(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)


def cone_factor(numbers: Sequence[float] | None) -> tuple[float, float] | None:
    """A cone factor N_kt with its standard deviation, 0 where one number is given; None for none.

    Args:
        numbers: one or two.

    Raises:
        ValueError: others, or a deviation that no cone factor has.
    """
    if numbers is None:
        return None
    if len(numbers) > 2 or (len(numbers) == 2 and not 0 <= numbers[1] < numbers[0] / 2):
        raise ValueError(
            f"N_kt = {' '.join(f'{number:g}' for number in numbers)}: give its mean, such as 14, or mean and standard "
            "deviation, such as 14 2"
        )
    return float(numbers[0]), float(numbers[1]) if len(numbers) == 2 else 0.0
