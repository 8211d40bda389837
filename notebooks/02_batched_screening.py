# %% [markdown]
# # 02 A thousand slopes in some minutes
#
# The strength of a soil varies in space, and nobody knows it everywhere. So one slope becomes a thousand
# possible ones: the same geometry, each with another field of strength. Here we run them all on a rough grid, rank
# them by how far they move, and ask what the failures have in common.
#
# **For those new to JAX:** a thousand runs are not a thousand scripts. `solve` and `solve_each` compile one program
# for the time step and feed it one *lane* per sample. On a GPU the lanes run side by side, on a CPU one after the
# other, which keeps a lane in the cache. A lane that comes to rest is refilled with the next sample.
#
# **For those new to MPM:** [01](01_first_slope.ipynb) explains scene, state and run.

# %%
import os
import sys

import jax
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, RED, SKY, draw_section, style
from scipy.stats import spearmanr
from tqdm import tqdm

import cooperative
import jaxmpm as mpm
import kl

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples = 24 if SMALL else 1000
style()

# %% [markdown]
# ## One slope, many strengths
#
# The published section of notebook 01 on cells of 2 m. The strength is a lognormal field of mean 42 kPa and
# coefficient of variation 0.3 that changes over 60 m along the slope but over 2 m in depth, as layered soil does. Its
# Karhunen-Loeve expansion turns a vector of independent normal numbers, the *coefficients* $\xi$ of a sample, into a
# field ([03](03_random_fields.ipynb) says how). A Latin hypercube spreads the coefficients evenly.

