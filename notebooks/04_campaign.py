# %% [markdown]
# # 04 A whole campaign: how likely, in which way, how far
#
# A refined run costs some ten rough ones, and the rough grid is wrong about the class of every tenth sample, though
# seldom about their rank ([02](02_batched_screening.ipynb)). A campaign spends refined runs where they tell most: it
# runs all samples on the rough grid, draws some of them for the refined grid, most where the rough result leaves most
# doubt, and corrects the rough answer with what they say. The result is a probability of failure *of the refined
# grid* with an honest interval, the modes in which the slope fails, and what the slides do.
#
# No JAX is needed here, and of the material point method only what [01](01_first_slope.ipynb) says.

# %%
import contextlib
import os
import sqlite3
import sys
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import draw_section, style

import cooperative
import jaxmpm as mpm
from cooperative import run
from cooperative.reporting import _charts as charts
from cooperative.scene import parse
from cooperative.summary import slides_of

# %matplotlib inline
SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples, refined_runs, cell = (20, 10, 2.0) if SMALL else (200, 60, 1.0)
style()

# %% [markdown]
# ## The scene
#
# A campaign is described by a TOML file, checked before anything runs: an unknown key or a length that does not fit
# the grid is named at once. This is `benchmarks/scenes/section.toml` with a budget of refined runs. It does not say
# how answers depend on the grid, so it gets the defaults: volumetric strain averaged over cells, which cures locking,
# and shear bands as thick on either grid, a fifth of the slope's height (`softening_length`).

# %%
scene = f"""
name = "plane-strain section of the published slope"

[slope]
crest = 30.0          # m
height = 12.0
run_per_rise = 2.0
toe = 42.0
foundation = 4.0

[soil]
unit_weight = 20e3    # N/m3
young = 1e8           # Pa
poisson = 0.3
softening_modulus = 85e3   # Pa per unit of plastic shear strain
residual_ratio = 0.5
tension_cutoff = 0.0

[strength]            # undrained shear strength, a random field
mean = 42e3           # Pa
cov = 0.3
marginal = "lognormal"
correlation = "squared exponential"
length = [60.0, 2.0]  # m

[rough]
cell = {2 * cell}
spacing = [{cell}, {cell}]

[refined]
cell = {cell}
spacing = [{cell / 2}, {cell / 2}]

[run]
t_end = 20.0
failure_displacement = 1.0

[campaign]
samples = {samples}
refined_runs = {refined_runs}
seed = 7
k_t = 10
"""
campaign = parse(scene)

# %% [markdown]
# ## Run it
#
# `campaign.run` does all of it, in a folder that holds the scene and one file per finished sample. From a shell it is
# `python -m cooperative run scene.toml --out folder`, with `--workers` for more processes.

# %%
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name) / "section"
with contextlib.redirect_stderr(sys.stdout):
    summary = run(scene, folder, progress=True)
print()
cost, pf = summary.cost, summary.probability
low, high = pf.interval
print(f"P_f = {pf.value:.3f}, 95 % interval {low:.3f} to {high:.3f}: {cost.finished}")
print(f"rough grid: {pf.failures_rough} of {cost.samples} failed, {cost.seconds['rough']:.0f} s")
print(
    f"refined grid: {pf.failures_refined} of {cost.refined_runs} chosen samples failed, {cost.seconds['refined']:.0f} s"
)
print(*summary.notes, sep="\n")

# %% [markdown]
# ## By rank
#
# The rough displacement orders the samples. The refined runs, drawn at random with a probability that is largest
# where the rough displacement leaves most doubt, should fail at the left, stand at the right, and change over
# somewhere between. Where they do not, the rough grid tells little, and the interval shows it.

# %%
store = cooperative.read_store(folder)
rough, refined = cooperative.read_rows(store, "rough"), cooperative.read_rows(store, "refined")
on_refined = np.full(samples, np.nan)
on_refined[list(refined.numbers)] = refined.columns["displacement"]
charts.ranked_displacements({"rough": rough.columns["displacement"], "refined": on_refined})

# %% [markdown]
# How alike the grids are, in one number: the rank correlation of their displacements, here over the samples that ran
# on both. Its neighbour is the share that the rough grid puts in the same class.

# %%
grids = summary.probability.grids
assert grids is not None
print(f"rank correlation {grids.spearman:.2f}, same class {grids.same_class:.0%} of {grids.samples} samples")
charts.grids(
    rough.columns["displacement"][list(refined.numbers)], refined.columns["displacement"], failure_displacement=1.0,
    title="samples that ran on both grids",
)  # fmt: skip

# %% [markdown]
# ## The probability, and what more runs would buy
#
# With $p_i$ the probability that sample $i$ fails as a logistic model of its rough displacement sees it, and $\pi_i$
# the probability with which it was drawn for a refined run, the estimate is
#
# $$\hat P_f = \frac1N\sum_{i=1}^N p_i + \frac1N\sum_{i\ \mathrm{refined}} \frac{1[\text{fails}] - p_i}{\pi_i}.$$
#
# The second sum corrects whatever the model gets wrong, so that the estimate is unbiased however bad the rough grid;
# a good one makes the interval narrow.

