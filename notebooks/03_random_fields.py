# %% [markdown]
# # 03 Random fields: soil that varies in space
#
# A field of strength is a random function of position. It has a *marginal* (what values occur, how often), and a
# *correlation* (how alike two points are). This notebook makes such fields, checks them against their own definition,
# ties them to boreholes and tilts them with the strata. The package `kl` knows nothing of the material point method:
# use it for any model.
#
# **For those new to JAX:** all functions after `expand` are pure: the same input gives the same output, and they can
# be compiled, mapped over batches and differentiated. Random numbers come from an explicit key, never from a hidden
# state.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, GREEN, ORANGE, RED, SKY, draw_section, style

import jaxmpm as mpm
import kl

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
realisations = 400 if SMALL else 2000
style()

# %% [markdown]
# ## A field as a sum of modes
#
# A standard Gaussian field $H(x)$ with correlation $c(x - x')$ on an interval is a sum of fixed functions with
# independent normal coefficients $\xi_m$, the Karhunen-Loeve expansion
#
# $$H(x) = \sum_m \sqrt{\lambda_m}\,\varphi_m(x)\,\xi_m,\qquad
# \int c(x - x')\,\varphi_m(x')\,dx' = \lambda_m\,\varphi_m(x).$$
#
# `expand` solves the integral equation and keeps the largest modes. In one dimension, with $c = e^{-(t/\ell)^2}$ and
# $\ell = 2$ m over a depth of 16 m:

# %%
line = kl.expand((kl.SquaredExponential(2.0),), origin=(0.0,), extent=(16.0,))
depth = np.linspace(0.0, 16.0, 201)
modes = kl.field.mode_matrix(line, depth[None])  # (points, modes), each with the root of its eigenvalue
xi = kl.monte_carlo(jax.random.key(0), 1, line.modes)[0]

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2))
for number in range(4):
    left.plot(depth, modes[:, number], label=f"mode {number + 1}: {float(line.fractions[number]):.1%} of the variance")
left.set(xlabel="x [m]", ylabel=r"$\sqrt{\lambda_m}\,\varphi_m$ [-]", title="modes", ylim=(-1.5, 0.7))
left.legend(fontsize=8, loc="lower left")
for count, colour in ((2, ORANGE), (5, GREEN), (line.modes, BLUE)):
    right.plot(depth, modes[:, :count] @ xi[:count], color=colour, label=f"{count} modes")
right.set(xlabel="x [m]", ylabel="H [-]", title="one realisation")
right.legend(fontsize=8)
plt.show()

# %% [markdown]
# ## In a section
#
# With a correlation that is a product over the axes, so are the modes: each axis is solved alone, and the largest
# products are chosen. Lengths and families may differ between axes. Long along the layers, short across them, is what
# soil looks like; kinds with a kink at lag 0 (exponential) are rough, those without are smooth.

# %%
box = (0.0, 0.0), (96.0, 16.0)  # origin and extent, m
layered = kl.expand((kl.SquaredExponential(60.0), kl.SquaredExponential(2.0)), *box)  # 99.9 % of the variance
others: dict[str, tuple[tuple[kl.axis.Covariance, ...], float]] = {
    "squared exponential, 8 m and 8 m": ((kl.SquaredExponential(8.0), kl.SquaredExponential(8.0)), 0.999),
    "Matern 3/2, 60 m and 2 m": ((kl.Matern32(60.0), kl.Matern32(2.0)), 0.99),
    "exponential, 60 m and 2 m": ((kl.Exponential(60.0), kl.Exponential(2.0)), 0.95),
}
kinds = {"squared exponential, 60 m and 2 m": layered}
if not SMALL:
    kinds |= {name: kl.expand(kind, *box, energy=energy) for name, (kind, energy) in others.items()}
lattice = (np.arange(0.5, 96.0), np.arange(0.25, 16.0, 0.5))  # m

