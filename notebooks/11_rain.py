# %% [markdown]
# # 11 Rain: from a hyetograph to the probability of failure against time
#
# Most slopes that fail do so in rain. Water soaks in, suction is lost, pore pressure grows, and strength goes with
# it. How likely has a slope failed a day into a storm, at its end, half a day later? This notebook takes a hyetograph
# to that answer: the rain moves the water of the ground, slices show when the slope is weakest, and samples of random
# soil, each asked at one or two times, give the probability with an interval.
#
# [Water that moves](../docs/seepage.md) has the equations, and `jaxmpm seepage SCENE --probability` does all of this
# from the command line.

# %%
import os
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, ORANGE, RED, style

from cooperative.scene import parse, read_scene
from cooperative.tools.in_time import probability_in_time
from cooperative.tools.seepage import wetted

# %matplotlib inline
SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples, refined_runs = (12, 10) if SMALL else (40, 12)
style()
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)

# %% [markdown]
# ## The hyetograph
#
# A table with a heading that names the units. A rate holds until the next row.

# %%
HYETOGRAPH = """t [h],rain [mm/h]
0,10
6,35
24,20
40,0
"""
(folder / "rain.csv").write_text(HYETOGRAPH)

# %% [markdown]
# ## The slope
#
# A cut in loam, 8 m high. Its cohesion varies from place to place. `[water]` is at rest before the storm, `[rain]`
# names the hyetograph and the times at which the slope is asked. The last one lies after the rain, since water still
# moves down.

# %%
SCENE = f"""
name = "a cut in loam"
[ground]
surface = [[0.0, 10.0], [8.0, 10.0], [18.0, 2.0], [34.0, 2.0]]
[water]
table = [[0.0, 4.0], [18.0, 2.0], [34.0, 1.5]]
[rain]
times = ["0 h", "12 h", "24 h", "40 h", "52 h"]
rate = "rain.csv"
soil = {{ soil_class = "loam" }}
cell = [1.0, 0.5]
[soil]
unit_weight = 18e3              # N/m3
saturated_unit_weight = 20e3
young = 2e7                     # Pa
poisson = 0.3
friction = 29.0                 # degrees
[soil.cohesion]
mean = 2.4e3                    # Pa
cov = 0.5
length = [20.0, 3.0]            # m
[rough]
cell = 1.0
spacing = [0.5, 0.5]
[refined]
cell = {1.0 if SMALL else 0.5}
spacing = {[0.5, 0.5] if SMALL else [0.25, 0.25]}
[run]
t_end = 5.0
[campaign]
samples = {samples}
seed = 1
"""
(folder / "scene.toml").write_text(SCENE)
campaign = parse(read_scene(folder / "scene.toml"))

# %% [markdown]
# ## What the rain does
#
# `wetted` solves Richards' equation once for all samples, and works out the factor of safety of median soil by slices
# at each time. The water balance says how much of the storm soaked in; the rest ran off.

# %%
wet = wetted(campaign)
flow = campaign.flow
print(f"{flow.rained:.1f} m2 fell, {flow.entered:.1f} m2 soaked in; the balance closes to {flow.balance:.0e}")
hours = np.array([moment.time for moment in wet.moments]) / 3600
factors = np.array([moment.factor for moment in wet.moments])

cells = wet.cells
x, z = (cells.corner[k] + cells.spacing[k] * np.arange(cells.shape[k] + 1) for k in (0, 1))
figure, axes = plt.subplots(2, 2, figsize=(9, 4.4), sharex=True, sharey=True)
for ax, moment in zip(axes.flat, (wet.moments[k] for k in (0, 1, 2, 4)), strict=True):
    drawn = ax.pcolormesh(x, z, 9.81 * moment.head.T, cmap="RdBu", vmin=-60, vmax=60)
    ax.set(title=f"{moment.time / 3600:.0f} h: factor {moment.factor:.2f}", aspect="equal")
    ax.plot(*moment.safety.equilibrium.slip.points.T, color=BLACK, lw=1)
figure.colorbar(drawn, ax=axes, label="pore pressure [kPa]")

# %% [markdown]
# Red is suction, which holds grains together; rain takes it away from above. The black line is the slip surface with
# the lowest factor.
#
# ## The probability of failure against time
#
# All samples run on the rough grid at one or two times each: slices say where the first failure is to be looked for,
# and bisection finds it. Some of them run on the refined grid too, which corrects the rough answer. The folder keeps
# what has run, so that the same call would go on.

# %%
with warnings.catch_warnings(action="ignore"):
    answer = probability_in_time(campaign, folder / "answers", refined_runs=refined_runs)
chance = np.array([each.probability for each in answer.estimates])
low, high = np.array([each.interval for each in answer.estimates]).T
print(f"{answer.runs['rough']} rough runs of {samples} samples, where asking each at each time takes {5 * samples}")
for at, each in zip(hours, answer.estimates, strict=True):
    print(f"P_f by {at:3.0f} h: {each.probability:.2f} ({each.interval[0]:.2f} to {each.interval[1]:.2f})")

# %%
rain = np.loadtxt(HYETOGRAPH.splitlines()[1:], delimiter=",")
figure, axes = plt.subplots(3, 1, figsize=(7, 6), sharex=True)
axes[0].step(*np.vstack([rain, [hours[-1], 0.0]]).T, where="post", color=BLUE)
axes[0].set(ylabel="rain [mm/h]")
axes[1].plot(hours, factors, "o-", color=ORANGE)
axes[1].axhline(1.0, color=BLACK, lw=0.8, ls=":")
axes[1].set(ylabel="factor, median soil")
axes[2].fill_between(hours, low, high, color=RED, alpha=0.25, lw=0)
axes[2].plot(hours, chance, "o-", color=RED)
axes[2].set(ylabel="P_f, it has failed", xlabel="time [h]", ylim=(0, 1))

# %% [markdown]
# A sample that has failed at a time counts as failed after it, so that P_f never falls, though the factor of safety
# recovers once the slope drains. The interval is wide: few samples ran. More of them, and more refined ones, narrow
# it.
#
# `jaxmpm seepage SCENE --chart` asks the same samples under many storms, for P_f against intensity and duration
# ([charts](../docs/seepage.md#charts-of-intensity-and-duration)).

# %%
results = {
    "balance": flow.balance,
    "soaked_in": flow.entered / flow.rained,
    "factor_lost": float(factors[0] - factors.min()),
    "rises": bool(np.all(np.diff(chance) >= 0)),
    "within": bool(np.all((low <= chance) & (chance <= high))),
    "runs_a_sample": answer.runs["rough"] / samples,
    "gained": float(chance[-1] - chance[0]),
}
print(results)
