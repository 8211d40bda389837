# %% [markdown]
# # 07 Your own material and scene, in 1D, 2D and 3D
#
# A constitutive law is a function from strain increment and stress to the new stress. A scene is a handful of arrays.
# Both take some twenty lines, and the same twenty lines serve in one, two and three dimensions. We write a Bingham
# soil (mud that flows once its strength is passed), test it alone, as a wave against an exact solution, and as a
# slump against a closed form. On the way the wave is run with shape functions of our own, and at the end a campaign
# with an estimator of our own.
#
# **For those new to JAX:** a material is a frozen dataclass registered as a *pytree*, so that JAX sees through to the
# numbers in it: they can be batched and differentiated. `update` must not branch on values (`jnp.where` instead of
# `if`).
#
# **For those new to MPM:** the solver gives `update` the strain increment that the grid's velocity gives a particle
# in one step. Nothing else of the method is visible to a law.

# %%
import os
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from drawing import BLACK, BLUE, GREEN, ORANGE, RED, draw_section, style
from jax import Array
from scipy.linalg import expm

import jaxmpm as mpm
from cooperative import campaign, rank_samples
from cooperative.estimate import Answers, Estimate, Population, Sampling, SceneSamples, wilson_interval
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
style()

# %% [markdown]
# ## The law
#
# Elastic below the strength $S$; above it the excess drives viscous flow,
#
# $$\dot{\mathbf s} = 2G\,\dot{\mathbf e} - \frac{G}{\eta}\,\frac{\langle t - S\rangle}{t}\,\mathbf s,\qquad
# t = \sqrt{J_2},\qquad \dot p = K\,\dot\varepsilon_v .$$
#
# In steady shear at the rate $\dot\gamma$ the shear stress is $\tau = S + \eta\,\dot\gamma$, which is Bingham's
# fluid. The excess is integrated by the implicit Euler rule: stable for any time step, and exact in steady flow.
#
# Tensors are tuples of six components (xx, yy, zz, xy, yz, xz), tension positive. Those that a dimension cannot have
# are the number 0.0 and vanish when the program is compiled: that is why one law serves all dimensions.
# `mpm.pytree` makes a dataclass of arrays something that JAX can trace, batch and differentiate. `mpm.laws.Law` has
# what most laws share: the speed of the elastic wave, no history, no softening (see `mpm.Material` for all of it).
# PARAMETERS declares the law's numbers: what they may be (a lane with another one takes no step and has a status of its
# own), and whether strength reduction divides them.


# %%
@mpm.pytree
@dataclass(frozen=True)
class Bingham(mpm.laws.Law):
    """Moduli K and G, strength S (Pa) and viscosity (Pa s)."""

    bulk: Array
    shear: Array
    strength: Array
    viscosity: Array

    PARAMETERS = {  # noqa: RUF012
        "strength": mpm.laws.Parameter(least=0.0, unit="Pa", reduced=True),
        "viscosity": mpm.laws.Parameter(above=0.0, unit="Pa s"),
    }

    def update(self, strain_increment: Any, stress: Any, history: None, dt: Array | None = None) -> tuple[Any, None]:
        assert dt is not None  # the package gives it
        pressure = mean(stress) + 3 * self.bulk * mean(strain_increment)
        strains = deviator(strain_increment)
        trial = [s + 2 * self.shear * e for s, e in zip(deviator(stress), strains, strict=True)]
        t = safe_sqrt(second_invariant(trial))
        excess = jnp.maximum(t - self.strength, 0)
        decay = self.shear * dt / self.viscosity
        lost = excess * decay / (1 + decay)
        xx, yy, zz, xy, yz, xz = ((1 - lost / jnp.where(t > 0, t, 1)) * s for s in trial)
        return (xx + pressure, yy + pressure, zz + pressure, xy, yz, xz), history


def number(value: float) -> Array:
    return jnp.asarray(value, jnp.float32)


# %% [markdown]
# ### Alone, without any grid
#
# A law is a function, so it can be driven by itself: 1 s of simple shear, at many rates at once by `jax.vmap`.

# %%
mud = Bingham(bulk=number(3e6), shear=number(1e6), strength=number(2e3), viscosity=number(2e3))


def sheared(rate: Array) -> Array:
    """Shear stress (Pa) after 1 s of simple shear at `rate` (1/s)."""
    dt = number(1e-3)
    increment = (0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * rate * dt)  # shear components are tensorial: half of gamma
    none = (number(0.0),) * 6
    stress, _ = jax.lax.scan(lambda stress, _: (mud.update(increment, stress, None, dt)[0], None), none, length=1000)
    return stress[5]


