"""Tables that scenes of several tests share, and the models of such scenes."""

from __future__ import annotations

from pathlib import Path

from cooperative import runs
from cooperative.scene import parse
from cooperative.store import Source


def model_of(
    scene: str | Path | Source, grid: str = "rough", *, at_rest: bool = False, folder: Path | None = None
) -> runs.GridModel:
    """The model of a scene's grid; without its stress at rest, unless asked for."""
    campaign = parse(scene)
    return runs.build(campaign, grid, runs.random_soil(campaign), at_rest=at_rest, folder=folder)


def tables(cell: float = 2.0, run: str = "t_end = 4.0") -> str:
    """Both grids, the refined one of half the cell (m) and each of two particles a cell along an axis, the lines of the
    run, and a campaign of ten samples."""
    grids = "".join(
        f"[{name}]\ncell = {size}\nspacing = [{size / 2}, {size / 2}]\n"
        for name, size in (("rough", cell), ("refined", cell / 2))
    )
    return f"{grids}[run]\n{run}\n[campaign]\nsamples = 10\nseed = 3\nrefined_runs = 10\n"


GEF = """#GEFID= 1, 1, 0
#COLUMN= 3
#COLUMNINFO= 1, m, Sondeerlengte, 1
#COLUMNINFO= 2, {unit}, Conusweerstand, 2
#COLUMNINFO= 3, {unit}, Plaatselijke wrijving, 3
#COLUMNVOID= 2, -999999
#COLUMNVOID= 3, -999999
#COLUMNSEPARATOR= ;
#RECORDSEPARATOR= !
#LASTSCAN= {count}
#PROCEDURECODE= GEF-CPT-Report, 1, 1, 0, -
#TESTID= {name}
#XYID= 31000, {x}, {y}
#ZID= 31000, {top}
#EOH=
{rows}
"""


def write_gef(path, x, cone, *, y=433e3, top=-1.5, unit="MPa"):
    """A cone penetration test in GEF with readings of the cone each 0.1 m, and a sleeve friction of 3 %."""
    rows = "\n".join(
        f"{0.1 * k:.2f};{resistance};{max(0.03 * resistance, -999999)};!" for k, resistance in enumerate(cone)
    )
    path.write_text(GEF.format(unit=unit, count=len(cone), name=path.stem, x=x, y=y, top=top, rows=rows))
    return path
