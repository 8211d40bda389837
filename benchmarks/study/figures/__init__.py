"""Figures of the published study beside this one."""

from __future__ import annotations

from pathlib import Path

from benchmarks.study.figures._chances import lengths, ranks, readings
from benchmarks.study.figures._headline import against
from benchmarks.study.figures._slides import fits, modes
from benchmarks.study.figures._study import Study
from cooperative.reporting import save

__all__ = ["Study", "draw"]

FIGURES = {
    "against": against,
    "fits": fits,
    "lengths": lengths,
    "modes": modes,
    "ranks": ranks,
    "readings": readings,
}


def draw(study: Study, folder: Path) -> list[Path]:
    """Draw all figures; returns the files."""
    return [save(figure(study), folder / f"published_{name}.png", dpi=100) for name, figure in FIGURES.items()]