rates = jnp.linspace(0.1, 3.0, 13)
shear_stress = jax.jit(jax.vmap(sheared))(rates)
flow_error = float(jnp.max(jnp.abs(shear_stress / (mud.strength + mud.viscosity * rates) - 1)))

fig, ax = plt.subplots(figsize=(5.5, 3))
ax.plot(rates, (mud.strength + mud.viscosity * rates) / 1e3, color=BLACK, label=r"$S + \eta\,\dot\gamma$")
ax.plot(rates, shear_stress / 1e3, "o", color=RED, label="the law, after 1 s")
ax.set(xlabel=r"shear rate $\dot\gamma$ [1/s]", ylabel=r"shear stress $\tau$ [kPa]", ylim=(0, None))
ax.legend()
plt.show()
print(f"largest error {flow_error:.1e}")

# %% [markdown]
# ## The scene
#
# `mpm.slope`, `column`, `bar` and `block` build scenes of the usual soils. `mpm.scene` takes any particles, grid and
# law and refuses what does not fit: here a grid with one cell of padding around the domain, particles (two per cell and
# axis, each with its box), and walls at the faces of the domain. The dimension is the length of `domain`. The body
# starts without stress; `mpm.at_rest` would give it that of its own weight.


# %%
def scene_of(
    material: Bingham,
    domain: tuple[float, ...],
    inside: Callable[[np.ndarray], np.ndarray] | None,
    *,
    cell: float,
    gravity: float = 0.0,
    base: Literal["fixed", "roller"] = "roller",
    kernel: type[mpm.Kernel] = mpm.GIMP,
) -> tuple[mpm.Scene, mpm.State]:
    """A body of density 2000 kg/m3 where it is `inside`, in a box with smooth walls or a fixed base."""
    d, edge = len(domain), cell / 2
    grid = mpm.Grid(shape=tuple(round(length / cell) + 3 for length in domain), cell=cell, origin=(-cell,) * d)
    particles = mpm.fill(domain, (edge,) * d, unit_weight=2000 * 9.81, inside=inside)
    walls = (
        *(mpm.Wall(axis, "low", 1, base if axis == d - 1 else "roller") for axis in range(d)),
        *(mpm.Wall(axis, "high", nodes - 2, "roller") for axis, nodes in enumerate(grid.shape)),
    )
    numerics = mpm.Discretisation(cell, (edge,) * d, kernel)
    speed = float(np.sqrt(2 * gravity * domain[-1]))
    boundary, loads = mpm.Boundary(walls), mpm.Loads(gravity)
    scene = mpm.scene(particles, grid, material, numerics, boundary=boundary, loads=loads, speed=speed)
    return scene, mpm.unstressed(scene)


# %% [markdown]
# ## A wave that dies out, in 1D, 2D and 3D
#
# Without strength ($S = 0$) the law is a Maxwell fluid, for which a standing pressure wave $v = \hat v(t)\,\sin(bx)$,
# $b = \pi/L$, between smooth walls has an exact solution. Its amplitude, the pressure and the deviatoric stress obey
#
# $$\frac{d}{dt}\begin{pmatrix}\hat v\\ \hat p\\ \hat s\end{pmatrix} =
# \begin{pmatrix}0 & -b/\rho & -b/\rho\\ K b & 0 & 0\\ \tfrac43 G b & 0 & -G/\eta\end{pmatrix}
# \begin{pmatrix}\hat v\\ \hat p\\ \hat s\end{pmatrix},$$
#
# which a matrix exponential solves. The same function makes a bar of 10 m, a strip and a beam of it.

# %%
length, tip, times = 10.0, 1e-2, np.linspace(0.0, 0.5, 41)
fluid = replace(mud, strength=number(0.0), viscosity=number(2e5))
b, density = np.pi / length, 2000.0
bulk, shear, viscosity = (float(value) for value in (fluid.bulk, fluid.shear, fluid.viscosity))
matrix = np.array([[0, -b / density, -b / density], [bulk * b, 0, 0], [4 / 3 * shear * b, 0, -shear / viscosity]])
exact = np.array([(expm(matrix * t) @ [tip, 0, 0])[0] for t in times])


