# %% [markdown]
# # 05 What matters, and what was it? Gradients of a slide
#
# Every operation of the solver has a derivative. So one run backwards tells how the slide depends on *each* of its
# inputs: on the strength of every particle, say. Here this draws a map of where strength matters, and then finds the
# strength behind a slide that was observed.
#
# **For those new to JAX:** `jax.grad(f)` is a function that computes the derivative of `f`. It runs `f` forwards,
# keeps what it needs, and goes through the steps again from the last to the first. The price is that of a few runs,
# whatever the number of inputs.
#
# **For those new to MPM:** [01](01_first_slope.ipynb) explains scene, state and run.

# %%
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, ORANGE, RED, SKY, draw_section, style

import jaxmpm as mpm
from cooperative import runs
from cooperative.scene import parse
from cooperative.tools.research import back_analysis
from jaxmpm.run import objectives

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
style()

# %% [markdown]
# ## A run that can be differentiated
#
# `solve` looks at the slide now and then, and stops when it has come to rest: a decision, which has no derivative.
# `replay` takes a given number of steps and decides nothing. What it returns is what `solve` had, and derivatives
# pass through it. Reverse mode would keep the state of every step; `replay` keeps as many as fit into `memory`
# bytes and computes the others again.
#
# The measure is the logarithm of the root mean square displacement. It is smooth from rest to slide, where the largest
# displacement is that of a single particle.

# %%
text = (Path("..") / "benchmarks" / "scenes" / "paper_section.toml").read_text()
if SMALL:
    sizes = {"crest = 30.0": "crest = 10.0", "height = 12.0": "height = 8.0", "toe = 42.0": "toe = 18.0"}
    sizes |= {"mean = 42e3": "mean = 28e3", "run_per_rise = 2.0": "run_per_rise = 1.0"}
    for old, new in sizes.items():
        text = text.replace(old, new)
campaign = parse(text)
model = runs.build(campaign, "rough", runs.random_soil(campaign))
material = replace(model.scene.material, strength=campaign.random["strength"].mean)
scene, state = replace(model.scene, material=material), model.state
scene = mpm.reduced(scene, 1.3)  # weak enough to slide
seconds = 1.0 if SMALL else 2.0
steps = round(seconds / float(scene.numerics.time_step))


def log_displacement(factor: jax.Array) -> jax.Array:
    """Logarithm of the displacement after `steps`, as a function of a factor on the strength."""
    weaker = replace(scene, material=replace(scene.material, strength=scene.material.strength * factor))
    return objectives.log_displacement(mpm.replay(weaker, state, steps)[0])


derivative = float(jax.jit(jax.grad(log_displacement))(1.0))
h = 1e-2
difference = float(jax.jit(log_displacement)(1.0 + h) - jax.jit(log_displacement)(1.0 - h)) / (2 * h)
print(f"{steps} steps: d log u / d log S = {derivative:.2f} by reverse mode, {difference:.2f} by differences")

# %% [markdown]
# One per cent more strength makes a slide in progress smaller by several per cent. The difference is taken with single
# precision and a coarse step, so it agrees to two digits; the tests compare them in double precision to six.
#
# ## Where strength matters
#
# The same in one run for all particles at once. Divided by the particles' volume it is a density, which does not
# depend on how many particles the soil is cut into.

# %%
value, by = mpm.sensitivity(scene, state, objectives.log_displacement, ["strength"], steps=steps)
by_particle = by["strength"]
density = np.asarray(by_particle / scene.particles.volume) * 1e3
position, half_size = np.asarray(scene.particles.position), model.half_size
final = mpm.replay(scene, state, steps)[0]

fig, (above, below) = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
boxes = draw_section(
    above,
    position + np.asarray(final.displacement),
    half_size,
    final.history,
    title=f"plastic strain after {seconds:g} s",
)
fig.colorbar(boxes, ax=above, label="plastic strain [-]")
most = float(np.abs(density).max())
boxes = draw_section(
    below, position, half_size, density, colours="PuOr", limits=(-most, most), title="d log u / d strength, per area"
)
fig.colorbar(boxes, ax=below, label="[1/(kPa m2)]")
plt.show()

# %% [markdown]
# Strength holds the slope along the slip band, and next to nothing anywhere else. A map like this tells where to bore,
# and where to reinforce. Does it tell by how much? Strengthen the tenth of the soil that matters most by 2 %, and as
# much soil elsewhere.

# %%
tenth = len(density) // 10
order = np.argsort(density)
strength = jnp.broadcast_to(scene.material.strength, density.shape)


@jax.jit
def moved_by(strength: jax.Array) -> jax.Array:
    """Logarithm of the displacement with this strength of each particle (N) Pa."""
    return objectives.log_displacement(
        mpm.replay(replace(scene, material=replace(scene.material, strength=strength)), state, steps)[0]
    )


predictions = {}
for name, chosen in (("where it matters", order[:tenth]), ("where it does not", order[4 * tenth : 5 * tenth])):
    change = jnp.zeros_like(strength).at[chosen].set(0.02 * strength[0])
    predicted, computed = float(by_particle @ change), float(moved_by(strength + change) - value)
    predictions[name] = (predicted, computed)
    print(f"2 % more in a tenth of the soil, {name}: log u {computed:+.4f}, by the map {predicted:+.4f}")

