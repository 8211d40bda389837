# %% [markdown]
# # 08 From a campaign to a hazard map
#
# Who decides about a road does not ask for a probability of failure, but how likely soil reaches the road, how thick
# it lies there and how fast it comes, and how sure that is. A campaign ([04](04_campaign.ipynb)) knows: its
# refined runs keep, column of cells by column, what passed over the ground, and each run stands for a known share of
# all slopes. So a map needs no further run.
#
# First a section, where a map is a curve along $x$; then a hillside, where it is one. Both are small, so that they run
# in a minute or two: their cells are too coarse to be plausible.

# %%
import csv
import os
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, GREEN, ORANGE, RED, style

import cooperative
from cooperative.scene import read_scene

# %matplotlib inline
SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples, refined_runs = (16, 10) if SMALL else (120, 40)
style()
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)

# %% [markdown]
# ## The section
#
# `[hazard]` has maps made, with thresholds of thickness and speed, each with its unit. `[[exposed]]` names what stands
# in the way. A road has a value and a *vulnerability curve*: which share of the value is lost under how much soil.

# %%
SOIL = """
[soil]
unit_weight = 20e3    # N/m3
young = 2e7           # Pa
poisson = 0.3
softening_modulus = 85e3
residual_ratio = 0.5
tension_cutoff = 0.0
"""
SECTION = f"""
name = "a road below a small slope"
[slope]
crest = 8.0           # m
height = 8.0
run_per_rise = 1.0
toe = 24.0
foundation = 2.0
{SOIL}
[strength]            # undrained shear strength, a random field
mean = 38e3           # Pa
cov = 0.4
length = [20.0, 4.0]  # m
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 8.0
[campaign]
samples = {samples}
refined_runs = {refined_runs}
seed = 3
[hazard]
thresholds = ["0.5 m", "2 m/s"]
[[exposed]]
name = "road"
between = [24.0, 28.0]
value = 2e6
vulnerability = [["0.2 m", 0.0], ["1 m", 0.6], ["2 m", 1.0]]
"""
with warnings.catch_warnings(action="ignore"):
    summary = cooperative.run(SECTION, folder / "section")
low, high = summary.probability.interval
print(f"P_f = {summary.probability.value:.2f}, 95 % interval {low:.2f} to {high:.2f}")
print(f"{summary.cost.refined_runs} refined runs, of which {summary.consequences.slides} slid to their end")

# %% [markdown]
# ## How far: the exceedance curve
#
# The curve says how likely a slope fails *and* its slide goes beyond $x$ metres from the toe. It starts at $P_f$, not
# at 1: most slopes stand, and go nowhere. Where no slide went the probability is 0, and the upper limit says what may
# have been missed.

# %%
curve = summary.consequences.exceedance["runout"]
fig, ax = plt.subplots(figsize=(7, 3))
ax.fill_between(curve.thresholds, curve.low, curve.high, step="post", color=BLUE, alpha=0.2, lw=0)
ax.step(curve.thresholds, curve.probability, where="post", color=BLUE, label="with 95 % interval")
ax.set(xlabel="run-out beyond the toe [m]", ylabel="probability of more [-]", ylim=(0, None))
ax.legend()
plt.show()

# %% [markdown]
# ## Where: the map along the section
#
# `hazard_maps` gives arrays over the columns of cells, each with pointwise limits: the probability of being reached,
# of being covered by more than 0.5 m at the end, of being passed faster than 2 m/s, the expected thickness of the
# deposit, and the mean arrival of the slides that come.

# %%
maps = cooperative.hazard_maps(folder / "section")
x = maps.edges[0]
fig, (above, below) = plt.subplots(2, 1, figsize=(9, 5), sharex=True)
for (name, hazard_map), colour in zip(maps.maps.items(), (BLUE, ORANGE, GREEN, RED), strict=False):
    if maps.units[name] == "-":
        above.stairs(hazard_map.value, x, color=colour, lw=1.8, label=name)
reached = maps.maps["reached"]
above.stairs(reached.high, x, baseline=reached.low, fill=True, color=BLUE, alpha=0.15)
above.axvspan(24, 28, color=BLACK, alpha=0.1, label="road")
above.set(ylabel="probability [-]", ylim=(0, None))
above.legend(fontsize=8)
below.stairs(maps.maps["expected thickness"].value, x, color=BLUE)
below.set(xlabel="x [m]", ylabel="expected thickness [m]")
plt.show()
print(f"looked at every {maps.every:.2g} s; the fastest soil went {maps.missed:.2g} m meanwhile")

# %% [markdown]
# Maps can be checked. The columns beyond the toe times the probability that they are covered at the end have to add up
# to the mean covered length, counted slide by slide in `table.csv` with what each slide stands for.

# %%
(table,) = cooperative.export(folder / "section", ["table"])
rows = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
slid = (rows["grid"] == "refined") & (rows["failed"] == 1)
counted = float(rows["slide_weight"][slid] @ rows["area_columns"][slid])
mapped = float(maps.maps["covered at the end"].value[maps.beyond].sum()) * maps.plan.area
print(f"expected covered length {mapped:.4f} m by the map, {counted:.4f} m by the table")

# %% [markdown]
# ## What it costs
#
# The expected loss is an average over all slopes, those that stand included; it is the area under the loss exceedance
# curve.