fig, axes = plt.subplots(len(kinds), 1, figsize=(9, 1.7 * len(kinds)), sharex=True, sharey=True, squeeze=False)
axes = axes[:, 0]
for ax, (name, expansion) in zip(axes, kinds.items(), strict=True):
    one = kl.field_on_lattice(expansion, kl.monte_carlo(jax.random.key(1), 1, expansion.modes)[0], lattice)
    image = ax.pcolormesh(*lattice, one.T, vmin=-2.5, vmax=2.5, rasterized=True)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    ax.set_title(f"{name}: {expansion.modes} modes", loc="left", fontsize=10)
    ax.label_outer()
fig.colorbar(image, ax=axes, label="standard Gaussian field [-]", extend="both", aspect=40)
plt.show()

# %% [markdown]
# ## Is it what was asked for?
#
# Many realisations, and their sample correlation from the middle of the section along each axis, beside the target.
# The band holds 95 % of what that many realisations scatter by chance; the points of one line scatter together.

# %%
xi = kl.monte_carlo(jax.random.key(2), realisations, layered.modes)
fields = kl.field_on_lattice(layered, xi, lattice)  # (realisations, 96, 32)
i, j = 48, 16
middle = fields[:, i, j]
targets = (
    layered.covariance[0](lattice[0][i:] - lattice[0][i]),
    layered.covariance[1](lattice[1][j:] - lattice[1][j]),
)
estimates = (
    np.asarray(jnp.mean(middle[:, None] * fields[:, i:, j], axis=0)),
    np.asarray(jnp.mean(middle[:, None] * fields[:, i, j:], axis=0)),
)

fig, axes = plt.subplots(1, 2, figsize=(10, 3.2), sharey=True)
for ax, axis, start, target, estimate, name in zip(axes, lattice, (i, j), targets, estimates, "xz", strict=True):
    lag, scatter = axis[start:] - axis[start], 1.96 * np.sqrt((1 + target**2) / realisations)
    ax.fill_between(lag, target - scatter, target + scatter, color=SKY, alpha=0.4, label="95 % by chance")
    ax.plot(lag, target, color=BLACK, label="target")
    ax.plot(lag, estimate, ".", color=RED, label=f"{realisations} realisations")
    ax.set(xlabel=f"lag along {name} [m]")
axes[0].set_ylabel("correlation [-]")
axes[1].legend()
plt.show()
correlation_error = float(max(np.abs(f - t).max() for f, t in zip(estimates, targets, strict=True)))
print(f"largest error in correlation {correlation_error:.3f}, by chance {2 / np.sqrt(realisations):.3f}")

# %% [markdown]
# ## What truncation costs, and where
#
# "95 % of the variance" is a mean over the section. What is lacking is lacking at the ends, where the slope's toe and
# base may be. So the default is 99.9 %, and the loss can be looked at: no realisations are needed for it
# (`kl.captured_variance` tells the error in correlation, too).

# %%
lost_at_worst = []
with_ends = (np.linspace(0.0, 96.0, 97), np.linspace(0.0, 16.0, 33))  # m
fig, axes = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
for ax, energy in zip(axes, (0.95, 0.999), strict=True):
    expansion = kl.expand(layered.covariance, *box, energy=energy)
    variance = np.asarray(kl.field.variance_on_lattice(expansion, with_ends))
    lost_at_worst.append(float(1 - variance.min()))
    image = ax.pcolormesh(*with_ends, variance.T, vmin=0.7, vmax=1.0, rasterized=True)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    title = f"{energy:.1%}: {expansion.modes} modes, {lost_at_worst[-1]:.1%} lost at worst"
    ax.set_title(title, loc="left", fontsize=10)
    ax.label_outer()
fig.colorbar(image, ax=axes, label="captured variance [-]")
plt.show()

# %% [markdown]
# ## From scores to strength
#
# A marginal maps the standard field to the property, quantile by quantile. `Lognormal(mean=..., cov=...)` takes the
# moments of the strength itself. The correlation above is that of the Gaussian field; that of the strength is a
# little lower (`kl.marginal.nataf_error` says by how much).