# %% [markdown]
# ## Back-analysis: which strength makes this slide?
#
# A slope has slid. Its surface was levelled afterwards, and five markers were followed during the slide. We look for
# the mean strength, the softening modulus, and the leading coefficients of the strength's random field. Parameters
# $p$ and readings $y$ with noise $\sigma$ make the loss
#
# $$\tfrac12 \sum_i \left(\frac{y_i(p) - y_i}{\sigma}\right)^2 + \tfrac12 \sum_k \left(\frac{p_k}{s_k}\right)^2,$$
#
# whose second part is what was known before: the coefficients are standard normal. Its least value is the most
# probable slope; its curvature there tells how well the readings determine each parameter. Here the slide is one of
# our own, so the truth is known.

# %%
modes = 2 if SMALL else 6
near = np.linspace(0.25, 0.75, 5) * position[0].max()
surface = [int(np.argmin(np.abs(position[0] - x) * 10 - position[1])) for x in near]
survey = back_analysis.Survey(
    seconds=1.5 if SMALL else 4.0,
    times=8,
    markers=np.array(surface),
    stations=np.arange(6.0, position[0].max() - 4, 4.0),
)
rng = np.random.default_rng(1)
truth = back_analysis.Parameters(
    factors={"strength": jnp.float32(-0.35), "softening_modulus": jnp.float32(0.2)},
    coefficients=jnp.asarray(0.7 * rng.standard_normal(modes), jnp.float32),
)
noise = 0.02  # m
start, field = (model.scene, model.state), model.leading
clean = jax.jit(partial(back_analysis.predict, *start, survey, field=field))(truth)
observed = jax.tree.map(lambda a: a + noise * rng.standard_normal(a.shape).astype(np.float32), clean)
recovery = back_analysis.recover(
    *start,
    survey,
    observed,
    noise,
    names=truth.factors,
    field=field,
    coefficients=modes,
    iterations=15 if SMALL else 90,
)
readings = sum(leaf.size for leaf in jax.tree.leaves(observed))
print(f"{readings} readings; loss from {recovery.losses[0]:.0f} to {recovery.losses.min():.1f}")

# %%
names = ["log strength", "log softening", *(f"coefficient {k + 1}" for k in range(modes))]


def listed(parameters: back_analysis.Parameters) -> np.ndarray:
    """All parameters in one array."""
    factors = parameters.factors
    return np.array([factors["strength"], factors["softening_modulus"], *parameters.coefficients])


true, got, spread, before = map(listed, (truth, recovery.parameters, recovery.deviation, recovery.prior))
fig, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.6))
left.semilogy(recovery.losses, color=BLUE)
left.set(xlabel="iteration", ylabel="loss")
times = np.arange(1, survey.times + 1) * survey.seconds / survey.times
for k in range(len(surface)):
    middle.plot(times, np.linalg.norm(observed.histories[:, :, k], axis=1), "o", ms=4, color=BLACK)
    middle.plot(times, np.linalg.norm(recovery.predicted.histories[:, :, k], axis=1), color=ORANGE)
middle.plot([], [], "o", ms=4, color=BLACK, label="marker, as read")
middle.plot([], [], color=ORANGE, label="recovered")
middle.set(xlabel="time [s]", ylabel="displacement [m]")
middle.legend()
rows = np.arange(len(names))
right.barh(rows, 4 * before, left=-2 * before, color=SKY, alpha=0.4, label="known before")
right.errorbar(got, rows, xerr=2 * spread, fmt="o", color=BLUE, label="recovered")
right.plot(true, rows, "x", color=RED, ms=8, label="truth")
right.set_yticks(rows, names)
right.set(xlabel="value, with two deviations")
right.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3)
plt.show()

# %% [markdown]
# Bars are what was known before, points what the slide has shown. Parameters that lie together in one valley, mean
# strength and the first coefficients, are estimated together rather than each alone; the field that they make is what
# the slide has felt. Beside it the truth:

# %%
fields = []
for parameters in (truth, recovery.parameters):
    padded = jnp.zeros(model.soil.modes).at[:modes].set(parameters.coefficients)
    fields.append(np.asarray(model.strength(padded)) * float(np.exp(parameters.factors["strength"])) / 1e3)
fig, axes = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
limits = (min(f.min() for f in fields), max(f.max() for f in fields))
for ax, field, title in zip(axes, fields, ("true strength", "recovered strength"), strict=True):
    boxes = draw_section(ax, position, half_size, field, limits=limits, title=title)
    fig.colorbar(boxes, ax=ax, label="strength [kPa]")
plt.show()
error = float(np.mean(np.abs(fields[1] / fields[0] - 1)))
print(f"mean error of the recovered strength: {100 * error:.1f} %")

# %% [markdown]
# ## What to remember
#
# - `mpm.replay(scene, state, steps)` is a run with derivatives; `steps` is what `solve` took.
# - `mpm.sensitivity` is the map of what matters, in one reverse run.
# - `cooperative.tools.research.back_analysis.recover` finds what made a slide, and names what the data do not show.

# %%
results = {
    "derivative_over_difference": derivative / difference,
    "share_of_map_in_a_tenth": float(np.sort(density)[:tenth].sum() / density.sum()),
    "predicted_over_true": predictions["where it matters"][0] / predictions["where it matters"][1],
    "elsewhere_over_where_it_matters": abs(predictions["where it does not"][1] / predictions["where it matters"][1]),
    "loss_per_reading": float(recovery.losses.min() / readings),
    "strength_error": error,
}
print(results)