# %%
shape = mpm.Slope()
soil = mpm.Soil(strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
scene, state = mpm.slope(shape, soil, mpm.Discretisation(cell=2.0, spacing=(1.0, 1.0)))
position, half_size = np.asarray(scene.particles.position), (0.5, 0.5)

expansion = kl.expand(
    (kl.SquaredExponential(60.0), kl.SquaredExponential(2.0)),
    origin=(0.0, 0.0),
    extent=(shape.length, shape.foundation + shape.height),
)
xi = kl.latin_hypercube(jax.random.key(2024), samples, expansion.modes)
strengths = kl.Lognormal(mean=42e3, cov=0.3).transform(kl.field_at(expansion, xi, scene.particles.position))
print(f"{samples} samples of {expansion.modes} coefficients, strengths at {strengths.shape[1]} particles each")

# %% [markdown]
# ## A sample does not depend on its company
#
# Two samples, one after the other and side by side: the same displacement to the last bit. So a sample is its number,
# and may be run again at any time, in any batch, on its own.


# %%
def final_displacement(numbers: range, width: int) -> dict[int, np.ndarray]:
    """Displacement (2, N) m at the end of each sample's run, `width` lanes at a time."""
    varied = {"strength": (strengths[i] for i in numbers)}
    runs = mpm.solve_each(scene, state, varied, width=width, t_end=20.0, rules=[mpm.Settle()])
    return {number: np.asarray(result.state.displacement) for number, result in runs}


apart, together = final_displacement(range(2), 1), final_displacement(range(2), 2)
same = all(np.array_equal(apart[i], together[i]) for i in range(2))
print("bit for bit the same:", same)

# %% [markdown]
# ## The screening
#
# `solve_each` takes samples as it needs them and yields each result as it ends. We keep final displacement, plastic
# strain and status. A lane that breaks off numerically would say so in its status; it must be counted, never dropped,
# since most break off because the soil moves far.

# %%
displacement = np.zeros((samples, *position.shape), np.float32)
plastic_strain = np.zeros((samples, position.shape[1]), np.float32)
status, steps = np.zeros(samples, int), np.zeros(samples, int)
width = 1 if jax.default_backend() == "cpu" else 64

runs = mpm.solve_each(scene, state, {"strength": strengths}, width=width, t_end=20.0, rules=[mpm.Settle()])
for number, result in tqdm(runs, total=samples, desc="screening", unit="sample", file=sys.stdout, mininterval=1.0):
    displacement[number] = result.state.displacement
    plastic_strain[number] = result.state.history
    status[number], steps[number] = result.status, result.state.step

for kind in mpm.Status:
    if np.any(status == kind):
        print(f"{kind.name}: {np.sum(status == kind)} samples, {steps[status == kind].mean():.0f} steps each")

# %% [markdown]
# ## Ranking, and a first probability
#
# Failure is a largest displacement of more than 1 m. Most samples come to rest within centimetres, the others run for
# metres. The share that failed is a probability of failure *of the rough grid*; its interval holds the sampling of
# fields, not the error of the grid. A finer grid fails more often, but ranks samples much alike. That is why a
# campaign ([04](04_campaign.ipynb)) takes this ranking and runs again, refined, where it matters.

# %%
farthest = np.linalg.norm(displacement, axis=1).max(axis=1)
failed = farthest > 1.0
broke_off = status > mpm.Status.DECIDED
ranking = cooperative.rank_samples(farthest, broke_off)
estimate = cooperative.monte_carlo(failed)
low, high = estimate.interval
print(f"P_f = {estimate.probability:.3f} on the rough grid, 95 % interval {low:.3f} to {high:.3f}")

so_far = np.arange(10, samples + 1, max(1, samples // 100))
history = [cooperative.monte_carlo(failed[:n]) for n in so_far]
rank = np.arange(1, samples + 1)
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4))
in_order = farthest[ranking.order]
left.semilogy(rank[in_order > 1], in_order[in_order > 1], ".", color=RED, label=f"{failed.sum()} failed")
left.semilogy(rank[in_order <= 1], in_order[in_order <= 1], ".", color=BLUE, label=f"{np.sum(~failed)} stand")
left.axhline(1.0, color=BLACK, ls="--", lw=1, label="criterion, 1 m")
left.set(xlabel="rank [-]", ylabel="largest displacement [m]", title="ranked samples")
left.legend()
right.fill_between(so_far, *np.array([e.interval for e in history]).T, color=SKY, alpha=0.4, label="95 % interval")
right.plot(so_far, [e.probability for e in history], color=BLUE, label="share that failed")
right.set(xlabel="samples so far [-]", ylabel="probability of failure, rough [-]", title="convergence", ylim=(0, None))
right.legend()
plt.show()

# %% [markdown]
# ## The worst sample and the best
#
# Both started from the same slope; the difference is in the layers.

# %%
worst, best = ranking.order[0], ranking.order[-1]
fig, axes = plt.subplots(4, 1, figsize=(9, 7), sharex=True, sharey=True)
strength_limits = (float(strengths[worst].min()) / 1e3, float(strengths[best].max()) / 1e3)
for (above, below), number, name in ((axes[:2], worst, "worst"), (axes[2:], best, "best")):
    field = draw_section(
        above, position, half_size, strengths[number] / 1e3, colours="cividis", limits=strength_limits,
        title=f"{name} sample, number {number}: strength, mean {strengths[number].mean() / 1e3:.1f} kPa",
    )  # fmt: skip
    far = draw_section(
        below, position + displacement[number], half_size, np.linalg.norm(displacement[number], axis=0),
        limits=(0.0, float(farthest[worst])), title=f"at the end, moved up to {farthest[number]:.2g} m",
    )  # fmt: skip
    fig.colorbar(field, ax=above, label="strength [kPa]")
    fig.colorbar(far, ax=below, label="displ. [m]")
for ax in axes:
    ax.label_outer()
plt.show()

# %% [markdown]
# ## What the failures have in common
#
# First, where they slide: the plastic strain averaged over all failures. Second, where strength matters: at every
# particle the rank correlation, over all samples, of the strength there with the largest displacement. Where it is
# close to -1 a weak spot makes a slide.

# %%
band = plastic_strain[failed].mean(axis=0)
ranks = np.argsort(np.argsort(np.asarray(strengths), axis=0), axis=0) - (samples - 1) / 2
centred_ranks = np.argsort(np.argsort(farthest)) - (samples - 1) / 2
correlation = centred_ranks @ ranks / np.sum(centred_ranks**2)

fig, (above, below) = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
boxes = draw_section(above, position, half_size, band, title=f"mean plastic strain of {failed.sum()} failures")
fig.colorbar(boxes, ax=above, label="plastic strain [-]")
boxes = draw_section(
    below, position, half_size, correlation, colours="viridis_r", title="rank correlation of strength and displacement"
)
fig.colorbar(boxes, ax=below, label="correlation [-]")
above.label_outer()
plt.show()

# %% [markdown]
# A slide mobilises the strength along its surface, so the mean strength along the common band should tell more than
# that of the whole slope. The band weighs every particle with the failures' mean plastic strain $\bar\gamma_p$,
#
# $$\bar S_u^{\,\mathrm{band}} = \frac{\sum_p \bar\gamma_p\, S_{u,p}}{\sum_p \bar\gamma_p}.$$
#
# Beside it, knowing the outcome, the same mean with each sample's own plastic strain: where it really slid, or began
# to.

# %%
strength = np.asarray(strengths)
means = {
    "the whole slope": strength.mean(axis=1),
    "the common slip band": strength @ (band / band.sum()),
    "its own slip band": np.sum(strength * plastic_strain, axis=1) / plastic_strain.sum(axis=1),
}
rank_correlation = {name: float(spearmanr(mean, farthest).statistic) for name, mean in means.items()}

fig, axes = plt.subplots(1, 3, figsize=(11, 3.2), sharey=True)
for ax, (name, mean) in zip(axes, means.items(), strict=True):
    ax.semilogy(mean[~failed] / 1e3, farthest[~failed], ".", ms=4, color=BLUE, label="stands")
    ax.semilogy(mean[failed] / 1e3, farthest[failed], ".", ms=4, color=RED, label="failed")
    ax.set(xlabel=f"mean strength of {name} [kPa]", title=f"rank correlation {rank_correlation[name]:.2f}")
axes[0].set_ylabel("largest displacement [m]")
axes[2].legend()
plt.show()

# %% [markdown]
# The common band alone separates most failures from the rest. Those few that fail in spite of a strong band, the
# worst sample among them, slide on a weak layer higher up: another mode, with its own surface, as their own band
# shows.
#
# ## What to remember
#
# - `mpm.solve_each(scene, state, {"strength": strengths}, width=...)` runs any number of samples through a fixed
#   number of lanes, and yields each as it ends.
# - Rank by the displacement, not by the class: it is continuous, and it is what rough and refined grids agree on.
# - The mean strength along the band tells most of the outcome before any run; what it leaves open, the runs tell.

# %%
results = {
    "same_in_any_batch": same,
    "failed": int(failed.sum()),
    "broke_off": int(broke_off.sum()),
    "settled_share_of_steps": float(steps[~failed].mean() * float(scene.numerics.time_step) / 20.0),
    "rank_correlation_overall": rank_correlation["the whole slope"],
    "rank_correlation_band": rank_correlation["the common slip band"],
    "rank_correlation_own": rank_correlation["its own slip band"],
    "deepest_correlation_at": float(position[1, np.argmin(correlation)]),
    "worst_over_best": float(farthest[worst] / farthest[best]),
}
print(results)
