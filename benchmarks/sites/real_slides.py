"""Real slides from published data alone: what was surveyed against the 90 % interval of a campaign's failures.

The scenes stand in benchmarks/scenes/real, with the source of each number and what was assumed, beside what was
surveyed, and what of that is scored. Each scene says what was decided before its runs, and what was changed after.

`low`, `median` and `high` are weighted quantiles of the refined slides that ran to their end, or of the failures on the
rough grid where there is none yet; `grid` names which, `slides` counts them, `at_rest` those that came to rest, and
`held` those that reached a wall or the end of the ground. Slides that had not come to rest have the least lengths that
they will have, and those that were held have the ground's. `rough_low` and `rough_high` are of the failures on the
rough grid, `rough_same` the median there of the samples that count. `hit`: the middle of the surveyed range lies within
the interval. `score` is the interval score and `crps` the continuous ranked probability score, both of the surveyed
range over its middle, smaller is better; `corominas_score` that of the empirical relation, which has the travel
distance alone. What is not scored has none of them. The slide of the lower dam then corrects the error that the
residual strengths of both dams share, and with it the upper dam is predicted (`benchmarks.sites.real_calibrated`): rows
"lower dam known". Where the change of heights was surveyed, stations along the run-out line have rows of their own
(`benchmarks.sites.real_profile`): `profile_within` is the share of stations whose change lies in the interval,
`profile_width` the mean width of these intervals over the mean surveyed change, and `profile_misplaced` the share of
the volume that lies elsewhere than surveyed, in the median slide and in the nearest. Campaigns stay in out/real_slides;
the next command goes on where one was stopped, and one that was stopped counts with the samples that it has. `--quick`
runs the spread on coarse cells.

Three slides are left out, as their sections were not at hand. Of Saint-Jude (2010) the height of 22 m, the scar 150 m
long and the slip surface are known, at El. 2.5 m below a river bed at El. 6 m and at El. 15 m near the scarp (Lacasse
2013, Proceedings of the 18th ICSMGE, 15-34), without strengths, which Zhang et al. (2020, 10.1007/s10346-019-01330-4)
have. Public input for Selborne (1989) has soils and water without the outline. Section and soils of Cook Lake (1997)
stand in 10.3390/w12102817. Of both papers the beginnings alone could be read.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, Report, beginning_so
from benchmarks.sites.real_calibrated import calibrated, shared_factor
from benchmarks.sites.real_profile import draw, in_stations, misplaced, stations, surveyed
from benchmarks.sites.real_surveys import KNOWN, MISS, Known, corominas, crps, interval_score
from cooperative import run as run_campaign
from cooperative import runs
from cooperative.folder import Results, read_results
from cooperative.runs import Stopped
from cooperative.scene import Campaign, built, campaign_of, parse, read_scene, to_toml
from cooperative.store import FinishedRun, read_sample, table_of
from jaxmpm import Status

SCENES = ROOT / "benchmarks" / "scenes" / "real"
CALIBRATES, PREDICTED = "lower_san_fernando_1971", "upper_san_fernando_1971"
RUN = (CALIBRATES, PREDICTED, "s1000_2021")
"""Slides of whose surveys some are scored, and the dam that the first of them predicts."""


@dataclass(frozen=True)
class Slid:
    """Failures of a campaign on one grid.

    Args:
        quantities: by name, one value for each failure (n,), or one for each station (n, stations).
        weight: what each stands for (n,).
    """

    quantities: Mapping[str, np.ndarray]
    weight: np.ndarray

    def quantiles(self, quantity: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weighted quantiles of some failures: lower end of the interval, median, upper end."""
        levels, values = (MISS / 2, 0.5, 1 - MISS / 2), self.quantities[quantity]
        low, median, high = np.quantile(values, levels, axis=0, weights=self.weight, method="inverted_cdf")
        return low, median, high

    def ends(self, quantity: str) -> tuple[float, float, float] | tuple[None, None, None]:
        """The quantiles as numbers; None where nothing failed."""
        if not self.weight.size:
            return None, None, None
        low, median, high = map(float, self.quantiles(quantity))
        return low, median, high

    def count(self, what: str) -> int:
        """Failures of which something holds."""
        return int(self.quantities[what].sum()) if self.weight.size else 0


