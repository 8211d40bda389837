# %% [markdown]
# # 10 The friction under a slide, band by band
#
# A slide leaves its track. How rough was the ground it ran over, and where? The gradient of a run by the friction at
# every node of the base answers that, as far as the track holds the answer. Du and He (2025, JAX-MPM,
# [arXiv 2507.04192](https://arxiv.org/abs/2507.04192), Section 5.1.3) recover bands of friction under a dam break so;
# here is the like of it for soil, with the question that a back-analysis has to ask: which bands do the data leave
# open?
#
# **For those new to JAX:** [00](00_one_gradient.ipynb) takes a first gradient.

# %%
import os
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLUE, RED, draw_section, style
from scipy.optimize import least_squares

import jaxmpm as mpm
from jaxmpm.ground import Contact

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
cell = 1.0 if SMALL else 0.5
style()

# %% [markdown]
# ## A column that falls on a base of five bands
#
# Soil with friction stands 4 m high and 6 m wide before a wall, and falls. An interface lets it slide on the base.
# `Contact.of(scene)` has the nodes at which it does; `spread` puts values at them where `with_soil` takes them.

# %%
shape = mpm.Section([(0, 4), (6, 4), (6, 0), (24, 0)], interface=mpm.Interface(friction=20.0))
soil = mpm.FrictionalSoil(cohesion=0.0, friction=28.0, young=1e6)
scene, state = mpm.section(shape, soil, mpm.Discretisation(cell=cell, spacing=(cell / 2, cell / 2)))
contact = Contact.of(scene)
edges = np.array([0.0, 4.0, 7.0, 10.0, 13.0, 24.0])
band = np.clip(np.searchsorted(edges, contact.points[0], side="right") - 1, 0, 4)
steps = int(2.5 / float(scene.numerics.time_step))


def final(angles):
    """State after 2.5 s, for the friction angle of each band (degrees)."""
    varied, start = mpm.with_soil(scene, state, wall_friction=contact.spread(jnp.tan(jnp.deg2rad(angles))[band]))
    return mpm.replay(varied, start, steps)[0]


true = jnp.asarray([24.0, 10.0, 18.0, 13.0, 22.0])
observed = jax.jit(final)(true)
position = np.asarray(scene.particles.position + observed.displacement)
front = position[0].max()
print(f"{position.shape[1]} particles, {steps} steps; the front comes to x = {front:.1f} m")

fig, (above, below) = plt.subplots(2, 1, figsize=(9, 3.6), sharex=True)
draw_section(above, np.asarray(scene.particles.position), (cell / 4,) * 2, np.zeros(position.shape[1]), title="before")
draw_section(below, position, (cell / 4,) * 2, np.asarray(observed.displacement[0]), title="after 2.5 s")
for edge in edges:
    below.axvline(edge, color=RED, lw=0.8)
plt.show()

# %% [markdown]
# ## Back from the track to the bands
#
# The data are the displacements of all particles after 2.5 s, with an error of 5 cm each. Five numbers are sought, so
# forward mode gives the whole Jacobian for little more than five runs. The misfit is a narrow valley with steps in it,
# as particles yield or stick anew: the search by Gauss-Newton with a trust region has 40 runs.

# %%
error = 0.05
noise = error * jax.random.normal(jax.random.key(1), observed.displacement.shape)
data = observed.displacement + noise


def misfit(angles):
    return ((final(angles).displacement - data) / error).ravel()


start = np.full(5, 16.0, np.float32)
residual, jacobian = (jax.jit(each).lower(start).compile() for each in (misfit, jax.jacfwd(misfit)))

begun = time.process_time()
found = least_squares(
    lambda a: np.asarray(residual(a.astype(np.float32)), float),
    start,
    lambda a: np.asarray(jacobian(a.astype(np.float32)), float),
    bounds=(1.0, 45.0),
    x_scale=5.0,
    xtol=1e-4,
    ftol=1e-5,
    max_nfev=40,
)
seconds = time.process_time() - begun
megabytes = jacobian.memory_analysis().temp_size_in_bytes / 2**20
print(f"{found.nfev} runs and {found.njev} Jacobians in {seconds:.1f} s of CPU time")
print(f"memory of a Jacobian {megabytes:.2f} MB")
print(f"chi2 per datum {2 * found.cost / data.size:.2f}")

