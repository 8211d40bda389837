"""Figures of the published study beside ours, of as much as there is."""

from __future__ import annotations

from pathlib import Path

from benchmarks.study.study_figures._chances import lengths, ranks, readings
from benchmarks.study.study_figures._headline import against
from benchmarks.study.study_figures._slides import fits, modes
from benchmarks.study.study_figures._study import Study
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
    """Draw what there is; returns the files. A figure without any of its data is not drawn."""
    drawn = {name: figure for name, of in FIGURES.items() if (figure := of(study)) is not None}
    return [save(figure, folder / f"published_{name}.png", dpi=100) for name, figure in drawn.items()]