@dataclass(frozen=True)
class Compared:
    """A surveyed quantity beside the interval of the slides. Fields are explained at the head of this module."""

    slide: str
    quantity: str
    surveyed: float
    checked: bool
    scored: bool
    grid: str
    slides: int
    at_rest: int
    held: int
    low: float | None
    median: float | None
    high: float | None
    hit: bool
    score: float | None
    crps: float | None
    rough_low: float | None
    rough_high: float | None
    rough_same: float | None
    corominas_low: float | None
    corominas: float | None
    corominas_high: float | None
    corominas_score: float | None
    published: str


def measured(
    campaign: Campaign, grid: str, crest: float | None, samples: Iterable[FinishedRun]
) -> list[dict[str, Any]]:
    """The quantities of slides, and in 3D the change of volume in the stations of the run-out line (stations,) m3.

    Args:
        campaign: of the slides.
        grid: "rough" or "refined".
        crest: x of the crest of a section (m), None in 3D.
        samples: with their displacement (d, N) m at the end.
    """
    scene, _ = built(campaign, grid, at_rest=False)
    position, volume = (np.asarray(array, float) for array in (scene.particles.position, scene.particles.volume))
    half, (face, track) = campaign.grids[grid].spacing[0] / 2, (campaign.site.shape.face, campaign.site.track)
    answer = []
    for sample in samples:
        displacement, runout = np.asarray(sample.fields["displacement"], float), float(sample.row["runout"])
        slid = np.linalg.norm(displacement, axis=0) >= campaign.run.failure_displacement
        row: dict[str, Any] = {"runout": runout, "volume": float(sample.row["volume"])}
        if track is not None:  # run-out is counted from the rear of the mass
            ends = [place[:2] for place in (position, position + displacement)]
            start, end = (track.along(place[:, slid])[0] for place in ends)
            row |= {"travel": runout, "centre": float(np.average(end - start, weights=volume[slid]))}
            before, after = (in_stations(track, place, volume) for place in ends)
            row["change"] = after - before
        elif face is not None and crest is not None:
            rear = float(position[0, slid].min()) - half
            highest = [float(place[-1].max()) for place in (position, position + displacement)]
            row |= {"retrogression": crest - rear, "travel": face.toe_x - rear + runout}
            centre = float(np.average(displacement[0, slid], weights=volume[slid]))
            row |= {"crest_loss": highest[0] - highest[1], "centre": centre}
        answer.append(row)
    return answer


def slides(name: str, folder: Path) -> dict[str, Slid]:
    """The failures of a campaign on each grid, those so far of one that was stopped."""
    results = read_results(folder)
    # With the defaults of its folder, of which the order of its particles is one.
    campaign = campaign_of(results.store)
    chosen = chosen_runs(results, campaign.run.failure_displacement)
    soil, answer = runs.random_soil(campaign), {}
    coefficients = runs.coefficients_of(campaign, soil)
    for grid, (numbers, slid, weight) in chosen.items():
        samples = [read_sample(results.store, grid, numbers[at]) for at in np.flatnonzero(slid)]
        measures = measured(campaign, grid, KNOWN[name].crest, samples) if samples else []
        quantities = {
            quantity: np.array([one[quantity] for one in measures]) for quantity in (measures[0] if measures else ())
        }
        quantities["number"] = np.asarray(numbers, int)[slid]
        quantities["at_rest"] = np.array([sample.status == Status.SETTLED.name for sample in samples], bool)
        quantities["held"] = np.array([bool(sample.row["walls"]) for sample in samples], bool)
        quantities |= shared_factor(soil, campaign, coefficients[np.asarray(numbers, int)[slid]])
        answer[grid] = Slid(quantities, weight[slid])
    return answer