# %%
more = summary.cost.after_more_runs
print(
    f"coefficient of variation {summary.probability.coefficient_of_variation:.2f}; after {more.runs} more refined runs "
    f"{more.coefficient_of_variation:.2f} is to be expected"
)
charts.convergence(summary.probability.convergence, summary.probability.estimator, level=summary.probability.level)

# %% [markdown]
# ## In which way
#
# In a section a slide is shallow where it passes above the toe, deep where it passes below, progressive where a
# second mass lets go later, in a pulse of its own. The rules look at where and when soil starts to move
# (`cooperative.failure_mode`). Shares and consequences weigh every refined run by what it stands for.

# %%
columns = refined.columns
failed = columns["displacement"] > 1.0
modes = {mode: part for mode, part in (summary.modes.shares or {}).items() if part.count}
for mode, part in modes.items():
    mine = failed & (columns["mode"] == mode)
    print(
        f"{mode}: {part.count} runs, P = {part.probability:.3f}; run-out {columns['runout'][mine].mean():.1f} m, "
        f"depth {columns['depth'][mine].mean():.1f} m, volume {columns['volume'][mine].mean():.0f} m3/m"
    )
charts.mode_shares(modes)

# %% [markdown]
# The farthest slide of each mode, as its refined run left it:

# %%
shape = campaign.site.shape
assert isinstance(shape, mpm.Slope)
model, _ = mpm.slope(shape, campaign.soil, campaign.grids["refined"])
farthest = {
    mode: int(columns["sample"][np.argmax(np.where(failed & (columns["mode"] == mode), columns["displacement"], -1))])
    for mode in modes
}
fig, axes = plt.subplots(len(farthest), 1, figsize=(9, 1.8 * len(farthest)), sharex=True, squeeze=False)
for ax, (mode, number) in zip(axes[:, 0], farthest.items(), strict=True):
    sample = cooperative.read_sample(store, "refined", number)
    boxes = draw_section(
        ax, model.particles.position + sample.fields["displacement"], np.asarray(campaign.refined.spacing) / 2,
        sample.fields["plastic_strain"], limits=(0.0, 2.0),
        title=f"{mode}, sample {number}: moved up to {sample.row['displacement']:.1f} m",
    )  # fmt: skip
    ax.label_outer()
fig.colorbar(boxes, ax=axes, label="plastic shear strain [-]", extend="max")
plt.show()

# %% [markdown]
# ## How far
#
# Distributions fitted to the consequences of the failures, best by Akaike's criterion first. With few failures
# several fit alike: the criterion says how much better one is than the next.

# %%
labels = {"displacement": "displacement [m]", "runout": "run-out beyond the toe [m]", "volume": "volume [m3/m]"}
fits = summary.consequences.fits["all"]
for name in labels:
    print(name, {fit.name: round(fit.aic, 1) for fit in fits[name].fits[:3]})
ended = failed & ~columns["broke_off"].astype(bool)
weights = slides_of(campaign, cooperative.phases_of(campaign, rough, refined), refined).weight[ended]
charts.fitted({name: columns[name][ended] for name in labels}, weights, fits, labels)

# %% [markdown]
# ## Stop it at any time
#
# All that is known is in the folder, in a database that anyone may ask. Run the same scene again and it goes on from
# there: here nothing is left to do. A row that was changed is named, set aside, and its sample is run again.

# %%
with contextlib.closing(sqlite3.connect(folder / "campaign.db")) as database, database:
    database.execute("update run set displacement = 0 where grid = 'rough' and sample = 0")
with warnings.catch_warnings(action="ignore"):  # that names the database, with its path
    again = run(scene, folder)
same = again.probability.value == summary.probability.value
print("the same answer after the damage:", same)
print("set aside:", [path.name for path in folder.glob("*.damaged")])

# %% [markdown]
# ## What to remember
#
# - One TOML file, one folder, one command; `python -m cooperative report folder` writes figures and words of it.
# - Look at the ranked figure first: it shows whether the rough grid earns its trust.
# - The interval holds the sampling of fields and the choice of refined runs, not the error of the refined grid. The
#   defaults keep that error from following the cell; `softening_length = "cell"` and `fbar = false` are the published
#   settings, which fail less often and run out less far.
# - A note that the run-out reached the wall asks for a longer `toe`.

# %%
results = {
    "probability": summary.probability.value,
    "interval_holds": bool(low < summary.probability.value < high),
    "refined_runs": summary.cost.refined_runs,
    "rough_share": summary.probability.failures_rough / samples,
    "rank_correlation": grids.spearman,
    "mode_ratios": float(sum(part.ratio for part in modes.values())),
    "same_after_damage": same,
}
print(results)
