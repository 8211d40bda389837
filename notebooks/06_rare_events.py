# %% [markdown]
# # 06 Rare events: look for the failure instead of waiting for it
#
# A slope that fails once in a thousand makes plain Monte Carlo wait: a hundred failures, for an answer good to 10 %,
# take a hundred thousand runs. But we know more than that a run failed. Its gradient tells in which direction of the
# random field the slope gets weaker. Following it leads to the *design point*, the most likely field that fails.
# Sampling around it meets failures in every second run, and weights put the probability right.
#
# **For those new to reliability:** the coefficients $\xi$ of the field ([03](03_random_fields.ipynb)) are independent
# standard normals, so fields are the less likely the farther they lie from the origin, $\propto e^{-|\xi|^2/2}$. The
# distance $\beta$ of the closest failing field is the reliability index, and $\Phi(-\beta)$ a first guess at the
# probability of failure (FORM).
#
# **For those new to gradients of a run:** [05](05_sensitivity_and_back_analysis.ipynb).

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, GREEN, ORANGE, draw_section, style
from scipy.stats import norm

from cooperative import runs
from cooperative.estimate import monte_carlo, wilson_interval
from cooperative.scene import parse
from cooperative.tools.research.rare import design_point, importance_sampling, slide_limit_state

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
style()

# %% [markdown]
# ## A slope that seldom fails
#
# The published section, with 57 kPa of mean strength instead of 42.

# %%
text = (Path("..") / "benchmarks" / "scenes" / "paper_section.toml").read_text()
campaign = parse(text)
campaign = replace(campaign, random={"strength": replace(campaign.random["strength"], mean=48e3 if SMALL else 57e3)})
soil = runs.random_soil(campaign)
model = runs.build(campaign, "rough", soil)
limit = campaign.run.failure_displacement
position, half_size = np.asarray(model.scene.particles.position), model.half_size


def fails(xi: np.ndarray) -> np.ndarray:
    """Coefficients (n, modes) -> whether each sample's largest displacement exceeds 1 m, by whole runs."""
    table = np.asarray(xi, np.float32)
    rows = {
        s.number: s.row for s in runs.run_samples(model, table, range(len(table)), rules=model.campaign.rules(limit))
    }
    return np.array([bool(rows[n]["broke_off"]) or float(rows[n]["displacement"]) > limit for n in range(len(table))])


# %% [markdown]
# ## The way to the design point
#
# Failure is a yes or no, and has no gradient. The search follows a smooth stand-in: the logarithm of the root mean
# square displacement after 2.5 s, against half a metre. It only has to lead to the right region.

# %%
limit_state = slide_limit_state(model.scene, model.state, model.varied, seconds=2.5, displacement=0.5)
point = design_point(limit_state, soil.modes)
print(f"beta = {point.beta:.2f} after {point.gradients} gradients; FORM says {point.probability:.1e}")

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2))
left.plot(point.betas, point.values, "o-", color=BLUE)
left.axhline(0, color=BLACK, lw=0.8)
left.set(xlabel="distance from the median field", ylabel="limit state [-]", title="stands above 0, fails below")
right.bar(np.arange(1, soil.modes + 1), point.coefficients, color=ORANGE)
right.set(xlabel="coefficient, by variance", ylabel="value at the design point [deviations]")
plt.show()

# %%
median, worst = (
    np.asarray(model.strength(np.asarray(xi, np.float32))) / 1e3 for xi in (0 * point.coefficients, point.coefficients)
)
fig, ax = plt.subplots(figsize=(9, 2.2))
boxes = draw_section(ax, position, half_size, worst / median, title="most likely failing field, over the median one")
fig.colorbar(boxes, ax=ax, label="strength ratio [-]")
plt.show()

# %% [markdown]
# The most likely failure is no slope that is weak throughout. It has one layer of less than half the median strength,
# just where a slip surface passes below the toe, and nearly the median strength at the crest.
#
# ## Sampling around it
#
# Samples $\xi$ from the normal density around the design point $\xi^*$ get the weight
# $w = e^{|\xi^*|^2/2 - \xi \cdot \xi^*}$, and the mean of $w$ over those that fail is unbiased, wherever $\xi^*$ lies.
# A poor design point costs accuracy, not truth.

# %%
samples = 40 if SMALL else 800
stored: list[np.ndarray] = []


def remembered(xi: np.ndarray) -> np.ndarray:
    """As `fails`, with the answer stored."""
    stored.append(fails(xi))
    return stored[-1]


shifted = importance_sampling(remembered, point.coefficients, samples, seed=1)
low, high = shifted.interval
print(
    f"importance sampling: {shifted.probability:.2e} ({low:.2e} to {high:.2e}), "
    f"cov {shifted.cov:.2f}; {shifted.notes[0]}"
)
plain = fails(np.random.default_rng(2).standard_normal((samples, soil.modes)))
counted = monte_carlo(plain)
print(f"Monte Carlo, as many runs: {counted.probability:.2e} ({counted.interval[0]:.2e} to {counted.interval[1]:.2e})")

# %%
drawn = point.coefficients + np.random.default_rng(1).standard_normal((samples, soil.modes))
weights = np.exp(point.beta**2 / 2 - drawn @ point.coefficients) * stored[0]
n = np.arange(1, samples + 1)
mean = np.cumsum(weights) / n
error = 1.96 * np.sqrt(np.maximum(np.cumsum(weights**2) / n - mean**2, 0) / n)
intervals = np.array([wilson_interval(int(plain[:k].sum()), int(k), 0.95) for k in n])
fig, ax = plt.subplots(figsize=(7, 3.6))
ax.fill_between(n, intervals[:, 0], intervals[:, 1], color=GREEN, alpha=0.2, label="Monte Carlo, 95 %")
ax.fill_between(
    n, np.maximum(mean - error, 1e-9), mean + error, color=BLUE, alpha=0.3, label="importance sampling, 95 %"
)
ax.plot(n, mean, color=BLUE)
ax.axhline(point.probability, color=ORANGE, ls="--", label=r"FORM, $\Phi(-\beta)$")
ax.set(xlabel="runs", ylabel="probability of failure", yscale="log", ylim=(shifted.probability / 30, 1))
ax.legend()
plt.show()

# %% [markdown]
# FORM takes the limit state for a plane through the design point. The slope can fail along other surfaces too, each
# with its own weak layer, so the truth is larger than $\Phi(-\beta)$; sampling adds what FORM leaves out. Fields far
# from the design point that fail still count, with large weights: if they were many, the interval would be wide.
#
# `python -m benchmarks rare_events` compares this with subset simulation and Monte Carlo by run time.
#
# ## What to remember
#
# - `slide_limit_state` is smooth and has a gradient; `design_point` follows it to the most likely failing field.
# - `importance_sampling` counts real failures around it: unbiased, with an interval.

# %%
results = {
    "beta": point.beta,
    "converged": int(point.converged),
    "gradients": point.gradients,
    "failing_share": float(stored[0].mean()),
    "probability_over_form": shifted.probability / float(norm.sf(point.beta)),
    "cov_over_monte_carlo": shifted.cov / float(np.sqrt((1 / shifted.probability - 1) / samples)),
    "weakest_layer_ratio": float((worst / median).min()),
}
print(results)
