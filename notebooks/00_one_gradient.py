# %% [markdown]
# # 00 One gradient
#
# Which soil decides how far a slope runs out? One run and its gradient by the strength of every particle tell. This
# notebook takes a minute, most of which is compiling.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from drawing import draw_section, style

import jaxmpm as mpm
from jaxmpm import objectives

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
style()

# %% [markdown]
# ## A slope that fails
#
# Everything is a number or an array: the shape, the soil, the grid. `slope` gives the scene and its state at rest.

# %%
shape = mpm.Slope(crest=8, height=6, run_per_rise=1, toe=12, foundation=2)
grid = mpm.Discretisation(cell=2.0 if SMALL else 1.0, spacing=(1.0, 1.0) if SMALL else (0.5, 0.5))
scene, state = mpm.slope(shape, mpm.Soil(strength=7e3, young=2e7, softening_modulus=20e3), grid)
result = mpm.solve(scene, state, t_end=3.0)
print(f"{scene.particles.mass.size} particles, {int(result.state.step)} steps, {mpm.Status(int(result.status)).name}")

# %% [markdown]
# ## The run-out as a function of strength
#
# `replay` takes a fixed number of steps and can be differentiated. `jax.value_and_grad` of an ordinary function of the
# strength (one value for each particle) gives the run-out and its derivative by all of them at once.

# %%
steps = int(result.state.step)


def runout(strength):
    varied, start = mpm.with_soil(scene, state, strength=strength)
    final, _ = mpm.replay(varied, start, steps)
    return objectives.runout(scene, final, toe=shape.toe_x)


strength = jnp.full(scene.particles.mass.shape, 7e3)
value, slope = jax.jit(jax.value_and_grad(runout))(strength)
print(f"run-out {float(value):.2f} m; all soil 1 kPa stronger: {float(slope.sum()) * 1e3:+.2f} m")

fig, ax = plt.subplots(figsize=(9, 3))
per_kpa = np.asarray(slope) * 1e6 / np.asarray(scene.particles.volume)
largest = float(np.abs(per_kpa).max())
boxes = draw_section(
    ax, np.asarray(scene.particles.position), np.asarray(grid.spacing) / 2, per_kpa, colours="RdBu",
    limits=(-largest, largest), title="run-out per kPa and m2 of soil [mm]",
)  # fmt: skip
fig.colorbar(boxes, ax=ax, shrink=0.8)
plt.show()

# %% [markdown]
# ## Does the gradient say what a run says?
#
# Strengthen the one particle that matters most, and all of them, a little, and run again.

# %%
most = int(np.argmin(slope))
change = 150.0
again = float(runout(strength + change) - runout(strength - change)) / (2 * change)
x, z = np.asarray(scene.particles.position)[:, most]
print(f"strength at ({x:.1f}, {z:.1f}) m matters most")
print(f"all soil: by gradient {float(slope.sum()) * 1e3:.3f} m per kPa, by two runs {again * 1e3:.3f}")

# %% [markdown]
# Go on: [00](00_sixty_four_slopes.ipynb) screens random fields, [05](05_sensitivity_and_back_analysis.ipynb) uses
# gradients to find the soil behind an observed slide, [10](10_friction_of_the_base.ipynb) the friction under one.

# %%
results = {
    "runout": float(value),
    "slope_per_kpa": float(slope.sum()) * 1e3,
    "gradient_over_difference": float(slope.sum()) / again,
    "depth_of_what_matters": float(z),
}
print(results)
