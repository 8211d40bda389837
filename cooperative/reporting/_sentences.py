"""Numbers of a campaign in sentences and rows of tables, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cooperative.estimate import Estimate, Fits, annual
from cooperative.folder import Results
from cooperative.scene import Campaign
from cooperative.summary import Element, ModeShare, Spread, Summary
from jaxmpm.support.text import printable

Cell = str | float | int | None
"""Of a table: numbers stand on the right, None is a dash."""


PLAIN = str.maketrans("²³", "23")
"""Units as every terminal and every file of its output has letters for."""


def words(results: Results) -> str:
    """The summary for the terminal, in letters of ASCII but for names."""
    summary = results.summary
    cost, pf = summary.cost, summary.probability
    lines = [
        summary.name,
        f"  probability of failure  {probability(pf.estimate)}",
        *(f"  {line}" for line in (criterion(results).translate(PLAIN), hidden(summary), condition(summary)) if line),
        *(f"  at risk        {line}" for line in at_risk(summary)),
    ]
    for method, other in pf.others.items():
        ends = " to ".join(map(number, other.interval))
        lines.append(f"  by {method:<20} {number(other.probability)}  ({ends})")
    if cost.coarse_samples is not None:
        what = "coarse grid    " if cost.ranked_by is None else f"{cost.ranked_by}: "
        lines.append(f"  {what}{cost.coarse_samples} samples; each of those below stands for a zone of ranks")
    lines += [
        f"  rough grid     {cost.samples} samples, {pf.failures_rough} beyond the failure displacement, "
        f"{cost.seconds['rough']:.0f} s",
        f"  refined grid   {cost.refined_runs} runs, {pf.failures_refined} failures, {cost.seconds['refined']:.0f} s",
        *(f"  {line}" for line in (more(summary), agreement(summary)) if line),
    ]
    for mode, share in occurring(summary).items():
        low, high = share.interval
        lines.append(f"  {mode:<13}  {share.ratio:.0%} of the failures ({low:.0%} to {high:.0%})")
    for name, spread in summary.consequences.means.items():
        if spread and name in labels(results):
            mean, largest = (at_least(value, spread.at_least) for value in (spread.mean, spread.largest))
            ends = f"{number(spread.smallest)} to {largest}"
            lines.append(
                f"  {name:<13}  mean {mean} ({interval(spread)}), {ends} ({units(results)[name].translate(PLAIN)})"
            )
    lines += [f"  BROKE OFF      {line}" for line in broken(summary)]
    lines += [f"  LEFT OUT       {line}" for line in results.left_out]
    lines += [f"  WARNING        {warning}" for warning in summary.warnings]
    lines += [f"  note: {note}" for note in summary.notes]
    lines.append(f"  report with figures: {results.store.folder / 'report.html'}")
    return "\n".join(map(printable, lines))


def criterion(results: Results) -> str:
    """What counts as a failure."""
    pf, unit = results.summary.probability, "m³" if results.ground.dimension == 3 else "m² of the section"
    volume = pf.least_volume
    soil = "any particle of soil" if volume is None else f"at least {number(volume)} {unit} of soil"
    return f"It fails when {soil} moves farther than {number(pf.failure_displacement)} m, on either grid."


def unknown(interval: Sequence[float]) -> bool:
    """Whether nothing is known of a probability with these confidence limits."""
    return tuple(interval) == (0.0, 1.0)


def probability(estimate: Estimate) -> str:
    """A probability of failure in words, with its interval, or one limit where all runs ended alike."""
    chance, (low, high), sure = number(estimate.probability), estimate.interval, f"{estimate.level:.0%}"
    if unknown(estimate.interval):
        return f"not known yet  ({estimate.method}; no refined run counts so far)"
    if estimate.probability == 0:
        return f"0, at most {number(high)}  ({sure} confidence; {estimate.method})"
    if estimate.probability == 1:
        return f"1, at least {number(low)}  ({sure} confidence; {estimate.method})"
    return f"{chance}  ({sure} interval {number(low)} to {number(high)}; {estimate.method})"


def verdict(estimate: Estimate) -> tuple[str, str, str]:
    """The answer in a sentence: what stands before its number, the number, and what stands behind it."""
    chance, (low, high), sure = estimate.probability, estimate.interval, f"{estimate.level:.0%}"
    fails = "refined run has failed: the slope fails with a probability of at"
    if unknown(estimate.interval):
        return "How likely the slope fails is", "not known yet", "(no refined run counts so far)."
    if chance == 0:
        return f"No {fails} most", number(high), f"({sure} confidence)."
    if chance == 1:
        return f"Every {fails} least", number(low), f"({sure} confidence)."
    counted = f"({sure} interval {number(low)} to {number(high)}){in_slopes(chance)}."
    return "The slope fails with probability", number(chance), counted


def in_slopes(chance: float) -> str:
    """A probability as a count of slopes; empty at 0 and 1."""
    if not 0 < chance < 1:
        return ""
    many = f": {chance * 100:.0f} in 100 such slopes"
    if chance >= 0.995:
        return ": more than 99 in 100 such slopes"
    return many if chance > 0.095 else f": one in {float(f'{1 / chance:.2g}'):,.0f} such slopes"


def screened(summary: Summary) -> str:
    """How many samples ran on the rough grid, and on the coarse one before it, or were ranked."""
    cost = summary.cost
    if cost.coarse_samples is None:
        return f"{cost.samples} random slopes ran on the rough grid"
    first = "ran on the coarse grid" if cost.ranked_by is None else f"were ranked by {cost.ranked_by}"
    ran = "" if cost.ranked_by is None else "ran "
    return (
        f"{cost.coarse_samples} random slopes {first}, {cost.samples} of them, each drawn from a zone of its ranks, "
        f"{ran}on the rough grid"
    )


def condition(summary: Summary) -> str:
    """What the probabilities are conditional on, and the annual probability where the trigger has a frequency."""
    pf = summary.probability
    often = pf.annual_frequency
    if often is None:
        return (
            "All probabilities are conditional on the scene: nothing says how often its trigger comes. With [campaign] "
            "annual_frequency they are annual, too."
        )
    low, high = (annual(chance, often) for chance in pf.interval)
    if unknown(pf.interval):
        return f"The scene's trigger comes {often:g} times a year."
    return (
        f"The scene's trigger comes {often:g} times a year: the slope fails with an annual probability of "
        f"{number(annual(pf.value, often))} ({limits((low, high))})."
    )


def at_risk(summary: Summary) -> Iterator[str]:
    """Each element at risk: how likely it is reached and carried away, and what is lost."""
    often = summary.probability.annual_frequency
    for name, element in summary.consequences.elements_at_risk.items():
        if element is None:
            yield f"{name}: how likely it is reached is not known yet"
            continue
        chance, ends = element.reached.probability, element.reached.interval
        text = f"{name} is reached with probability {at_least(chance, element.reached.at_least)} ({limits(ends)})"
        if often is not None:
            yearly = [annual(limit, often) for limit in ends]
            text += f", {at_least(annual(chance, often), element.reached.at_least)} a year ({limits(yearly)})"
        if (loss := element.loss) is not None:
            text += (
                f"; of its value {number(loss.value)} the expected loss is {at_least(loss.expected, loss.at_least)} "
                f"({limits(loss.interval)})"
            )
            if often is not None:
                yearly = [often * limit for limit in loss.interval]
                text += f"; {at_least(often * loss.expected, loss.at_least)} a year ({limits(yearly)})"
        if element.carried.probability:
            carried = element.carried
            text += (
                f"; its own ground is carried away with probability "
                f"{at_least(carried.probability, carried.at_least)} ({limits(carried.interval)})"
            )
        yield text


def at_least(value: float, is_least: bool) -> str:
    """A number, "at least" that where slides would have gone on."""
    return ("at least " if is_least else "") + number(value)


def limits(interval: Sequence[float] | None) -> str:
    """Confidence limits in words.

    Args:
        interval: lower and upper limit, None where there are too few values.
    """
    if interval is None:
        return "too few for an interval"
    low, high = map(number, interval)
    return f"{low} to {high}" if interval[0] else f"at most {high}"


def interval(spread: Spread) -> str:
    """Confidence limits of a mean."""
    alike = spread.interval is not None and spread.smallest == spread.largest
    return "all alike" if alike else limits(spread.interval)


def cut_off(summary: Summary) -> str:
    """Ends the caption of a figure of what slides do; empty where all came to rest."""
    cut = summary.consequences.cut_off
    if not cut.at_t_end:
        return ""
    return f" These are least values: {cut.at_t_end} of {cut.of} slides had not come to rest at {cut.t_end:g} s."


def hidden(summary: Summary) -> str:
    """How much of the interval allows for samples that were not refined; empty where no part of it does."""
    pf = summary.probability
    if pf.sampling_interval is None or not pf.hidden_limit:
        return ""
    low, high = pf.sampling_interval
    if not pf.value:
        return (
            f"If samples that were not refined stand as their ranks suggest, P_f is at most {number(high)}. The limit "
            f"of {number(pf.interval[1])} holds wherever in the ranking failures hide, and falls with every run."
        )
    cov = pf.coefficient_of_variation
    spread = "" if cov is None else f" (coefficient of variation {cov:.1%})"
    return (
        f"Sampling error alone gives {number(low)} to {number(high)}{spread}. The wider interval allows for failures "
        f"in up to {pf.hidden_limit:.2g} of all samples, among low-ranked ones that were not refined."
    )


def more(summary: Summary) -> str:
    """What further refined runs would bring; empty where the runs do not show it."""
    cost, pf = summary.cost, summary.probability
    after, now = cost.after_more_runs, pf.coefficient_of_variation
    runs, remaining, then = after.runs, after.samples_left, after.coefficient_of_variation
    if not pf.value and pf.hidden_limit and pf.runs and remaining and runs:
        # The limit of n runs without a failure is in proportion to 1 / n.
        least = pf.interval[1] * pf.runs / (cost.refined_runs + runs)
        return f"{another(runs)} without a failure would lower the upper limit to about {least:.2g}."
    if now is None or then is None or (remaining and not runs):
        return ""
    # Where all fail the coefficient is 0 but for rounding, and no measure of what is known.
    uncertain = now >= 5e-4
    if not remaining:
        what = f"bring the coefficient of variation below {now:.1%}" if uncertain else "narrow the interval"
        which = "samples" if cost.coarse_samples is None else "rough samples"
        return f"All {which} are refined: only more {which} would {what}."
    if not uncertain:
        return ""
    first = f"{another(runs)} would reduce the coefficient of variation from {now:.1%} to {then:.1%}"
    if runs == remaining:
        return f"{first}. All samples are then refined, and only more samples help further."
    return f"{first}; all {remaining} samples that are left, to {after.all_samples:.1%}."


def another(runs: int) -> str:
    """So many further refined runs."""
    return f"Another {runs} refined runs" if runs > 1 else "Another refined run"


def agreement(summary: Summary) -> str:
    """How well the grids agree."""
    grids = summary.probability.grids
    if not grids:
        return ""
    low, high = grids.interval
    decided = " Failures that ended once their class was known share one rank."
    return (
        f"The rank correlation of the two grids is {grids.spearman:.2f} ({low:.2f} to {high:.2f}). They give the same "
        f"class in {grids.same_class:.1%} of {grids.samples} samples."
        + (decided if summary.cost.status["refined"].get("DECIDED") else "")
    )


def broken(summary: Summary) -> list[str]:
    """The runs that broke off."""
    return [
        f"sample {number} on the {grid} grid: {why}"
        for grid, runs in summary.cost.broke_off.items()
        for number, why in runs.items()
    ]


def distinct(results: Results) -> dict[str, dict[str, Fits]]:
    """Fits of all failures and of each mode, but not of a mode that all failures have, or of what all slides share."""
    fits = results.summary.consequences.fits
    modes = [fit for group, fit in fits.items() if group != "all"]
    return {
        group: {name: fit for name, fit in by_measure.items() if name in labels(results) and fit.fits}
        for group, by_measure in ({"all": fits["all"]} if modes == [fits.get("all")] else fits).items()
    }


def occurring(summary: Summary) -> dict[str, ModeShare]:
    """Modes that some refined run failed in."""
    return {mode: share for mode, share in (summary.modes.shares or {}).items() if share.count}


def labels(results: Results) -> dict[str, str]:
    """Axis label of each consequence, with its unit; the area of a section is its run-out, and left out."""
    solid = results.ground.dimension == 3
    return {
        "displacement": "largest displacement $R_d$ [m]",
        "depth": "sliding depth $H$ [m]",
        "runout": "run-out $L$ [m]",
        "volume": f"sliding volume $V$ [{'m³' if solid else 'm³/m'}]",
    } | ({"area": "influence area $S$ [m²]"} if solid else {})


def units(results: Results) -> dict[str, str]:
    """Unit of each consequence in words."""
    ground = results.ground
    return _units(ground.dimension, toe=ground.face is not None, line=ground.line, thickness=ground.thickness)


def units_of_campaign(campaign: Campaign) -> dict[str, str]:
    """Unit of each consequence in words.

    Args:
        campaign: whose results need not be there.
    """
    face, track = campaign.site.shape.face, campaign.site.track
    return _units(campaign.dimension, toe=face is not None, line=track is not None, thickness=campaign.runout_thickness)


def _units(dimension: int, *, toe: bool, line: bool, thickness: float) -> dict[str, str]:
    """Unit of each consequence in words.

    Args:
        dimension: of the ground.
        toe: whether the ground has one.
        line: whether the scene has a run-out line.
        thickness: of the deposit at the front of the run-out (m), 0 for the foremost soil.
    """
    per_width = "" if dimension == 3 else " per metre of width"
    along = ", along the line of the scene" if line else ""
    front = f", where {thickness:.3g} m is left" if thickness else ", its foremost soil"
    return {
        "displacement": "m",
        "depth": "m below the crest" if toe else "m below the surface",
        "runout": f"m beyond the toe{front}" if toe else f"m from its rear to its front{along}{front}",
        "volume": f"m³{per_width}",
        "area": "m² beyond the toe" if toe else "m² at its end",
    }


def number(value: float) -> str:
    """Three significant figures: 0.123, 42,600."""
    return f"{float(f'{value:.3g}'):,.0f}" if 999.5 <= abs(value) < 1e12 else f"{value:.3g}"


def consequences(results: Results) -> list[list[Cell]]:
    """Rows of the consequences of slides: name, unit, mean, interval, smallest and largest."""
    return [
        [
            name,
            units(results)[name],
            _or_least(spread.mean, spread.at_least),
            interval(spread),
            spread.smallest,
            _or_least(spread.largest, spread.at_least),
        ]
        for name, spread in results.summary.consequences.means.items()
        if spread and name in labels(results)
    ]


def element_row(element: Element, t_end: float) -> list[Cell]:
    """Cells of an element at risk, behind its name."""
    reached, arrival, loss = element.reached, element.arrival, element.loss
    when = f"not within {t_end:g} s"
    if arrival:
        when = f"{at_least(arrival.mean, arrival.at_least)} ({interval(arrival)})"
    return [
        _or_least(reached.probability, reached.at_least),
        limits(reached.interval),
        when,
        *(_or_least(spread.mean, spread.at_least) if spread else None for spread in (element.thickness, element.speed)),
        _or_least(element.carried.probability, element.carried.at_least),
        _or_least(element.ground.mean, element.ground.at_least) if element.ground else None,
        _or_least(loss.expected, loss.at_least) if loss else None,
        limits(loss.interval) if loss else None,
    ]


def _or_least(value: float, is_least: bool) -> str | float:
    """A number of a table, in words where slides would have gone on."""
    return at_least(value, is_least) if is_least else value
