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
from cooperative.tools.soundings import SiteError
from jaxmpm import read_raster
from jaxmpm.support.text import printable


def answer(given: argparse.Namespace) -> list[str]:
    """Estimate and write a site; the estimates in words, and what was written.

    Args:
        given: on the command line.

    Raises:
        ValueError: files or numbers that cannot be used.
    """
    if given.section is not None and given.surface is not None:
        raise SiteError("--section is ground of a section and --surface that of a terrain: give one of them")
    if given.correlation not in CORRELATIONS:
        raise SiteError(f"--correlation {given.correlation}: give one of {', '.join(CORRELATIONS)}")
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
