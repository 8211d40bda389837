"""What ranks samples in place of a coarse grid: factors of safety by slices, a regression, and two that mislead.

`python -m benchmarks.statistics.surrogate` prints a row for each. The population is that of
`benchmarks.statistics.section_pairs` with the published settings: 400 samples of the paper's section, which ran on both
grids. `--scores` first writes their scores to `benchmarks/data/section_scores.csv`: minus the factor of safety by
slices, and a ridge regression of the logarithm of the rough displacement on the coefficients, trained on the first
hundred samples. A campaign draws its samples from the 400 with replacement, so that the share that fails is the truth.
It ends at a coefficient of variation of 10 per cent. `rough` is the number of its rough runs, `refined_*` the quartiles
of its refined ones.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from benchmarks.csv_rows import number, whole
from benchmarks.csv_rows import read_rows as rows_of
from benchmarks.statistics.section_pairs import DATA, read, study
from cooperative.estimate import Population, Sampling, TwoPhase, all_samples, draw_samples, two_phase
from cooperative.runs import coefficients_of, random_soil, screened_by
from cooperative.tools.safety import rank_by_slices

SCORES = DATA / "section_scores.csv"
COLUMNS = {"number": whole, "slices": number, "regression": number}
TRAINED, RIDGE = 100, 30.0
"""Samples whose rough displacements train the regression; its penalty on squared coefficients."""
LIMIT, TARGET = 1.0, 0.1


def regression(coefficients: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Ridge regression of the logarithm of a displacement on coefficients, for all samples (samples,).

    Args:
        coefficients: of the samples (samples, modes).
        displacement: of the first of them (trained,) m.
    """
    trained, target = coefficients[: displacement.size], np.log(displacement)
    gram = trained.T @ trained + RIDGE * np.eye(trained.shape[1])
    return coefficients @ np.linalg.solve(gram, trained.T @ (target - target.mean())) + target.mean()


def write_scores() -> None:
    """Score the 400 samples."""
    campaign = study("paper_section")
    coefficients = np.asarray(coefficients_of(campaign, random_soil(campaign)), float)
    slices = rank_by_slices(campaign, coefficients)
    fitted = regression(coefficients, read().displacement["rough"][:TRAINED])
    lines = [f"{n},{a:.5g},{b:.5g}" for n, (a, b) in enumerate(zip(slices, fitted, strict=True))]
    SCORES.write_text("\n".join([",".join(COLUMNS), *lines, ""]))


@cache
def scores() -> dict[str, np.ndarray]:
    """Scores of the 400 samples (samples,), by what gives them."""
    rows = rows_of(SCORES, COLUMNS, ("number",)).values()
    columns = {name: np.array([row[name] for row in rows], float) for name in ("slices", "regression")}
    chance = np.random.default_rng(0).permutation(len(rows)).astype(float)
    return columns | {"chance": chance, "slices, turned round": -columns["slices"]}


@dataclass(frozen=True)
class Case:
    """A kind of campaign.

    Args:
        rank: what ranks samples, None for nothing.
        rough: rough runs.
        samples: that are ranked.
    """

    rank: str | None
    rough: int
    samples: int = 4000


CASES = (
    Case(None, 4000),
    Case(None, 400),
    *(Case(rank, 400) for rank in ("slices", "regression", "chance", "slices, turned round")),
)


def screened(case: Case, at: np.ndarray, seed: int) -> Population:
    """The first phase of a campaign whose samples have these places (samples,) in the population."""
    displacement = read_once()["rough"][at]
    sampling = Sampling(at.size, LIMIT)
    if case.rank is not None:
        ranked = all_samples(sampling, screened_by(scores()[case.rank][at]))
        assert ranked is not None
        sampling = replace(sampling, rough_samples=case.rough, zones=draw_samples(ranked, case.rough, seed))
    first = all_samples(sampling, screened_by(displacement))
    assert first is not None
    return first


@cache
def read_once() -> dict[str, np.ndarray]:
    """Displacements of the population, by grid."""
    return read().displacement


def repeat(case: Case, first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count`: rows of P_f, limits, coefficient of variation and refined runs."""
    rows = []
    for seed in range(first, first + count):
        ranked = case.rough if case.rank is None else case.samples
        at = np.random.default_rng([seed, 11]).integers(0, read_once()["rough"].size, ranked)
        population = screened(case, at, seed)
        failed = read_once()["refined"][at[population.numbers]] > LIMIT
        plan = TwoPhase(population.size, TARGET, seed=seed).audit(population)
        answer = two_phase(population, dict(enumerate(failed.tolist())), plan)
        rows.append((answer.probability, *answer.interval, answer.cov, answer.refined_runs))
    return np.array(rows)


def summarise(case: Case, rows: np.ndarray) -> dict[str, str | int | float]:
    """Bias in standard errors, coverage, and quartiles of the refined runs."""
    probability, low, high, cov, runs = rows.T
    truth = float(np.mean(read_once()["refined"] > LIMIT))
    return {
        "ranked by": case.rank or "nothing",
        "rough": case.rough,
        "bias": float(probability.mean() / truth - 1),
        "bias_error": float(probability.std() / truth / np.sqrt(len(rows))),
        "coverage": float(np.mean((low <= truth) & (truth <= high))),
        "reached": float(np.mean(cov <= TARGET)),
        **{f"refined_q{at}": int(np.quantile(runs, at / 100, method="inverted_cdf")) for at in (25, 50, 75)},
    }


def main(*arguments: str) -> None:
    """Print a row for each case, of 200 campaigns, or as many as asked for."""
    if "--scores" in arguments:
        write_scores()
    count = next((int(argument) for argument in arguments if argument.isdecimal()), 200)
    for case in CASES:
        print("  ".join(f"{key}={value}" for key, value in summarise(case, repeat(case, 0, count)).items()))


if __name__ == "__main__":
    main(*sys.argv[1:])
