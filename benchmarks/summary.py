"""The page that RESULTS.md leads with: what was asked, what was found, against which bound; worst first; best buy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Answer = dict[str, Any]


@dataclass(frozen=True)
class Question:
    """One question to one named figure of a benchmark.

    low, high: the bounds it should keep, None without. published: the value printed by the paper. Where there is one,
    the bounds are around our own figures: they guard against regression, and agreement is the distance's to tell.
    """

    text: str
    benchmark: str
    value: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    published: float | None = None


QUESTIONS = (
    Question("Stability cases beyond their bound", "stability", "cases_failed", high=0),
    Question("Factor of safety, spread over cells of 1 to 0.5 m", "work_precision", "slope_fos_spread_cells_1_to_05"),
    Question("Run-out, spread over cells of 1 to 0.5 m", "work_precision", "slope_runout_spread_cells_1_to_05", "m"),
    Question("The same where all fail (R = 1.4)", "work_precision", "slope_runout_at_R_1.4_spread_cells_1_to_05", "m"),
    Question("Factor of safety, cells of 2 m", "slope", "fos_rough", "", 1.20, 1.28, published=1.26),
    Question("Factor of safety, cells of 1 m", "slope", "fos_refined", "", 1.10, 1.18, published=1.15),
    Question("Run-out, cells of 1 m", "slope", "runout_refined_m", "m", 12.5, 16.0, published=14.17),
    Question("Factor of safety in 3D, cells of 2 m", "published", "fos_rough_3d", published=1.26),
    Question("Factor of safety in 3D, cells of 1 m", "published", "fos_refined_3d", published=1.15),
    Question("Run-out in 3D, cells of 1 m", "published", "runout_refined_3d_m", "m", published=14.17),
    Question("Run-out in 3D, default settings", "published", "runout_refined_3d_default_m", "m", published=14.17),
    Question("Run-out, largest change by a halving of cells", "runout_convergence", "last_two_halvings_max", high=0.05),
    Question("Run-out, default cell against the finest", "runout_convergence", "default_cell_error_max", high=0.10),
    Question("Real slides: surveys within 90 % intervals", "real_slides", "measured_within"),
    Question("Their interval score over the surveyed travel", "real_slides", "travel_interval_score"),
    Question("The same by an empirical relation", "real_slides", "corominas_score"),
    Question("MPM3D-F90: largest distance of a particle", "peer_mpm3d", "position_difference_max_m", "m"),
    Question("Frank slide: travel of its centroid, error", "public", "frank_travel_error_max", high=0.05),
    Question("Mangeney's dam break: front, error", "public", "mangeney_front_error", high=0.03),
    Question("Cantilever, FEM: lowest tip, error", "public", "cantilever_tip_error", high=0.03),
    Question("Slopes with Davis B in 2D: multiplier, error", "public", "slopes_2d_error_max", high=0.03),
    Question("Slopes with Davis B in 3D: multiplier, error", "public", "slopes_3d_error", high=0.03),
    Question("CB-Geo's exact values, error", "public", "exact_error_max", high=0.01),
    Question("Bui's bars: surface over the height", "public", "bui_surface_rms"),
    Question("Bui's bars: front, error", "public", "bui_front_error", high=0.1),
    Question("Limit states: least coverage of 95 % intervals", "public", "reliability_coverage_min", "", 0.93, 0.98),
    Question("Help at a terminal", "commands", "help_s", "s", high=0.3),
    Question("First word of other commands", "commands", "speak_s_max", "s", high=1.5),
    Question("check of a section, CPU", "commands", "check_section_cpu_s", "s", high=4),
    Question("site with two soundings of 1,000 readings", "commands", "site_s", "s", high=10),
    Question("fos --quick of 26 slopes, CPU, largest", "commands", "fos_quick_cpu_s_max", "s", high=5),
    Question("The same, median", "commands", "fos_quick_cpu_s_median", "s", high=2),
    Question("Probability of failure in 3D", "published", "pf_3d", published=0.244),
    Question("Two cores to a COV of 10 % of it", "campaign", "hours_to_cov_10", "h", high=1.2),
    Question("The same with default settings", "campaign", "hours_to_cov_10_default", "h", high=1.8),
    Question("On top, slides of the failures to their end", "campaign", "hours_slides", "h"),
    Question("Factors of safety of 26 known slopes, worst error", "stability_of_slopes", "fos_error_max", high=0.04),
    Question("Known slopes by limit equilibrium, worst error", "limit_equilibrium", "lem_error_max"),
    Question("Newmark's block, a rectangular pulse: error", "earthquakes", "newmark_rectangular_error", high=0.01),
    Question("The same, a sine", "earthquakes", "newmark_harmonic_error", high=0.01),
    Question("Infinite slope, still and shaken: error", "earthquakes", "infinite_slope_error", high=0.01),
    Question("Shear layer shaken at its base: error", "earthquakes", "shear_layer_error", high=0.01),
    Question("Front into dry soil (Celia): error", "seepage", "celia_front_error", high=0.01),
    Question("Rain on one and two layers: error of head", "seepage", "srivastava_yeh_error_max", high=0.01),
    Question("Discharge through a dam (Dupuit): error", "seepage", "dupuit_discharge_error", high=0.01),
    Question("Water lost by flow in the ground", "seepage", "water_balance_max", high=1e-6),
    Question("Gradient of flow against differences", "seepage", "gradient_error", high=1e-6),
    Question("Example 2, factor of safety", "random_slopes", "example_2_fos", published=1.08),
    Question("Example 2, probability of failure", "random_slopes", "example_2_pf", published=0.43),
    Question("The slope in 3D without softening, the same", "random_slopes", "pf_3d_limit_load", published=0.231),
    Question(
        "A step in 3D, rough, MUSL, one core", "throughput", "rough_musl_f32_1core_us", "us per particle", high=0.13
    ),
    Question("The same, refined", "throughput", "refined_musl_f32_1core_us", "us per particle", high=0.16),
    Question("Peak memory, refined", "throughput", "refined_peak_mb", "MB", high=600),
    Question("Two cores over one, one lane", "throughput", "rough_two_core_ratio", high=0.60),
    Question("Two cores over one, 16 lanes", "throughput", "batch16_two_core_ratio", high=0.60),
    Question("1000 rough samples on 2 cores", "screening", "hours_per_1000_samples", "h", high=1.5),
    Question("Realisation of a random field", "fields", "ms_per_realisation_999", "ms", high=0.35),
    Question("Its worst error in correlation", "fields", "ms_per_realisation_999_error_in_correlation"),
    Question("Bias of the probability of failure, of itself", "estimators", "two_phase_bias_max", high=0.01),
    Question(
        "Least coverage of its 95 % interval, sampling alone", "estimators", "two_phase_coverage_min", "", 0.93, 0.97
    ),
    Question("Least coverage where the ranking is bad", "estimators", "coverage_bad_ranking_min", low=0.90),
    Question("Error of campaigns that stop at a COV of 10 %", "estimators", "target_cov_rmse_r098", high=0.11),
    Question(
        "Equivalents for a COV of 10 % (Monte Carlo 310)", "estimators", "two_phase_runs_pf0244_r095", "", high=115
    ),
    Question("Coverage of hazard maps' 95 % intervals, mean", "hazard", "map_coverage_mean", "", 0.93, 0.97),
    Question("The same in the worst cell", "hazard", "map_coverage_min", low=0.90),
    Question("Map of what is covered against the mean covered area", "hazard", "covered_area_error", high=1e-6),
    Question("Expected loss against the area under its curve", "hazard", "loss_identity_error", high=1e-6),
    Question("Share of a step that the maps take", "hazard", "overhead_share", high=0.03),
    Question("Report of a campaign in 3D with maps", "hazard", "report_mb", "MB", high=5),
    Question(
        "Classes that both grids agree on, default settings (published settings 0.80)",
        "estimators",
        "section_default_rough_same_class",
    ),
    Question("Gradient against differences, elastic", "gradients", "fd_rel_elastic", "relative", high=1e-6),
    Question("Gradient against differences, softening", "gradients", "fd_rel_softening", "relative", high=1e-4),
    Question("Reverse over forward step, native", "gradients", "reverse_over_forward_native", high=4),
    Question("The same on XLA", "gradients", "reverse_over_forward_xla", high=8),
    Question("Reverse over 5000 steps, rough 3D: peak memory", "gradients", "rough_reverse_peak_gb", "GB", high=4),
    Question(
        "Monte Carlo's work over importance sampling's, P_f 1.5e-3", "rare_events", "work_monte_carlo_over_importance"
    ),
)
CLOSEST = 6
"""Cases that keep their bound but come closest to it, shown beside those that do not."""


def lead(answers: list[Answer]) -> list[str]:
    """The lines of the page, of those benchmarks that have an answer."""
    by_name = {answer["benchmark"]: answer for answer in answers}
    answered = [(q, by_name[q.benchmark]["values"]) for q in QUESTIONS if q.benchmark in by_name]
    judged = [(q, values[q.value]) for q, values in answered if values.get(q.value) is not None]
    judged.sort(key=lambda pair: keeps(*pair) != "no")
    lines = [
        "## In one page",
        "",
        "| question | answer | bound | kept | published | from |",
        "|---|---|---|---|---|---|",
    ]
    for question, value in judged:
        unit = f" {question.unit}" if question.unit else ""
        link = f"[{question.benchmark}](pages/{question.benchmark}.md)"
        lines.append(
            f"| {question.text} | {value:.4g}{unit} | {bounds(question)} | {keeps(question, value)} "
            f"| {distance(question, value)} | {link} |"
        )
    if "stability" in by_name:
        lines += breaks(by_name["stability"]["rows"])
    if "work_precision" in by_name and "best_buy" in by_name["work_precision"]["values"]:
        lines += best_buy(by_name["work_precision"])
    return lines


def bounds(question: Question) -> str:
    """The bound in words."""
    if question.low is None:
        return "none set" if question.high is None else f"at most {question.high:g}"
    if question.high is None:
        return f"at least {question.low:g}"
    regression = "" if question.published is None else "regression: "
    return f"{regression}{question.low:g} to {question.high:g}"


def distance(question: Question, value: float) -> str:
    """The published value and how far ours lies from it; empty where nothing is published."""
    if question.published is None:
        return ""
    return f"{question.published:g}, off by {value / question.published - 1:+.1%}"


def keeps(question: Question, value: float) -> str:
    """yes, no, or a dash where no bound is set."""
    if question.low is None and question.high is None:
        return "-"
    above = question.low is None or value >= question.low
    return "yes" if above and (question.high is None or value <= question.high) else "no"


def breaks(rows: list[Answer]) -> list[str]:
    """Where it breaks: stability cases beyond their bound with the reason, then those closest to it."""
    failed = [row for row in rows if not row["passed"]]
    closest = sorted((row for row in rows if row["passed"]), key=closeness, reverse=True)[:CLOSEST]
    lines = ["", "### Where it breaks", "", "| case | figure | bound | why |", "|---|---|---|---|"]
    for row in failed:
        lines.append(f"| {row['case']} | {figure(row)} | {limit(row)} | {row.get('why', 'not understood yet')} |")
    lines += ["", f"Of the other {len(rows) - len(failed)} cases these come closest to their bound:", ""]
    lines += ["| case | figure | bound |", "|---|---|---|"]
    return lines + [f"| {row['case']} | {figure(row)} | {limit(row)} |" for row in closest]


def closeness(row: Answer) -> float:
    """1 at the bound, less the farther within it."""
    if row["figure"] == row["bound"] or not row["bound"]:  # a count that is as it should be
        return 0.0
    share = row["figure"] / row["bound"]
    return share if row["sense"] == "<=" else 1 / share


def figure(row: Answer) -> str:
    """The figure with its unit; a lane that broke off has none."""
    return str(row.get("status", "none")) if row["figure"] is None else f"{row['figure']:.3g} {row['unit']}"


def limit(row: Answer) -> str:
    """The bound with its sense."""
    return f"{row['sense']} {row['bound']:g}"


def best_buy(answer: Answer) -> list[str]:
    """What each cell costs and gives in the setting recommended, beside the plain one and the published."""
    values = answer["values"]
    lines = ["", "### Best buy", "", values.get("advice", ""), ""]
    lines += [
        "| setting | cell (m) | fails at R | run-out there (m) | at R = 1.4 (m) | seconds | published R, m, s |",
        "|---|---|---|---|---|---|---|",
    ]
    for setting in dict.fromkeys((values["best_buy"], values.get("best_buy_on_large_cells"), "plain")):
        for row in answer["rows"]:
            if row.get("setting") == setting:
                published = row["published"]
                beside = "" if published == "none" else ", ".join(f"{value:g}" for value in published.values())
                answered = (row[key] for key in ("cell_m", "fails_at_R", "runout_m", "runout_at_R_1.4_m", "seconds"))
                lines.append("| " + " | ".join(map(str, (setting, *answered, beside))) + " |")
    return lines
