"""Failure modes, published and here: their shares, severity and fits (Tables 4 and 5, Figs. 19 and 20)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.study.answers import Answer, Hours, Line, hours_of
from benchmarks.study.cases import AUDIT, LENGTHS, MORE_AIR, SAMPLES, SWEEP, sweep_case
from benchmarks.study.probability import audit_weights
from benchmarks.study.rows import Outcome, Rows, classes, refined_slide
from cooperative.estimate import effective_size, fit_distributions, severity_ranking, wilson_interval
from cooperative.measure import SEVERITY

BEST_FITS = {
    "shallow": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "deep": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "compound": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "progressive": {"area": "logistic", "volume": "Weibull", "runout": "normal"},
}
"""Distribution of least AIC that is printed for each mode and consequence (Tables 4 and 5, Fig. 19)."""

POOLED = {"shallow": 14, "deep": 1043, "compound": 177, "progressive": 353}
"""Failures of each mode behind Table 4, as BIC - AIC = 2 (ln N - 2) implies: all correlation lengths together."""

TO_FIT = 20
"""Slides of a mode from which on distributions are fitted to its consequences."""

FEW_SLIDES = 5
"""Slides of a mode from which on its area has a median."""

UNDECIDED = 2.0
"""Differences of AIC below this tell two distributions apart no better than chance."""


@dataclass(frozen=True)
class Slides:
    """Refined slides of the headline campaign.

    Attributes:
        ended: those with a mode.
        weight: (n,) number of samples that each stands for.
        lost: share of all failures without a mode, because their slides broke off.
        words: number of slides and failures.
    """

    ended: list[Outcome]
    weight: np.ndarray
    lost: float
    words: str

    def of_mode(self, *modes: str) -> np.ndarray:
        """Which slides (n,) bool have one of these modes."""
        return np.isin([str(slide.mode) for slide in self.ended], modes)


def weighted_slides(rows: Rows) -> Slides:
    """Refined slides of the headline campaign with their weights."""
    refined = classes(rows, "published", "refined")
    weights = {n: weight for n, weight in audit_weights(rows, "published", SAMPLES, AUDIT).items() if refined[n]}
    slides = {n: refined_slide(rows, n) for n in weights}
    ended = {n: slide for n, slide in slides.items() if slide.mode}
    weight = np.array([weights[n] for n in ended])
    lost = 1 - float(weight.sum()) / sum(weights.values())
    words = f"{len(ended)} refined slides of {len(slides)} failures of {AUDIT.runs} draws"
    if len(ended) < len(slides):
        words += f", the others broke off and stand for {lost:.0%} of failures: the interval leaves them any mode"
    return Slides(list(ended.values()), weight, lost, words)


def share_of(chosen: np.ndarray, slides: Slides, spent: Hours, words: str) -> Answer:
    """Share of these slides (n,) bool among the failures. The interval allows any mode for those that broke off:
    Wilson's lower limit where none of them is one of these, the upper where all are."""
    share, size = float(slides.weight[chosen].sum() / slides.weight.sum()), effective_size(slides.weight)
    ends = share * (1 - slides.lost), share * (1 - slides.lost) + slides.lost
    limits = [wilson_interval(min(end, 1.0) * size, size) for end in ends]
    return Answer(share, (limits[0][0], limits[1][1]), words, spent)


def modes(rows: Rows) -> Iterator[Line]:
    """Shares, severity and fits of the modes at lx = ly = 60 m, and their shares on the calibrated rough grid."""
    slides, pool = weighted_slides(rows), sum(POOLED.values())
    published = {run: o for run, o in rows.items() if run.case in ("published", MORE_AIR)}
    spent = hours_of(published, grid="refined", until="end")
    for group in (("deep",), ("progressive",), ("compound",), ("shallow",), ("progressive", "compound")):
        what, printed = " or ".join(group), sum(POOLED[mode] for mode in group)
        pooled, chosen = rough_shares(rows, SWEEP, group), slides.of_mode(*group)
        cause = (
            f"the published share pools all correlation lengths ({printed} of some {pool} failures); "
            f"pooled here, on the calibrated rough grid, it is {pooled.value:.2f}; "
            "it depends on a rule that is not printed"
        )
        answer = share_of(chosen, slides, spent, f"{slides.words}; {chosen.sum()} {what}")
        yield Line(f"share of {what} failures", f"share_{'_or_'.join(group)}", printed / pool, answer, cause)
    yield from severity(slides, spent)
    for mode in SEVERITY:
        if slides.of_mode(mode).sum() >= TO_FIT:
            yield from fits(mode, slides, spent)
    yield from rough_modes(rows)