def chosen_runs(results: Results, failure_displacement: float) -> dict[str, tuple[list[int], np.ndarray, np.ndarray]]:
    """Samples of each grid, whether they slid to their end (runs,), and what they stand for (runs,).

    Args:
        results: of a campaign, which weighs the slides of its finest grid alone.
        failure_displacement: beyond which a rough run has slid (m).
    """
    rough, refined = results.rough, results.refined.numbers
    failed = (rough.columns["displacement"] > failure_displacement) & ~rough.columns["broke_off"].astype(bool)
    ended = slice(len(refined))
    return {
        "rough": (rough.numbers, failed, np.ones(failed.size)),
        "refined": (refined, results.slid[ended], results.weight[ended]),
    }


def counted(failures: Mapping[str, Slid]) -> str:
    """The grid whose failures count: the rough one where there is no refined slide yet."""
    return "refined" if failures["refined"].weight.size else "rough"


def same_on_rough(failures: Mapping[str, Slid]) -> Slid:
    """The failures on the rough grid of the samples that count, weighed as there."""
    counts, rough = failures[counted(failures)], failures["rough"]
    if not counts.weight.size or not rough.weight.size:
        return Slid({}, np.zeros(0))
    weights = dict(zip(counts.quantities["number"], counts.weight, strict=True))
    chosen = np.isin(rough.quantities["number"], list(weights))
    weight = np.array([weights[number] for number in rough.quantities["number"][chosen]])
    return Slid({name: values[chosen] for name, values in rough.quantities.items()}, weight)


def compared(name: str, slide: Known, failures: Mapping[str, Slid]) -> list[Compared]:
    """A row for each surveyed quantity of a slide."""
    rows = []
    for quantity, survey in slide.surveys.items():
        grid = counted(failures)
        low, median, high = failures[grid].ends(quantity)
        rough_low, _, rough_high = failures["rough"].ends(quantity)
        near, likely, far = None, None, None
        slid = failures[grid]
        if quantity == "travel" and slide.fall is not None and slide.volume is not None:
            near, likely, far = corominas(slide.fall, slide.volume)
        rows.append(
            Compared(
                name,
                quantity,
                survey.value,
                survey.checked,
                survey.scored,
                grid,
                slid.weight.size,
                slid.count("at_rest"),
                slid.count("held"),
                low,
                median,
                high,
                low is not None and high is not None and low <= survey.value <= high,
                None if low is None or high is None or not survey.scored else interval_score(low, high, survey),
                None if low is None or not survey.scored else crps(slid.quantities[quantity], slid.weight, survey),
                rough_low,
                rough_high,
                same_on_rough(failures).ends(quantity)[1],
                near,
                likely,
                far,
                None if near is None or far is None or not survey.scored else interval_score(near, far, survey),
                ", ".join(f"{value:g} ({code})" for code, value in survey.published.items()) or "none",
            )
        )
    return rows


def profile(name: str, slide: Known, failures: Mapping[str, Slid]) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """The stations of a slide whose change of heights was surveyed, and their named figures; none for another."""
    slid, track = failures["refined"], parse(read_scene(SCENES / f"{name}.toml")).site.track
    if slide.change is None or track is None or not slid.weight.size:
        return [], {}
    survey = surveyed(track, SCENES / slide.change)
    low, median, high = slid.quantiles("change")
    rows = stations(name, survey, (low, median, high))
    elsewhere = misplaced(survey, slid.quantities["change"])
    figures = {
        "profile_within": np.mean([row["within"] for row in rows]),
        "profile_width": (high - low).mean() / np.abs(survey).mean(),
        "profile_misplaced": np.quantile(elsewhere, 0.5, weights=slid.weight, method="inverted_cdf"),
        "profile_misplaced_least": elsewhere.min(),
    }
    return rows, {name: round(float(value), 3) for name, value in figures.items()}


