"""Modes of failure, published and ours: their shares, severity and fits (Tables 4 and 5, Figs. 19 and 20)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.study import study_pieces, study_runs
from benchmarks.study.published_answers import Found, Hours, Line, hours_of
from benchmarks.study.published_probability import classes
from benchmarks.study.study_pieces import population, refined_classes, refined_slide, sweep_cases
from benchmarks.study.study_runs import LENGTHS, MORE_AIR, SWEEP_SAMPLES, sweep_case
from benchmarks.study.study_table import Outcome, Rows
from cooperative.estimate import effective_size, fit_distributions, sample_weights, severity_ranking, wilson_interval
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
"""Slides of a mode from which on the spread of their area is told."""

UNDECIDED = 2.0
"""Differences of AIC below this tell two distributions apart no better than chance."""


@dataclass(frozen=True)
class Slides:
    """Refined slides of the headline campaign: those that ended, what each stands for (n,), the share of all failures
    that those stand for which broke off and so have no mode, and in words what they are."""

    ended: list[Outcome]
    weight: np.ndarray
    lost: float
    words: str


def weighted_slides(rows: Rows) -> Slides:
    """Refined slides of the headline campaign with their weights: all failures of as many draws as are whole."""
    screened = population(rows, "published", study_runs.SAMPLES)
    there = sum(run.case == "published" and run.grid == "refined" and run.until == "end" for run in rows)
    none = Slides([], np.zeros(0), 0.0, f"{there} refined slides are there")
    if screened is None:
        return none
    refined = refined_classes(rows, "published")
    fewest = study_pieces.AUDIT.first_wave + int(np.isnan(screened.rough_displacement).sum())
    for runs in range(study_pieces.AUDIT.runs, fewest - 1, -1):
        weights = sample_weights(screened, refined, replace(study_pieces.AUDIT, runs=runs))
        fallen = {sample: weight for sample, weight in weights.items() if refined[sample]}
        slides = [refined_slide(rows, sample) for sample in fallen]
        if fallen and None not in slides:
            weight = np.array(list(fallen.values()))
            whole = np.array([slide is not None and slide.mode is not None for slide in slides])
            lost = float(weight[~whole].sum() / weight.sum())
            words = f"{whole.sum()} refined slides of {len(slides)} failures of {runs} draws"
            if lost:
                words += (
                    f", the others broke off and stand for {lost:.0%} of failures: the interval leaves them any mode"
                )
            return Slides([slide for slide in slides if slide is not None and slide.mode], weight[whole], lost, words)
    return none


def share_found(mine: np.ndarray, slides: Slides, spent: Hours, words: str) -> Found:
    """Share of these slides (n,) bool among the failures. The interval holds whatever those that broke off would have
    been: Wilson's lower limit where none of them is one of these, the upper where all are."""
    share, size = float(slides.weight[mine].sum() / slides.weight.sum()), effective_size(slides.weight)
    ends = share * (1 - slides.lost), share * (1 - slides.lost) + slides.lost
    limits = [wilson_interval(min(end, 1.0) * size, size) for end in ends]
    return Found(share, (limits[0][0], limits[1][1]), words, spent)


def modes(rows: Rows) -> Iterator[Line]:
    """Shares, severity and fits of the modes at lx = ly = 60 m, and their shares on the calibrated rough grid."""
    slides = weighted_slides(rows)
    names = np.array([slide.mode for slide in slides.ended])
    slid = {run: o for run, o in rows.items() if run.case in ("published", MORE_AIR)}
    spent = hours_of(slid, grid="refined", until="end")
    pool = sum(POOLED.values())
    groups = [("deep",), ("progressive",), ("compound",), ("shallow",), ("progressive", "compound")]
    for group in groups:
        what, printed = " or ".join(group), sum(POOLED[mode] for mode in group)
        cause = f"the published share pools all correlation lengths ({printed} of some {pool} failures)"
        pooled = rough_shares(rows, sweep_cases(), group)
        if isinstance(pooled, Found):
            cause += f"; pooled here, on the calibrated rough grid, it is {pooled.value:.2f}; beyond that not measured"
        answer: Found | str = slides.words
        if names.size > 1:
            mine = np.isin(names, group)
            answer = share_found(mine, slides, spent, f"{slides.words}; {mine.sum()} {what}")
        name = f"share_{'_or_'.join(group)}"
        yield Line(f"share of {what} failures", name, printed / pool, answer, cause)
    yield from severity(slides, names, spent)
    for mode in SEVERITY:
        mine = names == mode
        if mine.sum() >= TO_FIT:
            chosen = [slide for slide, one in zip(slides.ended, mine, strict=True) if one]
            yield from fits(mode, chosen, slides.weight[mine], spent)
    yield from rough_modes(rows)