def severity(slides: Slides, spent: Hours) -> Iterator[Line]:
    """Median area of each mode, and its rank among those with enough slides."""
    areas = np.array([slide.area for slide in slides.ended], float)
    groups = {mode: chosen for mode in SEVERITY if (chosen := slides.of_mode(mode)).any()}
    many = {mode: chosen for mode, chosen in groups.items() if chosen.sum() >= FEW_SLIDES}
    what = "median area of {} failures (m2)"
    for mode in groups.keys() - many.keys():
        values = ", ".join(f"{area:.0f}" for area in areas[groups[mode]])
        words = f"{groups[mode].sum()} slides ({values} m2), a median wants {FEW_SLIDES}"
        yield Line(what.format(mode), None, None, words)
    weights = {mode: slides.weight[chosen] for mode, chosen in many.items()}
    for severe in severity_ranking({mode: areas[chosen] for mode, chosen in many.items()}, weights=weights):
        assert severe.interval is not None  # of FEW_SLIDES or more
        answer = Answer(severe.middle, severe.interval, f"{severe.count} slides; 90 per cent interval", spent)
        rank = f"rank {severe.rank} ({severe.rank_interval[0]} to {severe.rank_interval[1]}) of {len(many)}"
        yield Line(what.format(severe.group), None, None, answer, rank if len(many) > 1 else "no other mode to rank")


def fits(mode: str, slides: Slides, spent: Hours) -> Iterator[Line]:
    """Best distribution of each consequence of a mode, and the printed one."""
    chosen = slides.of_mode(mode)
    for measure, printed in BEST_FITS[mode].items():
        values = np.array([getattr(slide, measure) for slide in slides.ended], float)[chosen]
        done = fit_distributions(values, slides.weight[chosen])
        behind = next(fit.aic for fit in done.fits if fit.name == printed) - done.fits[0].aic
        words = "fits best, as printed" if not behind else f"{done.best_aic} fits best, {printed} by {behind:.1f} worse"
        words += ", which these slides do not tell apart" if done.notes and behind < UNDECIDED else ""
        answer = Answer(behind, (behind, behind), "; ".join([f"{chosen.sum()} slides", *done.notes]), spent)
        what = f"AIC of the printed {printed} over the best, {measure} of {mode} failures"
        yield Line(what, None, None, answer, words)


def rough_modes(rows: Rows) -> Iterator[Line]:
    """Fig. 20: shares of the modes against lx and ly, from slides of the calibrated rough grid; then all pooled,
    as Table 4 pools them."""
    for axis in ("lx", "ly"):
        for length in LENGTHS:
            case = [sweep_case(axis, length)]
            what = f"share of deep failures, rough grid calibrated, {axis} = {length:g} m"
            others = {mode: rough_shares(rows, case, (mode,)).value for mode in SEVERITY if mode != "deep"}
            rest = ", ".join(f"{mode} {value:.2f}" for mode, value in others.items())
            yield Line(what, None, None, rough_shares(rows, case, ("deep",)), rest)
    for mode, count in POOLED.items():
        what = f"share of {mode} failures, rough grid calibrated, all lengths"
        cause = "its lengths and numbers of samples are not printed"
        yield Line(what, None, count / sum(POOLED.values()), rough_shares(rows, SWEEP, (mode,)), cause)


def rough_shares(rows: Rows, cases: Collection[str], group: tuple[str, ...]) -> Answer:
    """Share of these modes among the calibrated rough slides of some cases.

    The cases have common samples, whose slides are alike: the number of independent slides is the effective size of
    samples weighted by their number of slides.
    """
    of_cases = {run: o for run, o in rows.items() if run.case in cases and run.grid == "rough" and o.mode}
    in_group = sum(outcome.mode in group for outcome in of_cases.values())
    samples = np.unique([run.sample for run in of_cases], return_counts=True)[1]
    share, size = in_group / len(of_cases), effective_size(samples)
    words = f"{len(of_cases)} rough slides of {samples.size} samples, {in_group} {' or '.join(group)}"
    return Answer(share, wilson_interval(share * size, size), words, hours_of(of_cases))