# %%
marginal = kl.Lognormal(mean=42e3, cov=0.3)
strength = np.asarray(marginal.transform(fields))
mean_error = float(abs(strength.mean() / 42e3 - 1))
cov_error = float(abs(strength.std() / strength.mean() - 0.3))

fig, ax = plt.subplots(figsize=(6, 3.0))
ax.hist(strength[:, ::8, ::4].ravel() / 1e3, bins=80, density=True, color=SKY, label="values of all realisations")
kilopascal = np.linspace(10, 110, 300)
log_variance = np.log(1 + 0.3**2)
deviation = np.log(kilopascal / 42) + log_variance / 2
density = np.exp(-(deviation**2) / (2 * log_variance)) / (kilopascal * np.sqrt(2 * np.pi * log_variance))
ax.plot(kilopascal, density, color=BLACK, label="lognormal, mean 42 kPa, COV 0.3")
ax.set(xlabel="undrained strength [kPa]", ylabel="density [1/kPa]", xlim=(0, 110))
ax.legend()
plt.show()
print(f"mean off by {mean_error:.2%}, coefficient of variation by {cov_error:.4f}")

# %% [markdown]
# ## The same field on every grid
#
# Coefficients belong to the field, not to a mesh. So a rough and a refined grid see the same soil, which is what lets
# a rough run say something about a refined one.

# %%
coefficients = kl.latin_hypercube(jax.random.key(3), 8, layered.modes)[5]


def particles(spacing: float) -> np.ndarray:
    """Positions (2, N) m of particles that fill the published slope."""
    x, z = np.meshgrid(np.arange(spacing / 2, 96.0, spacing), np.arange(spacing / 2, 16.0, spacing))
    return np.stack([x, z])[:, z < mpm.Slope().heights(x)]


fig, axes = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
for ax, spacing in zip(axes, (1.0, 0.5), strict=True):
    where = particles(spacing)
    at_particles = marginal.transform(kl.field_at(layered, coefficients, where))
    boxes = draw_section(
        ax, where, (spacing / 2, spacing / 2), at_particles / 1e3, colours="cividis", limits=(20, 80),
        title=f"{where.shape[1]} particles",
    )  # fmt: skip
    ax.label_outer()
fig.colorbar(boxes, ax=axes, label="undrained strength [kPa]", extend="both")
plt.show()
on_lattice = np.asarray(kl.field_on_lattice(layered, coefficients, lattice))  # two ways to the same field
points = np.stack([lattice[0][:32], lattice[1]])
same_field = float(np.abs(kl.field_at(layered, coefficients, points) - on_lattice[np.arange(32), np.arange(32)]).max())
print(f"on a lattice and at scattered points: the same to {same_field:.0e}")

# %% [markdown]
# ## Boreholes
#
# Where the soil was measured the field is no longer free. Given measured scores $y = A\,\xi + e$, with $A$ the modes
# at the borehole and $e$ the error of measurement, the coefficients are Gaussian again; `condition` works that out
# once, and `conditioned` turns any coefficients into those of a field that honours the data. They remain plain
# coefficients, on any grid.

# %%
borehole_z = np.arange(1.0, 15.5, 1.0)
borehole = np.stack([np.full_like(borehole_z, 30.0), borehole_z])  # at x = 30 m, every metre of depth
truth = marginal.transform(kl.field_at(layered, kl.monte_carlo(jax.random.key(4), 1, layered.modes)[0], borehole))
error = 0.1  # standard deviation of the measurement, in scores
data = kl.condition(layered, borehole, marginal.standardise(truth), error=error)
free = kl.monte_carlo(jax.random.key(5), 200, layered.modes)
tied = kl.conditioned(data, free)