def severity(slides: Slides, names: np.ndarray, spent: Hours) -> Iterator[Line]:
    """Median area of each mode, and its place among those that have slides enough to tell one."""
    areas = np.array([slide.area for slide in slides.ended], float)
    groups = {mode: names == mode for mode in SEVERITY if (names == mode).any()}
    many = {mode: mine for mode, mine in groups.items() if mine.sum() >= FEW_SLIDES}
    what = "median area of {} failures (m2)"
    for mode in groups.keys() - many.keys():
        each = ", ".join(f"{area:.0f}" for area in areas[groups[mode]])
        words = f"{groups[mode].sum()} slides ({each} m2), a median wants {FEW_SLIDES}"
        yield Line(what.format(mode), None, None, words)
    if not many:
        return
    for place in severity_ranking(
        {mode: areas[mine] for mode, mine in many.items()}, weights={m: slides.weight[i] for m, i in many.items()}
    ):
        assert place.interval is not None  # of FEW_SLIDES or more
        answer = Found(place.middle, place.interval, f"{place.count} slides; 90 per cent interval", spent)
        rank = f"rank {place.rank} ({place.rank_interval[0]} to {place.rank_interval[1]}) of {len(many)}"
        yield Line(what.format(place.group), None, None, answer, rank if len(many) > 1 else "no other mode to rank")


def fits(mode: str, slides: list[Outcome], weight: np.ndarray, spent: Hours) -> Iterator[Line]:
    """Best distribution of each consequence of a mode beside the printed one."""
    for measure, printed in BEST_FITS[mode].items():
        values = np.array([getattr(slide, measure) for slide in slides], float)
        done = fit_distributions(values, weight)
        by_name = {fit.name: fit.aic for fit in done.fits}
        if done.best_aic is None or printed not in by_name:
            continue
        behind = by_name[printed] - by_name[done.best_aic]
        words = "fits best, as printed" if not behind else f"{done.best_aic} fits best, {printed} by {behind:.1f} worse"
        words += ", which these slides do not tell apart" if done.notes and behind < UNDECIDED else ""
        notes = "".join(f"; {note}" for note in done.notes)
        found = Found(behind, (behind, behind), f"{len(slides)} slides{notes}", spent)
        yield Line(
            f"AIC of the printed {printed} over the best, {measure} of {mode} failures", None, None, found, words
        )


def rough_modes(rows: Rows) -> Iterator[Line]:
    """Fig. 20: shares of the modes against lx and ly, from slides of the calibrated rough grid; then all pooled,
    as Table 4 pools them."""
    for axis in ("lx", "ly"):
        for length in LENGTHS:
            case = [sweep_case(axis, length)]
            what = f"share of deep failures, rough grid calibrated, {axis} = {length:g} m"
            others = ((mode, rough_shares(rows, case, (mode,))) for mode in SEVERITY if mode != "deep")
            rest = ", ".join(f"{mode} {other.value:.2f}" for mode, other in others if isinstance(other, Found))
            yield Line(what, None, None, rough_shares(rows, case, ("deep",)), rest)
    for mode, count in POOLED.items():
        what = f"share of {mode} failures, rough grid calibrated, all lengths"
        answer, cause = rough_shares(rows, sweep_cases(), (mode,)), "its lengths and numbers of samples are not printed"
        yield Line(what, None, count / sum(POOLED.values()), answer, cause)


def rough_shares(rows: Rows, cases: list[str], group: tuple[str, ...]) -> Found | str:
    """Share of these modes among the calibrated rough slides of some cases; why not, while any slide is missing.

    The cases have common samples, whose slides are alike: as many count as samples that fail in all cases or in none
    would tell as much, the effective size of samples weighted by their number of slides.
    """
    known = {run: o for run, o in rows.items() if run.case in cases and run.grid == "rough" and o.mode}
    fallen = sum(sum(classes(rows, case, "rough").values()) for case in cases)
    screened = all(len(classes(rows, case, "rough")) == SWEEP_SAMPLES for case in cases)
    if not screened or not known or len(known) < fallen:
        return f"{len(known)} slides of {fallen} failures are there"
    mine = sum(outcome.mode in group for outcome in known.values())
    samples = np.unique([run.sample for run in known], return_counts=True)[1]
    share, size = mine / len(known), effective_size(samples)
    words = f"{len(known)} rough slides of {samples.size} samples, {mine} {' or '.join(group)}"
    return Found(share, wilson_interval(share * size, size), words, hours_of(known))
