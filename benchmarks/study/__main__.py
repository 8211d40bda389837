"""`python -m benchmarks.study [CASE ...]`: run the campaigns of the published study anew, in out/study.

A case with a random field is a campaign: a folder that goes on where it was stopped, with its report. One without is a
search for the factors of safety of both grids. `--draw` draws a typical slide of each failure mode instead, in
benchmarks/figures. `python -m benchmarks published` compares the stored rows, benchmarks/data/study_*.csv.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cooperative
from benchmarks.measure import ROOT
from benchmarks.results import FIGURES
from benchmarks.study.cases import CASES, campaign_of, plan_of
from benchmarks.study.draw import draw
from benchmarks.study.rows import read_study
from cooperative.measure import SEVERITY
from cooperative.scene import factors_of_safety


def run_case(case: str, folder: Path, workers: int = 1) -> str:
    """Run a case.

    Args:
        case: name in `CASES`.
        folder: where the folders of campaigns are.
        workers: parallel processes.

    Returns:
        The answer in words.
    """
    definition, plan = CASES[case], plan_of(case)
    changes = definition["changes"]
    campaign = campaign_of(definition["scene"], {**changes, "campaign": {**changes.get("campaign", {}), **plan}})
    if not plan:
        soil = cooperative.random_soil(campaign)
        factors = factors_of_safety(
            campaign, {grid: cooperative.build(campaign, grid, soil) for grid in campaign.grids}
        )
        return f"{case}: factor of safety {factors.rough:.2f} rough, {factors.refined:.2f} refined"
    cooperative.run(campaign, folder / case, workers=workers)
    return f"{case}: {cooperative.report(folder / case)}"


def main() -> None:
    """Parse the command line and run the cases."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.study", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"some of: {'; '.join(CASES)}; all by default")
    parser.add_argument("--workers", type=int, default=1, help="parallel processes")
    parser.add_argument("--draw", action="store_true", help="run and draw a typical slide of each mode, nothing else")
    parser.add_argument("--modes", nargs="+", choices=SEVERITY, default=SEVERITY, help="to draw; all by default")
    arguments = parser.parse_args()
    if unknown := set(arguments.cases) - set(CASES):
        parser.error(f"case {min(unknown)!r}: give some of {'; '.join(CASES)}")
    if arguments.draw:
        pictures, broke_off = draw(read_study(), FIGURES, arguments.modes)
        print(*pictures, sep="\n")
        sys.exit("\n".join(broke_off) or None)
    for case in arguments.cases or CASES:
        print(run_case(case, ROOT / "out" / "study", arguments.workers), flush=True)


if __name__ == "__main__":
    main()