def amplitude(size: tuple[float, ...], cell: float, kernel: type[mpm.Kernel] = mpm.GIMP) -> np.ndarray:
    """Amplitude (m/s) of the standing wave at `times` in a filled box."""
    scene, state = scene_of(fluid, size, None, cell=cell, kernel=kernel)
    shape = np.sin(b * np.asarray(scene.particles.position[0]))
    state = replace(state, velocity=state.velocity.at[0].set(tip * shape))
    run = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed()
    return np.array([2 * np.mean(snapshot.velocity[0] * shape) for snapshot in run.snapshots])


sizes = {"1D": (length,), "2D": (length, 2.0), "3D": (length, 2.0, 2.0)}
waves = {name: amplitude(size, 0.5) for name, size in sizes.items()}
dimensions_differ = float(max(np.abs(waves[name] - waves["1D"]).max() for name in ("2D", "3D")) / tip)

cells = (1.0, 0.5) if SMALL else (1.0, 0.5, 0.25)
bars = [waves["1D"] if cell == 0.5 else amplitude((length,), cell) for cell in cells]
errors = [float(np.sqrt(np.mean((bar - exact) ** 2)) / tip) for bar in bars]
order = float(np.polyfit(np.log(cells), np.log(errors), 1)[0])

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2))
left.plot(times, exact * 1e3, color=BLACK, label="exact")
for (name, wave), marker, colour in zip(waves.items(), "o+x", (BLUE, ORANGE, GREEN), strict=True):
    left.plot(times, wave * 1e3, marker, color=colour, ms=5, fillstyle="none", label=f"{name}, cells of 0.5 m")
left.set(xlabel="time [s]", ylabel="amplitude of the velocity [mm/s]")
left.legend(fontsize=8)
right.loglog(cells, errors, "o-", color=BLUE, label=f"1D, order {order:.1f}")
right.set_xticks(cells, [f"{cell:g}" for cell in cells])
right.set_yticks([0.01, 0.02, 0.04], ["1 %", "2 %", "4 %"])
right.minorticks_off()
right.set(xlabel="cell [m]", ylabel="rms error, share of first amplitude")
right.legend()
plt.show()
print(f"2D and 3D differ from 1D by {dimensions_differ:.1e} of the amplitude; errors {np.round(errors, 4)}")

# %% [markdown]
# ## Your own shape functions
#
# A kernel says how much of a particle a node sees, along one axis, at $r = (x - x_{\mathrm{node}})/h$ cells from the
# node: value and derivative. A particle touches three nodes along an axis, so the function may reach 1.5 cells and
# those of neighbouring nodes have to add up to 1; `mpm.scene` checks both. Transfers on CPU and GPU, batches and
# derivatives then work as for the kernels of the package, without its compiled transfers.
#
# GIMP averages the hat function of a node over a box, the particle. Here the particle is densest in its middle: its
# density is itself a hat, one cell wide. The average is a cubic spline, smoother than GIMP's parabolas:
#
# $$N(r) = \tfrac23\left[(\tfrac32 - |r|)_+^3 - 2\,(1 - |r|)_+^3 - (\tfrac12 - |r|)_+^3\right].$$


# %%
@dataclass(frozen=True)
class SoftGrain:
    """A hat averaged over a particle whose density is a hat, one cell wide."""

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> "SoftGrain":
        return cls()

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        far, mid, near = (jnp.maximum(reach - jnp.abs(r), 0) for reach in (1.5, 1.0, 0.5))
        value = 2 / 3 * (far**3 - 2 * mid**3 - near**3)
        return value, -2 * jnp.sign(r) * (far**2 - 2 * mid**2 - near**2) / cell

    def deviation(self, cell: float) -> float:
        return cell * np.sqrt(5 / 12)  # variances of both hats, 1/6 and 1/24, to the grid and back


kernels: dict[str, type[mpm.Kernel]] = {
    "GIMP": mpm.GIMP,
    "your own": SoftGrain,
    "quadratic B-splines": mpm.QuadraticBSpline,
}
by_kernel = {name: amplitude((length,), 0.5, kernel) for name, kernel in kernels.items()}
kernel_errors = {name: float(np.sqrt(np.mean((wave - exact) ** 2)) / tip) for name, wave in by_kernel.items()}

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2))
r = jnp.linspace(-1.75, 1.75, 281)
for (name, kernel), colour in zip(kernels.items(), (BLUE, GREEN, ORANGE), strict=True):
    left.plot(r, kernel.of_spacing((0.25,)).shape(0, 0.5, r)[0], color=colour, label=name)
    right.plot(times, (by_kernel[name] - exact) * 1e3, color=colour, label=name)