# %%
risk = summary.consequences.risk
assert risk is not None
road, loss = risk.places["road"], risk.loss
assert road is not None
assert loss is not None
low, high = road.reached.interval
print(f"the road is reached with probability {road.reached.probability:.2f} ({low:.2f} to {high:.2f})")
print(f"expected loss {loss.expected / 1e6:.2f} million", end=", ")
print("95 % interval " + " to ".join(f"{limit / 1e6:.2f}" for limit in loss.interval or ()))
losses = loss.exceedance
area = float(np.array(losses.probability[:-1]) @ np.diff(losses.thresholds))
print("area under the curve over expected loss:", round(area / loss.expected, 9) if loss.expected else "no loss")

# %% [markdown]
# ## A hillside
#
# Ground from a terrain model is a file of heights, here an ESRI ASCII grid made up for the purpose: a slope with a
# hollow that gathers what slides. Its projection stands in a file beside it (`.prj`), UTM zone 33 north. The heights
# are given from a corner, and `origin` says where that lies: single precision has no digits for millions of metres.

# %%
UTM = (
    'PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]]'
)
along, across = np.meshgrid(np.arange(0, 33.0), np.arange(0, 17.0), indexing="ij")
rise = np.clip((16 - along) / 8, 0, 1)
heights = 2 + 6 * rise * (1 + 0.2 * np.cos(np.pi * across / 8))
lines = "\n".join(" ".join(f"{height:.3f}" for height in row) for row in heights.T[::-1])
head = "ncols 33\nnrows 17\nxllcenter 0\nyllcenter 0\ncellsize 1\n"
(folder / "hill.asc").write_text(head + lines + "\n")
(folder / "hill.prj").write_text(UTM)
(folder / "hill.toml").write_text(f"""
name = "a hillside"
[terrain]
surface = "hill.asc"
base = 0.0
origin = [500000.0, 5200000.0]
{SOIL}
[strength]
mean = 26e3
cov = 0.4
length = [20.0, 8.0, 4.0]
energy = 0.95
[rough]
cell = 2.0
spacing = [1.0, 1.0, 1.0]
[refined]
cell = {2.0 if SMALL else 1.0}
spacing = [{1.0 if SMALL else 0.5}, {1.0 if SMALL else 0.5}, {1.0 if SMALL else 0.5}]
[run]
t_end = {4.0 if SMALL else 6.0}
[campaign]
samples = {12 if SMALL else 48}
refined_runs = {10 if SMALL else 16}
seed = 5
[hazard]
""")
with warnings.catch_warnings(action="ignore"):
    hill = cooperative.run(read_scene(folder / "hill.toml"), folder / "hill")
low, high = hill.probability.interval
print(f"P_f = {hill.probability.value:.2f}, 95 % interval {low:.2f} to {high:.2f}, {hill.consequences.slides} slides")

# %% [markdown]
# The map in plan, with the upper limit of its interval beside it and the ground as contours every metre. With so few
# slides the limits lie far apart, and that is what the map has to say.

# %%
plan = cooperative.hazard_maps(folder / "hill")
reached = plan.maps["reached"]
fig, axes = plt.subplots(1, 3, figsize=(11, 2.6))
panels = {
    "P(reached) [-]": reached.value,
    "its upper limit [-]": reached.high,
    "expected thickness [m]": plan.maps["expected thickness"].value,
}
for ax, (name, values) in zip(axes, panels.items(), strict=True):
    top = reached.high.max() if "[-]" in name else None
    drawn = ax.pcolormesh(*plan.edges, values.T, vmin=0, vmax=top, cmap="cividis")
    ax.contour(along, across, heights, levels=np.arange(2.5, 9.5), colors="white", linewidths=0.6)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    ax.set_title(name, loc="left", fontsize=10)
    fig.colorbar(drawn, ax=ax, shrink=0.7)
plt.show()

# %% [markdown]
# ## Into a GIS
#
# `export` writes all maps as one tidy table. `["geotiff"]` writes each of them as a GeoTIFF and `["geopackage"]` writes
# contours and deposits, both in the projection of the terrain's file. `["netcdf"]` writes the campaign for xarray. All
# three need extras. From a shell it is `python -m cooperative export folder --as maps geotiff geopackage netcdf`.

# %%
written = {path.name: path for path in cooperative.export(folder / "hill", ["maps"])}
with open(written["hazard.csv"], encoding="utf-8", newline="") as file:
    lines = [line for line in csv.DictReader(file) if line["map"] == "reached"]
print(", ".join(written), "written; of each of", len(lines), "columns of the ground:", ", ".join(lines[0]))
read_back = float(np.abs([float(line["value"]) for line in lines] - reached.value.ravel()).max())

# %% [markdown]
# ## What to remember
#
# - `[hazard]` in the scene, before it runs: what passed over a column is stored while running, at a few per cent of a
#   step, and cannot be had afterwards.
# - Look at the upper limit where the value is 0: no slide that was run went there, which is not the same as none.
# - The intervals are of the sampling. They know nothing of the error of the refined grid, nor of soil that is not as
#   the scene says.

# %%
results = {
    "probability": summary.probability.value,
    "curve_starts_at_probability": curve.probability[0] / summary.probability.value,
    "mapped_over_counted": mapped / counted,
    "road_reached": road.reached.probability,
    "hill_probability": hill.probability.value,
    "hill_reached": float(reached.value.max()),
    "read_back_error": read_back,
}
print(results)
scratch.cleanup()
