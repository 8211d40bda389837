# %% [markdown]
# # 01 A first slope in five minutes
#
# We build a slope of clay, look at the stress in it, weaken it until it fails, and watch where it goes.
#
# **If you know JAX but not the material point method (MPM):** soil is a cloud of particles that carry mass, velocity
# and stress. In every time step their momentum is summed on a regular grid, Newton's law is solved there, and the
# particles move with the grid's velocity. The grid forgets everything after the step, so that it never tangles,
# however far the soil slides.
#
# **If you know MPM but not JAX:** JAX is NumPy whose functions can be compiled, differentiated and mapped over a batch.
# Its arrays are never changed in place, so a simulation here is a plain function from one state to the next. You need
# no more of it in this notebook.

# %%
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, RED, corners, draw_section, style
from matplotlib.animation import FuncAnimation, PillowWriter

import jaxmpm as mpm
from cooperative import consequences

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
cell = 2.0 if SMALL else 1.0  # m
style()

# %% [markdown]
# ## The slope
#
# A slope 12 m high at 1:2 above 4 m of the same soil, a section in plane strain: `Slope()` as it comes is that of
# [Jiang, Li, Ma and Rezania (2024)](https://doi.org/10.1016/j.compgeo.2024.106413). All numbers are in SI units.
#
# The clay is undrained: elastic until its shear stress reaches the strength $S_u$, which sinks with the plastic shear
# strain $\gamma^p$,
#
# $$S_u(\gamma^p) = \max\left(S_{u0} - H\,\gamma^p,\; S_{u0}/2\right),\qquad S_{u0} = 42\ \mathrm{kPa},\quad
# H = 85\ \mathrm{kPa}.$$
#
# `slope` gives two things: a *scene*, all that stays (grid, particles, material, walls), and a *state*, all that
# changes.