left.set(xlabel="cells from the node", ylabel="weight")
left.legend(fontsize=8)
right.set(xlabel="time [s]", ylabel="error of the amplitude [mm/s]")
plt.show()
print("rms error, share of first amplitude:", {name: round(error, 4) for name, error in kernel_errors.items()})

# %% [markdown]
# The wider the function, the larger the error on this wave, in which no particle leaves its cell. What a smooth
# function is good for, particles that cross from cell to cell without a jump in force, is not asked for here.

# %% [markdown]
# ## A slump, in 2D and 3D
#
# A block of mud is let go on a rough base. Slow mud stops when the stress at its base has sunk to the strength, $\rho
# g\,h\,|h'| = S$, so that the final surface is a parabola (Roussel and Coussot 2005,
# [doi:10.1122/1.2041710](https://doi.org/10.1122/1.2041710)),
#
# $$h(r) = \sqrt{\frac{2S}{\rho g}\,(R - r)},\qquad
# R = \left(\frac{3A}{2}\sqrt{\frac{\rho g}{2S}}\right)^{2/3}\ \text{in plane strain},\qquad
# R = \left(\frac{15V}{8\pi}\sqrt{\frac{\rho g}{2S}}\right)^{2/5}\ \text{for a round heap},$$
#
# with $A$ the area of half the section and $V$ the volume. Planes of symmetry are smooth walls, so half a section and
# a quarter of the heap suffice. `fbar` averages the volumetric strain over neighbours, since flow at constant volume
# locks otherwise; a little PIC (`flip = 0.99`) calms the noise.

# %%
g, edge = 10.0, 4.0  # m/s2; half width, radius and height of the body (m)
root = np.sqrt(2 * float(mud.strength) / (density * g))


def slumped(
    domain: tuple[float, ...], inside: Callable[[np.ndarray], np.ndarray], cell: float
) -> tuple[mpm.Scene, mpm.Result]:
    """The mud let go, at rest again."""
    scene, state = scene_of(mud, domain, inside, cell=cell, gravity=g, base="fixed")
    scene = replace(scene, numerics=replace(scene.numerics, fbar=True, flip=number(0.99)))
    settle = mpm.Settle(speed=0.02, drift=0.05, hold=2.0)
    return scene, mpm.solve(scene, state, t_end=20.0, rules=[settle]).raise_if_failed()


flat, flat_run = slumped((20.0, 5.0), lambda x: (x[0] < edge) & (x[1] < edge), 0.5 if SMALL else 0.25)
round_, round_run = slumped(
    (13.0, 13.0, 5.0), lambda x: (x[0] ** 2 + x[1] ** 2 < edge**2) & (x[2] < edge), 1.0 if SMALL else 0.5
)
flat_reach = (1.5 * float(flat.particles.volume.sum()) / root) ** (2 / 3)
round_reach = (15 / (8 * np.pi) * 4 * float(round_.particles.volume.sum()) / root) ** (2 / 5)

fig, axes = plt.subplots(2, 1, figsize=(9, 5.5), sharex=True)
fronts = []
for ax, scene, run, reach, name in (
    (axes[0], flat, flat_run, flat_reach, "plane strain"),
    (axes[1], round_, round_run, round_reach, "round heap"),
):
    now = np.asarray(mpm.diagnostics.position(scene, run.state))
    r = now[0] if len(now) == 2 else np.hypot(now[0], now[1])
    displacement = np.asarray(mpm.diagnostics.displacement(run.state))
    half_size = (scene.grid.cell / 4,) * 2
    boxes = draw_section(ax, (r, now[-1]), half_size, displacement, title=f"{name}, {r.size} particles, {len(now)}D")
    fig.colorbar(boxes, ax=ax, label="displacement [m]")
    along = np.linspace(0, reach, 200)
    ax.plot(along, root * np.sqrt(reach - along), color=RED, lw=2, label="closed form of the final surface")
    before = [(0, edge), (edge, edge), (edge, 0)]
    ax.plot(*np.array(before).T, color=BLACK, ls="--", label="before")
    ax.set(ylabel="z [m]", xlim=(0, 16), ylim=(0, 4.5))
    ax.legend(fontsize=8)
    fronts.append(float((np.quantile(r, 0.995) + half_size[0]) / reach))
axes[0].set_xlabel("")
axes[1].set_xlabel("x in plane strain, distance from the axis of the heap [m]")
plt.show()
print(f"front over that of the closed form: {fronts[0]:.2f} in plane strain, {fronts[1]:.2f} for the heap")