# %% [markdown]
# ## Which bands do the data know?
#
# The Jacobian at the answer gives the standard error of each band. Soil that never slid on a band says nothing about
# it: its column is zero and its error is infinite, whatever number the search ends with. So is the first band, where
# the soil before the wall stays where it is. No search finds it. Of the last band the front has seen a metre or two,
# which leaves it uncertain by degrees.

# %%
slopes = np.asarray(jacobian(found.x.astype(np.float32)), float)
information = slopes.T @ slopes
known = np.diag(information) > 1e-6 * np.diag(information).max()
deviation = np.full(5, np.inf)
deviation[known] = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(known, known)])))
for number in range(5):
    print(
        f"{edges[number]:4.0f} to {edges[number + 1]:2.0f} m: true {float(true[number]):4.1f}, "
        f"found {found.x[number]:4.1f} +- {deviation[number]:.2g} degrees"
    )

fig, ax = plt.subplots(figsize=(7, 3))
middle = (edges[1:] + edges[:-1]) / 2
ax.plot(middle, true, "s", color=RED, label="true")
shown = np.isfinite(deviation)
bars = {"fmt": "o", "color": BLUE, "capsize": 4}
ax.errorbar(middle[shown], found.x[shown], 2 * deviation[shown], **bars, label="found, 2 errors")
ax.plot(middle[~shown], found.x[~shown], "x", color=BLUE, label="not in the data")
ax.set(xlabel="x [m]", ylabel="friction of the base [degrees]")
ax.legend()
plt.show()

# %% [markdown]
# ## Effort, time and memory beside JAX-MPM
#
# The other column is the script of JAX-MPM for its own problem, `train.py` at commit baddd99 (March 2026), as it
# stands there: water, 6,000 particles. Its times and those of the third column were measured on one core of an AMD
# EPYC with JAX 0.10.2, over 200 steps, as CPU time per particle and step. The paper's abstract states the time of a
# forward run on a GPU alone.
#
# | | here, 384 particles | JAX-MPM, 6,000 particles | here, 6,144 particles |
# |---|---|---|---|
# | data | displacements at the end, error 5 cm | 500 particles in 1,333 frames, exact | |
# | sought | five bands | four; the fifth is given | |
# | search | 40 runs, 39 Jacobians (forward mode) | 500 gradients (reverse mode, Adam) | |
# | steps of a run | 319 | 13,333 | 200 measured |
# | forward run, float32 / float64 | | 0.36 / 0.40 us | 0.086 / 0.17 us |
# | value and gradient, float32 / float64 | | 2.1 / 2.8 us | 0.39 / 0.60 us |
# | memory of the gradient over 200 steps, float32 / float64 | | 78 MB / not read | 82 / 164 MB |
# | the whole search | printed above | 32 hours of one core, from 2.8 us | |
#
# Its forward run holds 1.2 GB, the position of all particles after every step. The laws differ, water there and soil
# with friction here, so the times compare programs and not methods.
#
# **What neither recovers** is a band that nothing slides on. After its 0.4 s the water has come to x = 1.39 m of 2 m,
# so the fifth band, from 1.6 m on, has no part in the data, and the script holds it at its true value. Here the first
# band is such a one, and the error says so. Of the band that the front has just reached (106 of 6,000 particles are on
# the fourth there) the data know little.

# %%
off = np.abs(found.x - np.asarray(true))
results = {
    "runs": int(found.nfev),
    "known_bands": int(known.sum()),
    "worst_off_of_known": float(off[known].max()),
    "worst_in_errors": float((off / deviation)[known].max()),
    "chi2": float(2 * found.cost / data.size),
}
print(results)