# %%
shape = mpm.Slope()
soil = mpm.Soil(strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
scene, state = mpm.slope(shape, soil, mpm.Discretisation(cell=cell, spacing=(cell / 2, cell / 2)))
half_size = (cell / 4, cell / 4)
dt = float(scene.numerics.time_step)
print(f"{scene.particles.mass.size} particles, {scene.grid.nodes} nodes, time step {dt * 1e3:.2f} ms")
print("the state holds", {name: np.shape(value) for name, value in vars(state).items() if value is not None})

# %% [markdown]
# ## The stress before anything moves
#
# The state starts in equilibrium with gravity: the stress of elastic loading. Far behind the crest nothing varies
# along x, so that the vertical stress there must be the weight above, $\sigma_{zz} = -\gamma\,(h - z)$. What matters
# for stability is the share of the strength in use, $\sqrt{J_2}/S_u$. Where elasticity asks for more than 1 (yellow),
# the soil will yield a little in the first moment of the run.

# %%
x, z = np.asarray(scene.particles.position)
stress = mpm.tensors.expand(state.stress, 2)  # the six components of a symmetric tensor
root_j2 = np.sqrt(np.asarray(mpm.tensors.second_invariant(mpm.tensors.deviator(stress))))
used = root_j2 / np.asarray(scene.material.strength)

fig, (above, below) = plt.subplots(2, 1, figsize=(9, 3.7), sharex=True)
boxes = draw_section(above, (x, z), half_size, stress[2] / 1e3, title="vertical stress (tension positive)")
fig.colorbar(boxes, ax=above, label=r"$\sigma_{zz}$ [kPa]")
boxes = draw_section(below, (x, z), half_size, used, limits=(0.0, 1.0), title="share of the strength in use")
fig.colorbar(boxes, ax=below, label=r"$\sqrt{J_2}/S_u$ [-]", extend="max")
above.label_outer()
plt.show()

behind = x < 5.0
weight = -soil.unit_weight * (shape.foundation + shape.height - z[behind])
stress_error = float(np.max(np.abs(np.asarray(stress[2])[behind] - weight)) / np.max(np.abs(weight)))
print(f"vertical stress behind the crest: within {stress_error:.1%} of the weight above")

# %% [markdown]
# ## Does it stand?
#
# `solve` runs until `t_end`, or earlier once the slope has come to rest (`settle`). Its result says how the run ended;
# `raise_if_failed` turns a numerical failure into an error. A slope that slides is no such failure.

# %%
standing = mpm.solve(scene, state, t_end=20.0, rules=[mpm.Settle()]).raise_if_failed()
standing_displacement = float(mpm.diagnostics.largest_displacement(standing.state))
seconds = int(standing.state.step) * float(scene.numerics.time_step)
print(
    f"{mpm.Status(int(standing.status)).name} after {seconds:.1f} s, having moved {standing_displacement * 1e3:.1f} mm"
)

# %% [markdown]
# ## How far is it from failure?
#
# The strength reduction method divides the strength by R and looks for the R at which the slope lets go. Each round is
# one batch of runs that differ in their strength only; the bracket narrows until it is 0.01 wide. With softening the
# slope does not fail by degrees: below the factor of safety it moves millimetres, above it metres.

# %%
resolution = 0.05 if SMALL else 0.01
safety = mpm.factor_of_safety(
    scene, state, bracket=(1.0, 1.4), resolution=resolution, batch=3 if SMALL else 5, settle=mpm.Settle()
)
print(f"stands at R = {safety.stable}, fails at R = {safety.fails}")

factors, displacements = np.array(safety.tried).T
failing = displacements > 1.0
fig, ax = plt.subplots(figsize=(7, 3.2))
ax.semilogy(factors[~failing], displacements[~failing], "o", color=BLUE, label="came to rest")
ax.semilogy(factors[failing], displacements[failing], "s", color=RED, label="ended when it had moved more than 1 m")
ax.axhline(1.0, color=BLACK, ls="--", lw=1, label="criterion of failure, 1 m")
ax.set(xlabel="strength divided by R [-]", ylabel="largest displacement [m]")
ax.legend()
plt.show()

# %% [markdown]
# ## Where does it go?
#
# One run just beyond the factor of safety, with snapshots. `reduced` gives a new scene; the old one stays as it was.

# %%
frames = 9 if SMALL else 49
times = np.linspace(0.0, 14.0, frames)
slide = mpm.solve(mpm.reduced(scene, safety.fails), state, t_end=20.0, snapshots=times).raise_if_failed()

fig, axes = plt.subplots(4, 1, figsize=(9, 6.6), sharex=True, sharey=True)
strain_limits = (0.0, 2.0)
for ax, frame in zip(axes, np.linspace(0, frames - 1, 4).round().astype(int), strict=True):
    snapshot = slide.snapshots[frame]
    far = float(mpm.diagnostics.largest_displacement(snapshot))
    boxes = draw_section(
        ax, scene.particles.position + snapshot.displacement, half_size, snapshot.history, limits=strain_limits,
        title=f"t = {times[frame]:.1f} s, moved up to {far:.1f} m",
    )  # fmt: skip
    ax.label_outer()
fig.colorbar(boxes, ax=axes, label="accumulated plastic shear strain [-]", extend="max", aspect=40)
plt.show()

measured = consequences(
    np.asarray(scene.particles.position),
    np.asarray(slide.state.displacement),
    np.asarray(scene.particles.volume),
    shape.face,
    half_size=np.asarray(half_size),
)
print(f"largest displacement {measured.displacement:.1f} m, run-out beyond the toe {measured.runout:.1f} m")
print(f"depth below the crest {measured.depth:.1f} m, volume {measured.volume:.0f} m3 per metre of width")

# %% [markdown]
# The slide is a deep one: the shear band follows the base below the slope, rises behind the crest and comes up beyond
# the toe. The wedge above it moves as two blocks, breaks up, and comes to rest on the flat ground. Grids are not
# innocent: run this again with `cell = 2.0` and the factor of safety is 0.1 higher, because softening without an
# internal length depends on the mesh. A `softening_length` of the soil and `mpm.cell_independent(discretisation, soil)`
# halve that; campaigns have both by default.
#
# ## The slide as an animation

# %%
scratch = tempfile.TemporaryDirectory()
path = Path(scratch.name if SMALL else "figures") / "slide.gif"
fig, ax = plt.subplots(figsize=(8, 2.2))
boxes = draw_section(ax, scene.particles.position, half_size, slide.snapshots[0].history, limits=strain_limits)
ax.set(xlim=(0, shape.length), ylim=(0, 17))
fig.colorbar(boxes, ax=ax, label="plastic strain [-]", extend="max")


def show(frame: int) -> None:
    snapshot = slide.snapshots[frame]
    boxes.set_verts(list(corners(scene.particles.position + snapshot.displacement, half_size)))
    boxes.set_array(np.asarray(snapshot.history))
    ax.set_title(f"t = {times[frame]:4.1f} s", loc="left")


FuncAnimation(fig, show, frames=frames).save(path, writer=PillowWriter(fps=8), dpi=80)
plt.close(fig)

# %% [markdown]
# ![Slide of the weakened slope, coloured by plastic strain](figures/slide.gif)
#
# ## What to remember
#
# - `scene, state = mpm.slope(...)`, then `result = mpm.solve(scene, state, t_end=...)`.
# - A scene is data. Another strength, another gravity: another scene (`mpm.reduced`, `mpm.with_soil`,
#   `dataclasses.replace`).
# - Many strengths at once are a batch: [02 batched screening](02_batched_screening.ipynb).

# %%
results = {
    "stress_error": stress_error,
    "standing_displacement": standing_displacement,
    "stable": safety.stable,
    "fails": safety.fails,
    "runout": measured.runout,
    "speed_at_end": float(mpm.diagnostics.speed(scene, slide.state)),
    "gif_bytes": path.stat().st_size,
}
print(results)