fig, axes = plt.subplots(1, 2, figsize=(10, 3.6), sharey=True)
up = np.linspace(0.0, 16.0, 81)
for ax, at in zip(axes, (30.0, 80.0), strict=True):
    point = np.stack([np.full_like(up, at), up])
    for set_of, colour, name in ((free, SKY, "without the borehole"), (tied, BLUE, "with it")):
        low, high = np.quantile(marginal.transform(kl.field_at(layered, set_of, point)), (0.05, 0.95), axis=0) / 1e3
        ax.fill_betweenx(up, low, high, color=colour, alpha=0.35, label=f"90 % of fields {name}")
    ax.set(xlabel="undrained strength [kPa]", title=f"at x = {at:g} m")
axes[0].plot(truth / 1e3, borehole_z, "o", color=RED, ms=4, label="measured")
axes[0].set_ylabel("z [m]")
axes[0].legend(fontsize=8)
plt.show()
misfit = kl.field_at(layered, tied, borehole) - marginal.standardise(truth)
variance_left = float(kl.field.kriging_variance(data, layered, borehole).mean())
print(
    f"rms misfit at the data {float(jnp.sqrt(jnp.mean(misfit**2))):.3f} scores, variance left there {variance_left:.4f}"
)

# %% [markdown]
# ## Strata that dip, strength that grows with depth
#
# `Bedding` turns the axes of the correlation; `with_trend` gives the field its own mean and deviation at every point.

# %%
dipping = kl.expand(layered.covariance, *box, bedding=kl.Bedding(dip=15.0))
x, z = particles(0.5)
scores = kl.field_at(dipping, kl.monte_carlo(jax.random.key(6), 1, dipping.modes)[0], np.stack([x, z]))
mean = kl.linear_with_depth(mpm.Slope().heights(x) - z, 25e3, 1.5e3)  # 25 kPa at the surface, 1.5 kPa more per metre
trended = kl.with_trend(marginal, scores, mean=mean, deviation=0.25 * mean)

fig, axes = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
half_size = (0.25, 0.25)
boxes = draw_section(axes[0], (x, z), half_size, scores, title="scores, strata that dip by 15 degrees")
fig.colorbar(boxes, ax=axes[0], label="score [-]")
boxes = draw_section(axes[1], (x, z), half_size, trended / 1e3, colours="cividis", title="strength with a trend")
fig.colorbar(boxes, ax=axes[1], label="$S_u$ [kPa]")
axes[0].label_outer()
plt.show()

# %% [markdown]
# ## A derivative, because we can
#
# How does the field change with its correlation length? `with_covariance` decomposes again inside the differentiated
# function; the derivative agrees with a finite difference.


# %%
def energy_of_gradient(length: jax.Array) -> jax.Array:
    """Mean square of the field's change between neighbouring points of a vertical line."""
    changed = kl.with_covariance(layered, (kl.SquaredExponential(jnp.asarray(60.0)), kl.SquaredExponential(length)))
    values = kl.field_at(changed, coefficients, jnp.stack([jnp.full(65, 48.0), jnp.linspace(0.5, 15.5, 65)]))
    return jnp.mean(jnp.diff(values) ** 2)


value_and_derivative = jax.jit(jax.value_and_grad(energy_of_gradient))
below, at, above = (value_and_derivative(jnp.asarray(length)) for length in (1.98, 2.0, 2.02))
derivative, difference = float(at[1]), float(above[0] - below[0]) / 0.04
print(f"derivative {derivative:.6f}, by central difference {difference:.6f}")

# %%
results = {
    "modes": layered.modes,
    "lost_at_worst_of_95": lost_at_worst[0],
    "lost_at_worst_of_999": lost_at_worst[1],
    "correlation_error": correlation_error,
    "mean_error": mean_error,
    "cov_error": cov_error,
    "same_field": same_field,
    "borehole_misfit_over_error": float(jnp.sqrt(jnp.mean(misfit**2))) / error,
    "derivative_error": abs(derivative / difference - 1),
}
print(results)