def summarised(rows: list[Compared]) -> dict[str, float | int | None]:
    """The named figures, of what is scored. A quantity without a slide is missed; scores are of those that have one."""
    rows = [row for row in rows if row.scored]
    scored = [(row, row.score) for row in rows if row.score is not None]
    travel = [(score, row.corominas_score) for row, score in scored if row.corominas_score is not None]
    mean: dict[str, list[float]] = {
        "measured_within": [row.hit for row in rows],
        "checked_within": [row.hit for row in rows if row.checked],
        "interval_score": [score for _, score in scored],
        "crps": [row.crps for row, _ in scored if row.crps is not None],
        "travel_interval_score": [score for score, _ in travel],
        "corominas_score": [empirical for _, empirical in travel],
    }
    return {
        "slides": len({row.slide for row, _ in scored}),
        "quantities": len(rows),
        **{name: round(float(np.mean(values)), 3) if values else None for name, values in mean.items()},
    }


def scene_of(name: str, quick: bool) -> Campaign:
    """The campaign of a slide; `quick` with few samples on coarse cells."""
    source = read_scene(SCENES / f"{name}.toml")
    if not quick:
        return parse(source)
    tables = deepcopy(source.tables)
    tables["rough"] = tables["refined"] = {"cell": 4.0, "spacing": [2.0, 2.0]}
    tables["campaign"] = {**table_of(tables, "campaign"), "samples": 10, "refined_runs": 10}
    return parse(to_toml(tables))


def run(quick: bool, only: Sequence[str] = ("",)) -> Report:
    """All slides that have a score or are predicted, or those that begin so, as far as they come.

    Those that were stopped go on with the next command.

    Raises:
        Refused: If no slide begins so.
    """
    rows: list[Compared] = []
    along: list[dict[str, Any]] = []
    figures: dict[str, float] = {}
    found: dict[str, Mapping[str, Slid]] = {}
    stopped = False
    chosen = beginning_so({name: KNOWN[name] for name in (("sainte_monique_1994",) if quick else RUN)}, only)
    with tempfile.TemporaryDirectory() as scratch:
        base = Path(scratch) if quick else ROOT / "out" / "real_slides"
        for name in chosen:
            try:
                if not stopped:
                    run_campaign(scene_of(name, quick), base / name)
            except Stopped as why:
                print(why, file=sys.stderr)
                stopped = True
            if (base / name / "campaign.db").exists():
                failures = found[name] = slides(name, base / name)
                rows += compared(name, KNOWN[name], failures)
                more, named = profile(name, KNOWN[name], failures)
                along, figures = along + more, figures | named
    table = [rounded(row) for row in rows]
    if {CALIBRATES, PREDICTED} <= found.keys():
        more_rows, named = predicted(found[CALIBRATES], found[PREDICTED])
        table, figures = table + more_rows, figures | named
    drawing = partial(draw, along) if along else None
    return Report(summarised(rows) | figures, table + along, drawing)


def predicted(lower: Mapping[str, Slid], upper: Mapping[str, Slid]) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Rows of the upper dam once the slide of the lower one is known, and named figures; none without slides."""
    grid = counted(upper)
    first, second = lower[counted(lower)], upper[grid]
    if not first.weight.size or not second.weight.size:
        return [], {}
    factor_cov = max(field.factor_cov for field in scene_of(CALIBRATES, quick=False).random.values())
    calibrated_slides, figures = calibrated(first, second, KNOWN[CALIBRATES].surveys, factor_cov)
    rows = compared(PREDICTED, KNOWN[PREDICTED], {**upper, grid: calibrated_slides})
    return [rounded(replace(row, slide=f"{row.slide}, lower dam known")) for row in rows], figures


def rounded(row: Compared) -> dict[str, str | float | None]:
    """A row of the table."""
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(row).items()}
