"""Estimators of small probabilities on otbenchmark's limit states, whose P_f is known without sampling.

Each limit state is a function of standard normal numbers, the coefficients of a random field in a campaign. A sample
fails where g < 0, and exp(-g / s) stands for its displacement, s the scatter of g about the median. Every estimator
repeats 100 times, and 1000 times where its intervals held P_f less often than in 0.93 of these: Monte Carlo with 100 /
P_f samples, where these are at most 100,000; importance sampling with 1000 samples around the design points; subset
simulation with 8 runs of 500 samples a level down to P_f and an audit of 200; two-phase sampling and the control
variate with the tangent of g at the median as the cheap model, where it has one and P_f is at least 0.003. `calls` are
evaluations of g, those of gradients by differences and of the audit among them, and none of the tangent. `calls_for_10`
is what a root mean square error of a tenth of P_f takes, if its square falls with the calls. OpenTURNS runs beside them
as it comes, 20 times: Monte Carlo and subset sampling to a coefficient of variation of 0.1, and importance sampling
around the design point of FORM.

Source of the limit states: github.com/openturns/otbenchmark, after rprepo.readthedocs.io.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.public.rows import Row, row, without_answer
from cooperative.estimate import (
    AuditPlan,
    ControlVariate,
    Estimate,
    Population,
    SubsetPlan,
    TwoPhase,
    monte_carlo,
    subset_simulation,
    two_phase,
)
from cooperative.tools.research.rare import DesignPoint, design_points, importance_sampling

Made = Callable[[], list[Row]]
Numbers = np.ndarray
Marginal = Callable[[Numbers], Numbers]
"""Standard normal numbers to the variable."""


def lognormal(mean: float, sd: float) -> Marginal:
    """The variable of this mean and standard deviation."""
    s = math.sqrt(math.log1p((sd / mean) ** 2))
    return lambda u: np.exp(math.log(mean) - s**2 / 2 + s * u)


def gumbel(mean: float, sd: float) -> Marginal:
    """The largest value of this mean and standard deviation."""
    scale = sd * math.sqrt(6) / math.pi
    return lambda u: mean - scale * (np.euler_gamma + np.log(-stats.norm.logcdf(u)))


def normal(mean: float, sd: float) -> Marginal:
    """The variable of this mean and standard deviation."""
    return lambda u: mean + sd * u


def uniform(low: float, high: float) -> Marginal:
    """The variable between these ends."""
    return lambda u: low + (high - low) * stats.norm.cdf(u)


def exponential(u: Numbers) -> Numbers:
    """The variable of mean 1."""
    return -stats.norm.logsf(u)


STANDARD = normal(0.0, 1.0)


@dataclass(frozen=True)
class Problem:
    """A limit state. marginals: of its variables. g: of these, each (n,); failure where it is below 0."""

    marginals: tuple[Marginal, ...]
    g: Callable[..., Numbers]

    @property
    def size(self) -> int:
        """How many variables it has."""
        return len(self.marginals)

    def __call__(self, u: Numbers) -> Numbers:
        """g (n,) of standard normal numbers (n, variables)."""
        return self.g(
            *(marginal(column) for marginal, column in zip(self.marginals, np.asarray(u, float).T, strict=True))
        )

    def gradient(self, u: Numbers) -> tuple[float, Numbers]:
        """g and its gradient at one point (variables,), by central differences of 2 * variables + 1 evaluations."""
        steps = 1e-4 * np.eye(self.size)
        values = self(np.concatenate([u + steps, u - steps, u[None]]))
        return float(values[-1]), (values[: self.size] - values[self.size : -1]) / 2e-4


def _rp38(x1: Numbers, x2: Numbers, x3: Numbers, x4: Numbers, x5: Numbers, x6: Numbers, x7: Numbers) -> Numbers:
    top = x4**2 - 4 * x5 * x6 * x7**2 + x4 * (x6 + 4 * x5 + 2 * x6 * x7)
    return 15.59e4 - x1 * x2**3 / (2 * x3**3) * top / (x4 * x5 * (x4 + x6 + 2 * x6 * x7))


def _rp55(x1: Numbers, x2: Numbers) -> Numbers:
    d, far = x1 - x2, 5 / math.sqrt(2) - 2.2
    both = 0.2 + 0.6 * d**4 - np.abs(d) / math.sqrt(2)
    return np.minimum(both, far - np.abs(d))


def _rp60(x1: Numbers, x2: Numbers, x3: Numbers, x4: Numbers, x5: Numbers) -> Numbers:
    three, two = np.minimum(np.minimum(x2, x3), x4) - x5 / 2, np.minimum(x2, x3) - x5
    return np.minimum(x1 - x5, np.maximum(three, np.maximum(x4 - x5, two)))


def _means(*means: float) -> tuple[Marginal, ...]:
    return tuple(normal(mean, mean / 10) for mean in means)


PROBLEMS: dict[str, Problem] = {
    "R-S": Problem((normal(4, 1), normal(2, 1)), lambda r, s: r - s),
    "axial_beam": Problem((lognormal(300, 30), normal(75e3, 5e3)), lambda r, f: r - f / (100 * math.pi)),
    "RP8": Problem(
        (*(lognormal(120, 12),) * 4, lognormal(50, 10), lognormal(40, 8)),
        lambda a, b, c, d, e, f: a + 2 * b + 2 * c + d - 5 * e - 5 * f,
    ),
    "RP14": Problem(
        (uniform(70, 80), normal(39, 0.1), gumbel(1500, 350), normal(400, 0.1), normal(250e3, 35e3)),
        lambda a, b, c, d, e: a - 32 / (math.pi * b**3) * np.sqrt(c**2 * d**2 / 16 + e**2),
    ),
    "RP22": Problem((STANDARD,) * 2, lambda x, y: 2.5 - (x + y) / math.sqrt(2) + 0.1 * (x - y) ** 2),
    "RP25": Problem((STANDARD,) * 2, lambda x, y: np.maximum(x**2 - 8 * y + 16, -16 * x + y + 32)),
    "RP28": Problem((normal(78064, 11710), normal(0.0104, 0.00156)), lambda x, y: x * y - 146.14),
    "RP31": Problem((STANDARD,) * 2, lambda x, y: 2 - y + 256 * x**4),
    "RP38": Problem(_means(350, 50.8, 3.81, 173, 9.38, 33.1, 0.036), _rp38),
    "RP53": Problem((normal(1.5, 1), normal(2.5, 1)), lambda x, y: np.sin(2.5 * x) + 2 - (x**2 + 4) * (y - 1) / 20),
    "RP54": Problem((exponential,) * 20, lambda *x: sum(x) - 8.951),
    "RP55": Problem((uniform(-1, 1),) * 2, _rp55),
    "RP60": Problem(
        (lognormal(2200, 220), lognormal(2100, 210), lognormal(2300, 230), lognormal(2000, 200), lognormal(1200, 480)),
        _rp60,
    ),
    "RP75": Problem((STANDARD,) * 2, lambda x, y: 3 - x * y),
    "RP89": Problem((STANDARD,) * 2, lambda x, y: np.minimum(8 - x**2 - y, 6 - x / 5 - y)),
    "RP107": Problem((STANDARD,) * 10, lambda *x: 5 * math.sqrt(10) - sum(x)),
    "RP111": Problem((STANDARD,) * 2, lambda x, y: 12.5 - np.abs(x * y)),
}
MOST = 100_000
"""Samples of Monte Carlo at most."""
LEAST = 0.003
"""P_f from which on some of 2000 samples fail."""
TIMES, MORE, SELDOM = 100, 1000, 0.93
"""Repetitions; those, the first ones among them, of an estimator whose intervals hold P_f less often than that."""


@dataclass(frozen=True)
class Answer:
    """Of one repetition. calls: evaluations of g that it took."""

    probability: float
    interval: tuple[float, float]
    calls: int


def _answer(estimate: Estimate, calls: int) -> Answer:
    return Answer(estimate.probability, estimate.interval, calls)


def by_monte_carlo(problem: Problem, pf: float, seed: int) -> Answer:
    """From 100 / P_f samples."""
    size = math.ceil(100 / pf)
    return _answer(monte_carlo(problem(np.random.default_rng(seed).standard_normal((size, problem.size))) < 0), size)


def searched(problem: Problem) -> tuple[Numbers, int]:
    """Design points (k, variables), and the evaluations that their search took; ValueError where there is none."""
    gradients = 0

    def counted(u: Numbers) -> tuple[float, Numbers]:
        nonlocal gradients
        gradients += 1
        return problem.gradient(u)

    points: tuple[DesignPoint, ...] = design_points(counted, problem.size)
    return np.array([point.coefficients for point in points]), gradients * (2 * problem.size + 1)


def by_importance(problem: Problem, pf: float, seed: int, *, centres: Numbers, search: int) -> Answer:
    """From 1000 samples around the design points, whose search counts."""
    calls = 0

    def fails(u: Numbers) -> Numbers:
        nonlocal calls
        calls += len(u)
        return problem(u) < 0

    return _answer(importance_sampling(fails, centres, 1000, seed=seed), calls + search)


def scale_of(problem: Problem) -> float:
    """Scatter of g about the median, from a thousand samples that no estimate counts."""
    return float(np.std(problem(np.random.default_rng(0).standard_normal((1000, problem.size)))))


def by_subset(problem: Problem, pf: float, seed: int, *, scale: float) -> Answer:
    """Down to P_f, with 8 runs of 500 samples a level, and an audit of 200."""
    levels = max(round(-math.log10(pf)), 1)
    samples = subset_simulation(
        lambda u: np.exp(-problem(u) / scale), problem.size, SubsetPlan(levels=levels, seed=seed)
    )
    population = Population(
        samples.rough_displacement, weight=samples.weight, replicate=samples.replicate, chains=samples.chains
    )
    failed = dict(enumerate((problem(samples.coefficients) < 0).tolist()))
    answer = two_phase(population, failed, AuditPlan(runs=200, seed=seed, growth=0.5, exploration=0))
    return _answer(answer, samples.rough_runs + answer.refined_runs)


def with_tangent(
    problem: Problem,
    pf: float,
    seed: int,
    *,
    kind: type[TwoPhase] | type[ControlVariate],
    tangent: tuple[float, Numbers],
) -> Answer:
    """From 2000 samples, of P_f above 0.02 from 500, ranked by the tangent; a fifth of them evaluated."""
    size = 2000 if pf < 0.02 else 500
    u = np.random.default_rng(seed).standard_normal((size, problem.size))
    value, slope = tangent
    population = Population(np.exp(-(value + u @ slope) / np.linalg.norm(slope)))
    failed = problem(u) < 0
    if kind is TwoPhase:
        answer = TwoPhase(refined_runs=size // 5, seed=seed).estimate(population, dict(enumerate(failed.tolist())))
    else:
        ran = dict(enumerate(failed[: size // 5].tolist()))
        answer = ControlVariate(refined_runs=size // 5).estimate(population, ran)
    return _answer(answer, answer.refined_runs)


def estimators(problem: Problem, pf: float) -> dict[str, Callable[[int], Answer]]:
    """Those of `cooperative` that the problem suits, by name: functions of a seed."""
    made: dict[str, Callable[[int], Answer]] = {}
    if 100 / pf <= MOST:
        made["Monte Carlo"] = partial(by_monte_carlo, problem, pf)
    try:
        centres, search = searched(problem)
    except ValueError:
        pass  # it fails too often, or nothing shows the way to a design point
    else:
        made["importance sampling"] = partial(by_importance, problem, pf, centres=centres, search=search)
    if pf < 0.1:
        made["subset simulation"] = partial(by_subset, problem, pf, scale=scale_of(problem))
    tangent = problem.gradient(np.zeros(problem.size))
    if pf >= LEAST and np.linalg.norm(tangent[1]) > 0:
        for name, kind in (("two-phase", TwoPhase), ("control variate", ControlVariate)):
            made[name] = partial(with_tangent, problem, pf, kind=kind, tangent=tangent)
    return made


def by_openturns(problem: Problem, kind: str, seed: int) -> Answer:
    """By an estimator of OpenTURNS, as it comes."""
    import openturns as ot

    ot.RandomGenerator.SetSeed(seed)
    ot.Log.Show(ot.Log.NONE)
    inputs = ot.Normal(problem.size)
    calls = 0

    def counted(u: object) -> list[list[float]]:
        nonlocal calls
        values = problem(np.asarray(u))
        calls += values.size
        return values[:, None].tolist()

    g = ot.PythonFunction(problem.size, 1, func_sample=counted)
    event = ot.ThresholdEvent(ot.CompositeRandomVector(g, ot.RandomVector(inputs)), ot.Less(), 0.0)
    if kind == "FORM and importance sampling":
        form = ot.FORM(ot.Cobyla(), event, inputs.getMean())
        form.run()
        algorithm = ot.PostAnalyticalImportanceSampling(form.getResult())
    elif kind == "subset sampling":
        algorithm = ot.SubsetSampling(event)
        algorithm.setBlockSize(100)  # as many samples a level as it comes with, a hundred at once
        algorithm.setMaximumOuterSampling(100)
    else:
        algorithm = ot.ProbabilitySimulationAlgorithm(event, ot.MonteCarloExperiment())
        algorithm.setBlockSize(1000)
        algorithm.setMaximumOuterSampling(MOST // 1000)
    algorithm.setMaximumCoefficientOfVariation(0.1)
    algorithm.run()
    result = algorithm.getResult()
    p, half = result.getProbabilityEstimate(), result.getConfidenceLength(0.95) / 2
    return Answer(p, (p - half, p + half), calls)


THEIRS = ("Monte Carlo", "FORM and importance sampling", "subset sampling")


def repeated(
    name: str, estimator: str, run: Callable[[int], Answer], pf: float, times: int, *, ours: bool
) -> list[Row]:
    """Coverage, error and calls of so many repetitions."""
    start = time.perf_counter()
    answers = [run(seed) for seed in range(times)]
    coverage = held_in(answers, pf)
    off = np.array([answer.probability for answer in answers]) / pf - 1
    calls, error = float(np.mean([answer.calls for answer in answers])), float(np.sqrt(np.mean(off**2)))
    case = f"{name}, {estimator}" + ("" if ours else " of OpenTURNS")
    shown = partial(row, case, start=start)
    figure = "reliability_coverage_min" if ours else None
    rows = [
        shown("coverage of the 95 % interval", coverage, 0.95, difference=coverage - 0.95, figure=figure, finest=ours),
        shown("mean P_f", pf * (1 + float(off.mean())), pf),
        shown("root mean square error over P_f", error, 0.0, difference=error),
        shown("calls", calls, 0.0, difference=calls),
        shown("calls for an error of 10 %", calls * (error / 0.1) ** 2, 0.0, difference=calls * (error / 0.1) ** 2),
    ]
    if ours and times == TIMES and coverage < SELDOM:
        coverage = held_in(answers + [run(seed) for seed in range(TIMES, MORE)], pf)
        rows.insert(1, shown(f"coverage of {MORE} such intervals", coverage, 0.95, difference=coverage - 0.95))
    return rows


def held_in(answers: list[Answer], pf: float) -> float:
    """Share of the answers whose interval holds P_f."""
    return float(np.mean([low <= pf <= high for low, high in (answer.interval for answer in answers)]))


def compared(data: Path, name: str, quick: bool) -> list[Row]:
    """All estimators on one problem, OpenTURNS' where it is installed."""
    references = {
        reference["name"]: reference["own_pf"]
        for reference in json.loads((data / "otbenchmark" / "problems.json").read_text())
    }
    problem, pf = PROBLEMS[name], references[name]
    rows = []
    for estimator, run in estimators(problem, pf).items():
        rows += repeated(name, estimator, run, pf, 5 if quick else TIMES, ours=True)
    try:
        import openturns  # noqa: F401
    except ImportError:
        return rows
    for kind in THEIRS:
        if kind == "Monte Carlo" and 100 / pf > MOST:
            continue
        try:
            rows += repeated(name, kind, partial(by_openturns, problem, kind), pf, 2 if quick else 20, ours=False)
        except RuntimeError as error:
            rows.append(without_answer(f"{name}, {kind} of OpenTURNS", f"no answer: {error}"))
    return rows


def cases(data: Path, quick: bool) -> dict[str, Made]:
    """The cases by name."""
    return {f"otbenchmark {name}": partial(compared, data, name, quick) for name in PROBLEMS}
