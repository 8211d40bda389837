"""Rows of the study, one per run, from small CSV files."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from benchmarks.csv_rows import ENDED, optional, read_rows, size, text, whole, word
from benchmarks.measure import ROOT
from benchmarks.study.cases import FAILS_ABOVE, MORE_AIR
from cooperative.estimate import Population
from cooperative.measure import SEVERITY
from jaxmpm import Status

DATA = ROOT / "benchmarks" / "data"
FILES = (
    *("fos_rough", "section_fos", "section", "fos_refined", "screening", "fos_rollers", "slide", "audit", "on_cpu"),
    *("fos_default", "default", "section_default", "screening_rollers", "audit_rollers", "sweep", "sweep_audit"),
    *("slides", "slides_more_air", "sweep_slides", "ranked", "table_3", "slides_added"),
)
"""`study_NAME.csv` each; of a run that several have, the first stands."""

Until = Literal["class", "end"]
CPU = "cpu"


@dataclass(frozen=True)
class Run:
    """One simulation.

    Attributes:
        case: its name in `cases.CASES`.
        grid: "rough" or "refined".
        sample: number of the random field, 0 where the case has none.
        reduction: factor by which the strength is divided.
        until: "class" ends it once its class is decided, "end" lets it go on to its end.
    """

    case: str
    grid: str
    sample: int = 0
    reduction: float = 1.0
    until: Until = "class"


@dataclass(frozen=True)
class Outcome:
    """Result of a run. What only a slide has is None where the run ended with its class or stood.

    Attributes:
        status: name of a `jaxmpm.Status`.
        displacement: the largest at the end (m).
        time: simulated (s).
        steps: number of time steps.
        seconds: of one core, or of the GPU, of which lanes and processes that share it have their shares.
        runout: of a slide where a tenth of the slope's height is left (m); None too where the row lacks it.
        runout_foremost: of its foremost soil (m).
        depth: of a slide (m).
        volume: of a slide (m3).
        area: of a slide beyond the toe (m2).
        mode: failure mode of a slide.
        masses: number of masses side by side that let go.
        onset: when the first mass let go (s).
        onset_second: when the second did, or a second pulse began (s).
        displacement_any: largest displacement with detached grains (m).
        runout_any: run-out with detached grains (m).
        device: "cpu", or JAX's name of the GPU.
    """

    status: str
    displacement: float
    time: float
    steps: int
    seconds: float
    runout: float | None = None
    runout_foremost: float | None = None
    depth: float | None = None
    volume: float | None = None
    area: float | None = None
    mode: str | None = None
    masses: int | None = None
    onset: float | None = None
    onset_second: float | None = None
    displacement_any: float | None = None
    runout_any: float | None = None
    device: str = CPU

    @property
    def broke_off(self) -> bool:
        """Whether the run ended for numerical reasons."""
        return Status[self.status] > Status.DECIDED

    @property
    def failed(self) -> bool | None:
        """Whether the slope failed; None for a run that broke off."""
        return None if self.broke_off else self.displacement > FAILS_ABOVE

    @property
    def score(self) -> float:
        """What samples are ranked by (m), nan if the run broke off: the displacement of a slope that stood. Of one that
        failed, the displacement after 20 s at its mean speed so far, so that slopes that fail sooner rank above."""
        if self.broke_off:
            return float("nan")
        return self.displacement * (max(1.0, 20.0 / self.time) if self.failed else 1.0)


Rows = dict[Run, Outcome]
RUN = tuple(field.name for field in fields(Run))
COLUMNS = {
    **{"case": text, "grid": word("rough", "refined"), "sample": whole, "reduction": size},
    **{"until": word(*get_args(Until)), "status": word(*ENDED)},
    **{"displacement": size, "time": size, "steps": whole, "seconds": size},
    **dict.fromkeys(("runout", "runout_foremost", "depth", "volume", "area"), optional(size)),
    **{"mode": optional(word(*SEVERITY)), "masses": optional(whole)},
    **dict.fromkeys(("onset", "onset_second", "displacement_any", "runout_any"), optional(size)),
    "device": text,
}


def read_table(path: Path) -> Rows:
    """Rows of a file, whose first line describes each case and whose second names the columns.

    Raises:
        ValueError: naming file and line, for other columns and for a row that does not parse or occurs twice.
    """
    outcome = [name for name in COLUMNS if name not in RUN]
    rows = read_rows(path, COLUMNS, RUN, comments=1)
    return {Run(*key): Outcome(*(row[name] for name in outcome)) for key, row in rows.items()}


def read_study() -> Rows:
    """The rows of all files. ValueError for one that does not parse."""
    together: Rows = {}
    for name in FILES:
        together = read_table(DATA / f"study_{name}.csv") | together
    return together


def of_search(rows: Rows, case: str, grid: str) -> dict[float, bool | None]:
    """Reductions that were tried for a factor of safety, and whether the slope failed."""
    return {
        run.reduction: o.failed for run, o in rows.items() if (run.case, run.grid, run.until) == (case, grid, "class")
    }


def factor_of_safety(rows: Rows, case: str, grid: str) -> float | None:
    """The least reduction factor that fails; None without runs."""
    return min((reduction for reduction, fails in of_search(rows, case, grid).items() if fails), default=None)


def population(rows: Rows, case: str, samples: int, reduction: float = 1.0) -> Population:
    """The screened samples as the estimators take them."""
    return Population(np.array([rows[Run(case, "rough", number, reduction)].score for number in range(samples)]))


def classes(rows: Rows, case: str, grid: str) -> dict[int, bool | None]:
    """Samples of a case that ran on a grid, and whether they failed."""
    return {run.sample: o.failed for run, o in rows.items() if (run.case, run.grid, run.until) == (case, grid, "class")}


def calibration(rows: Rows) -> float:
    """Reduction of the rough grid's strength that makes it fail as easily as the refined one."""
    rough, refined = (factor_of_safety(rows, "mean strength", grid) for grid in ("rough", "refined"))
    assert rough is not None
    assert refined is not None
    return round(rough / refined, 3)


def refined_slide(rows: Rows, sample: int) -> Outcome:
    """The refined slide of a sample of the headline campaign, on the higher grid where it left the other."""
    runs = (Run(case, "refined", sample, 1.0, "end") for case in (MORE_AIR, "published"))
    return next(rows[run] for run in runs if run in rows)
