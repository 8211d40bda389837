# %% [markdown]
# # 00 Sixty-four slopes
#
# Soil varies in space, and nobody knows it everywhere. Here 64 slopes of the same shape get 64 random strengths, run,
# and are counted. This notebook takes a minute.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLUE, RED, draw_section, style

import cooperative
import jaxmpm as mpm
import kl

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples = 16 if SMALL else 64
style()

# %% [markdown]
# ## A slope, and a field of strength
#
# The strength is lognormal with a mean of 30 kPa and a coefficient of variation of 0.3. It changes over 20 m along the
# slope and over 2 m in depth. `kl` writes the field as a sum of terms; a row of normal numbers is one sample.

# %%
shape = mpm.Slope(crest=8, height=8, run_per_rise=1, toe=16, foundation=2)
soil = mpm.Soil(strength=30e3, softening_modulus=85e3, tension_cutoff=0.0)
scene, state = mpm.slope(shape, soil, mpm.Discretisation(cell=2.0, spacing=(1.0, 1.0)))
field = kl.expand((kl.SquaredExponential(20.0), kl.SquaredExponential(2.0)), shape.corner, shape.extent)
xi = kl.latin_hypercube(jax.random.key(3), samples, field.modes)
strength = kl.Lognormal(mean=30e3, cov=0.3).transform(kl.field_at(field, xi, scene.particles.position))
print(f"{samples} samples of {field.modes} terms at {strength.shape[1]} particles")

# %% [markdown]
# ## Run them
#
# `solve_each` compiles one program and runs a lane for each sample, until it settles or 10 s have passed.

# %%
rules = [mpm.Settle()]
ended = dict(mpm.solve_each(scene, state, {"strength": strength}, width=1, t_end=10.0, rules=rules))
farthest = np.array([float(mpm.diagnostics.largest_displacement(ended[number].state)) for number in range(samples)])
failed = farthest > 1.0
estimate = cooperative.monte_carlo(failed)
low, high = estimate.interval
print(f"{failed.sum()} of {samples} moved more than 1 m: P_f = {estimate.probability:.2f} ({low:.2f} to {high:.2f})")

# %% [markdown]
# ## What they have in common
#
# The strongest and the weakest on average are not always those that stand and fail: where the weak layer lies counts.

# %%
mean = np.asarray(strength).mean(axis=1) / 1e3
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3), width_ratios=(1, 1.6))
left.semilogy(mean[failed], farthest[failed], "o", color=RED, label="failed")
left.semilogy(mean[~failed], farthest[~failed], "o", color=BLUE, label="stand")
left.set(xlabel="mean strength of the sample [kPa]", ylabel="largest displacement [m]")
left.legend()
worst = int(np.argmax(farthest))
position = np.asarray(scene.particles.position + ended[worst].state.displacement)
own = np.asarray(strength[worst]) / 1e3
boxes = draw_section(right, position, (0.5, 0.5), own, title="worst sample, strength [kPa]")
fig.colorbar(boxes, ax=right, shrink=0.8)
plt.show()

# %% [markdown]
# 64 runs on a rough grid give a first probability, with an interval that is wide and that knows nothing of the grid's
# error. A campaign ([04](04_campaign.ipynb)) runs the samples that matter on a fine grid, too.

# %%
results = {
    "failed_share": float(failed.mean()),
    "broke_off": sum(int(each.status) > mpm.Status.DECIDED for each in ended.values()),
    "rank_correlation": float(np.corrcoef(np.argsort(np.argsort(mean)), np.argsort(np.argsort(farthest)))[0, 1]),
}
print(results)