# %% [markdown]
# The closed form knows neither inertia, which thins the middle of a heap that comes down fast, nor cells: the last
# metre before the front is thinner than one, and the computed front stops a little short.

# %% [markdown]
# ## Your own estimator, in a campaign
#
# An estimator says which samples run on the refined grid, and what it makes of the answers. It is a frozen dataclass,
# whose fields are its settings, with the methods of `cooperative.Estimator`: what it screens, what it wants to run
# next, its estimate, and what every run stands for. All are functions of what is known by then, so a campaign can be
# killed and goes on. `cooperative.estimate.SceneSamples` screens the scene's own samples, and leaves the rest to write.
#
# This one is systematic sampling (Cochran 1977, *Sampling Techniques*, Chapter 8): every `step`-th sample of the
# ranking from the rough grid runs refined, so that refined runs are spread over all ranks.


# %%
@dataclass(frozen=True)
class EveryRank(SceneSamples):
    """Every `step`-th rank runs refined and stands for `step` samples."""

    step: int
    name: ClassVar[str] = "every few ranks"

    def check(self, sampling: Sampling) -> None:
        if sampling.samples % self.step:
            raise ValueError(f"samples = {sampling.samples}: give a multiple of step = {self.step}")

    def budget(self, samples: int) -> int:
        return samples // self.step

    def chosen(self, population: Population) -> list[int]:
        order = rank_samples(population.rough_displacement, population.broke_off).order
        return [int(sample) for sample in order[self.step // 2 :: self.step]]

    def next_runs(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        missing = [s for s in self.chosen(population) if s not in answers and s not in under_way]
        return missing[: max(places - len(under_way), 0)]

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        known = [bool(answers[s]) for s in self.chosen(population) if s in answers]
        low, high = wilson_interval(sum(known), max(len(known), 1))
        share = sum(known) / max(len(known), 1)
        cov = np.sqrt((1 - share) / sum(known)) if any(known) else np.inf
        return Estimate(share, (low, high), cov, len(known), self.name)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        return {s: float(self.step) for s in self.chosen(population) if s in answers}

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        return None if self.next_runs(population, answers, 1, ()) else f"every {self.step}. rank has run"


# %% [markdown]
# The scene names no estimator and no budget; the folder remembers whose it is, and refuses to go on with another. The
# samples run in whatever `executor` makes, any `concurrent.futures.Executor` whose workers can import `cooperative`:
# here two threads, elsewhere a pool of processes, or Dask's for a cluster (`cooperative.runs.dask_executor`).

# %%
SCENE = """
name = "a small slope"
[slope]
crest = 8.0
height = 8.0
run_per_rise = 1.0
toe = 16.0
foundation = 2.0
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
softening_modulus = 85e3
residual_ratio = 0.5
tension_cutoff = 0.0
[strength]
mean = 30e3
cov = 0.4
length = [20.0, 4.0]
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 4.0
[campaign]
samples = 12
seed = 3
"""


def two_threads() -> ThreadPoolExecutor:
    """What runs the samples."""
    return ThreadPoolExecutor(2)


with TemporaryDirectory() as folder:
    summary = campaign.run(SCENE, f"{folder}/own", estimator=EveryRank(3), executor=two_threads, workers=2)
pf = summary.probability
low, high = pf.interval
print(f"P_f {pf.value:.2f} ({low:.2f} to {high:.2f}), {pf.estimator}: {summary.cost.finished}")

# %% [markdown]
# ## What to remember
#
# - A law: an `mpm.laws.Law` with `update`, and `initial_history` if it remembers. One code for all dimensions.
# - A kernel: `of_spacing`, `shape` and `deviation`; give its class as `kernel` of a `Discretisation`.
# - A scene: `mpm.scene` of particles, grid, law and numerical choices; start from `mpm.at_rest` or `mpm.unstressed`.
# - An estimator: which samples run refined, and what is made of them; give it to `campaign.run`.
# - A law in a campaign: [09](09_campaign_with_your_own_law.ipynb).
# - Test a law alone first, then against something exact, then let it slide.

# %%
results = {
    "flow_error": flow_error,
    "wave_error": errors[1],
    "wave_order": order,
    "own_kernel_error": kernel_errors["your own"],
    "dimensions_differ": dimensions_differ,
    "front_plane": fronts[0],
    "front_round": fronts[1],
    "own_estimator_runs": summary.cost.refined_runs,
    "own_estimator_probability": summary.probability.value,
}
print(results)
