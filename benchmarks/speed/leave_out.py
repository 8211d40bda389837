"""What a scene does not need is not there: operations, bytes and time of a step with and without each feature.

Operations and bytes are XLA's own count for the compiled step (with the XLA engine, whose transfers it can see); time
is that of the fastest engine. The scene is the rough published slope, or its section.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.measure import Report, scene_campaign
from cooperative.scene import built
from jaxmpm import Scene, State, laws
from jaxmpm.run import advance_lanes

Variant = Callable[[Scene, State], tuple[Scene, State]]
CFL = 0.5
"""At which every scheme is stable; the cost of a step does not depend on it."""


def numbers(values: dict[str, Any], state: State) -> dict[str, Any]:
    """Floats as arrays of the state's type; the other values as they are."""
    return {name: jnp.asarray(v, state.stress.dtype) if type(v) is float else v for name, v in values.items()}


def with_numerics(**values: Any) -> Variant:
    """The scene with other numerical choices."""
    return lambda scene, state: (
        replace(scene, numerics=replace(scene.numerics, **numbers(values, state))),
        state,
    )


def with_law(gap: bool = True, **values: Any) -> Variant:
    """The material law with other values. gap: whether the state keeps its gap."""

    def changed(scene: Scene, state: State) -> tuple[Scene, State]:
        material = replace(scene.material, **numbers(values, state))
        return replace(scene, material=material), state if gap else replace(state, gap=None)

    return changed


def with_rate(scene: Scene, state: State) -> tuple[Scene, State]:
    """Strength that rises with the rate of shear."""
    return with_law(rate=laws.RateEffect(**numbers({"coefficient": 0.1, "reference_rate": 3e-6}, state)))(scene, state)


def with_exponential_softening(scene: Scene, state: State) -> tuple[Scene, State]:
    """Softening that ends by and by, as that of sensitive clay, for the linear one."""
    softening = laws.ExponentialSoftening(
        scene.material.softening.residual_ratio, jnp.asarray(10.0, state.stress.dtype)
    )
    return with_law(softening=softening)(scene, state)


def without_softening(scene: Scene, state: State) -> tuple[Scene, State]:
    """Peak strength for ever: no history array."""
    return replace(scene, material=replace(scene.material, softening=None)), replace(state, history=None)


def without_yielding(scene: Scene, state: State) -> tuple[Scene, State]:
    """Elastic: no return mapping, no history."""
    material = laws.Elastic(scene.material.bulk, scene.material.shear)
    return replace(scene, material=material), replace(state, history=None, gap=None)


def with_uneven_softening(scene: Scene, state: State) -> tuple[Scene, State]:
    """Modulus and residual of the softening that differ from particle to particle, as random fields make them."""
    law = scene.material.softening
    uneven = 1 + 0.3 * jnp.sin(jnp.arange(scene.particles.mass.size, dtype=state.stress.dtype))
    values = {"softening_modulus": law.modulus * uneven, "residual_ratio": law.residual_ratio * uneven}
    return mpm.with_soil(scene, state, **values)


def with_averaged_plastic_strain(scene: Scene, state: State) -> tuple[Scene, State]:
    """Plastic strain averaged over neighbours, through one filter."""
    scene = replace(scene, numerics=replace(scene.numerics, nonlocal_passes=1))
    return scene, replace(state, unaveraged=jnp.zeros_like(state.history))


def with_table(scene: Scene, state: State) -> tuple[Scene, State]:
    """A water table of two points at half the height."""
    x, z = scene.particles.position[0], scene.particles.position[-1]
    dtype = x.dtype
    level = jnp.asarray([jnp.max(z) / 2, jnp.max(z) / 4], dtype)
    table = laws.WaterTable(jnp.asarray([0, jnp.max(x)], dtype), level, jnp.asarray(9810, dtype), jnp.asarray(1, dtype))
    return replace(scene, loads=replace(scene.loads, water=table)), state


def with_pore_pressure(scene: Scene, state: State) -> tuple[Scene, State]:
    """A pressure that rises with the height, constant on each particle."""
    return replace(scene, loads=replace(scene.loads, pore_pressure=1e3 * scene.particles.position[-1])), state


def with_motion(scene: Scene, state: State) -> tuple[Scene, State]:
    """A record of the base's acceleration, of a thousand samples."""
    dtype = state.stress.dtype
    samples = 0.1 * jnp.sin(jnp.arange(1000, dtype=dtype))
    motion = mpm.BaseMotion(jnp.tile(samples, (scene.grid.dimension, 1)), jnp.asarray(0.01, dtype))
    return replace(scene, loads=replace(scene.loads, motion=motion)), state


def with_wall_friction(scene: Scene, state: State) -> tuple[Scene, State]:
    """Walls along which soil slides with friction, for those that hold it."""
    walls = tuple(replace(wall, hold="friction") for wall in scene.boundary.walls)
    boundary = replace(scene.boundary, walls=walls, friction=jnp.asarray(0.5, state.stress.dtype))
    return replace(scene, boundary=boundary), state


def with_cut(scene: Scene, state: State) -> tuple[Scene, State]:
    """Nothing moves at every tenth node."""
    cut = jnp.arange(scene.grid.nodes) % 10 == 0
    return replace(scene, boundary=replace(scene.boundary, cut=cut)), state


def with_uneven_stiffness(scene: Scene, state: State) -> tuple[Scene, State]:
    """Moduli that differ from particle to particle, none above the scene's."""
    uneven = 1 - 0.3 * jnp.sin(jnp.arange(scene.particles.mass.size, dtype=state.stress.dtype)) ** 2
    law = scene.material
    return replace(scene, material=replace(law, bulk=law.bulk * uneven, shear=law.shear * uneven)), state


def with_looks(scene: Scene, state: State) -> tuple[Scene, State]:
    """Largest thickness, speed and arrival per column of cells, looked at every 20 steps, as hazard maps ask for."""
    return scene, mpm.with_columns(scene, state)


def on_a_cone(scene: Scene, state: State) -> tuple[Scene, State]:
    """Drucker-Prager with 25 degrees of friction, the clay's strength its cohesion."""
    law, friction = scene.material, jnp.radians(jnp.asarray(25.0, state.stress.dtype))
    material = laws.DruckerPrager(
        bulk=law.bulk,
        shear=law.shear,
        cohesion=law.strength,
        friction=friction,
        dilation=jnp.zeros_like(friction),
        tension_cutoff=law.tension_cutoff,
    )
    return replace(scene, material=material), replace(state, history=None)


def on_a_soft_cone(scene: Scene, state: State) -> tuple[Scene, State]:
    """The same, its cohesion lost and its friction falling to 15 degrees."""
    history, dtype = state.history, state.stress.dtype
    scene, state = on_a_cone(scene, state)
    cohesion, friction, strain = (jnp.asarray(value, dtype) for value in (0.0, np.radians(15.0), 0.2))
    softening = laws.FrictionalSoftening(cohesion, friction, strain)
    return replace(scene, material=replace(scene.material, softening=softening)), replace(state, history=history)


def on_a_pyramid(scene: Scene, state: State) -> tuple[Scene, State]:
    """The cone's soil with Mohr-Coulomb."""
    scene, state = on_a_cone(scene, state)
    cone = scene.material
    values = {field.name: getattr(cone, field.name) for field in fields(laws.MohrCoulomb) if hasattr(cone, field.name)}
    material = laws.MohrCoulomb(**values)
    return replace(scene, material=material), state


def in_zones(below: Variant, above: Variant) -> Variant:
    """The law of one variant in the lower half of the particles, that of another in the upper one."""

    def of_both(scene: Scene, state: State) -> tuple[Scene, State]:
        height = np.asarray(scene.particles.position[-1])
        upper = height > np.median(height)
        order, count = np.argsort(upper, kind="stable"), int(np.sum(~upper))

        def cut(tree: Any, chosen: np.ndarray) -> Any:
            return jax.tree.map(lambda leaf: leaf[..., chosen] if leaf.shape[-1:] == height.shape else leaf, tree)

        (low, old), (high, _) = (variant(scene, state) for variant in (below, above))
        halves = cut(low.material, order[:count]), cut(high.material, order[count:])
        law = laws.Zoned(halves, (count, height.size - count))
        return replace(scene, particles=cut(scene.particles, order), material=law), cut(old, order)

    return of_both


def stretched(variant: Variant) -> Variant:
    """A variant with finite strains."""
    return lambda scene, state: with_numerics(finite_strain=True)(*variant(scene, state))


def unchanged(scene: Scene, state: State) -> tuple[Scene, State]:
    """The scene as it is."""
    return scene, state


# feature -> (with it, without it)
FEATURES: dict[str, tuple[Variant, Variant]] = {
    "softening": (unchanged, without_softening),
    "yielding": (without_softening, without_yielding),
    "friction (Drucker-Prager)": (on_a_cone, without_softening),
    "edges (Mohr-Coulomb)": (on_a_pyramid, on_a_cone),
    "softening with friction": (on_a_soft_cone, on_a_cone),
    "layers of two kinds (clay, Drucker-Prager)": (in_zones(unchanged, on_a_cone), unchanged),
    "layers of two kinds (clay, Mohr-Coulomb)": (in_zones(unchanged, on_a_pyramid), on_a_pyramid),
    "exponential softening": (with_exponential_softening, unchanged),
    "effect of rate": (with_rate, unchanged),
    "tension cutoff": (unchanged, with_law(tension_cutoff=None, gap=False)),
    "memory of the gap": (unchanged, with_law(gap_memory=False, gap=False)),
    "strength per particle": (
        unchanged,
        lambda scene, state: with_law(strength=scene.material.strength[0])(scene, state),
    ),
    "softening per particle": (with_uneven_softening, unchanged),
    "stiffness per particle": (with_uneven_stiffness, unchanged),
    "second mapping (MUSL)": (unchanged, with_numerics(scheme=mpm.Scheme.USL)),
    "damping": (with_numerics(damping=0.1), unchanged),
    "PIC blend": (with_numerics(flip=0.95), unchanged),
    "F-bar": (with_numerics(fbar=True), unchanged),
    "volumetric strain averaged over cells": (with_numerics(cell_average=True), unchanged),
    "finite strains (Hencky)": (with_numerics(finite_strain=True), unchanged),
    "finite strains, elastic": (stretched(without_yielding), without_yielding),
    "finite strains, friction (Mohr-Coulomb)": (stretched(on_a_pyramid), on_a_pyramid),
    "averaged plastic strain": (with_averaged_plastic_strain, unchanged),
    "water table": (with_table, unchanged),
    "pore pressure of particles (r_u)": (
        with_pore_pressure,
        unchanged,
    ),
    "cut of any shape": (with_cut, unchanged),
    "motion of the base": (with_motion, unchanged),
    "walls with friction": (with_wall_friction, unchanged),
    "largest per column (hazard maps)": (with_looks, unchanged),
}


def cost(scene: Scene, state: State) -> tuple[float, float]:
    """Operations and bytes accessed of one compiled step, as XLA counts them, and of a look at the columns if any."""

    def once(scene: Scene, state: State) -> tuple[State, Any]:
        columns = state.columns
        return mpm.step(scene, state, scene.numerics.time_step), columns and mpm.run.passing(
            scene, state, columns.moved
        )

    on_xla = replace(scene, numerics=replace(scene.numerics, engine=mpm.Engine.XLA))
    compiled = jax.jit(once).lower(on_xla, state).compile()
    analysis: Any = compiled.cost_analysis()
    counted = analysis[0] if isinstance(analysis, list) else analysis
    return float(counted["flops"]), float(counted["bytes accessed"])


def turns(variants: list[tuple[Scene, State]], repeats: int) -> list[list[float]]:
    """Microseconds per step of every variant in each turn, one after the other so that a noisy moment hits all alike.

    Each turn takes as many steps from the start as make about a tenth of a second.
    """
    steps = max(30, 2_000_000 // variants[0][0].particles.mass.size)
    spent: list[list[float]] = []
    for _ in range(repeats + 1):
        spent.append([])
        for scene, state in variants:
            start = jax.block_until_ready(jax.tree.map(jnp.copy, state))
            clock = time.perf_counter()
            end = jax.block_until_ready(advance_lanes(scene, start, jnp.asarray(steps), None))
            spent[-1].append((time.perf_counter() - clock) / steps * 1e6)
            if int(end.step) != int(state.step) + steps:
                raise RuntimeError(
                    f"{mpm.Status(int(end.status)).name} after {int(end.step)} of {steps} steps: not timed"
                )
    # The first turn compiles.
    return spent[1:]


def microseconds(variants: list[tuple[Scene, State]], repeats: int) -> list[float]:
    """Microseconds per step of each variant: the median over `turns`."""
    return [statistics.median(values) for values in zip(*turns(variants, repeats), strict=True)]


def ends_of_a_section(
    ends: Literal["tied", "free field"],
) -> tuple[tuple[Scene, State], tuple[Scene, State]]:
    """The published section on the rough grid that ends so, and between its walls; tied, level ground as high."""
    campaign = scene_campaign("paper_section")
    slope: Any = campaign.site.shape
    top, low, end = slope.foundation + slope.height, slope.foundation, slope.extent[0]
    line = [(0, top), (end, top)] if ends == "tied" else [(0, top), (slope.crest, top), (slope.toe_x, low), (end, low)]
    with_it, walled = (
        mpm.section(mpm.Section(line), campaign.soil, replace(campaign.grids["rough"], cfl=CFL), ends=end_condition)
        for end_condition in (ends, "roller")
    )
    return with_it, walled


def rows_of(name: str, repeats: int) -> list[dict[str, Any]]:
    """A row per feature for one scene of benchmarks/scenes on its rough grid."""
    campaign = scene_campaign(name)
    scene, state = built(campaign, "rough")
    uneven = scene.material.strength * (1 + 0.3 * jnp.sin(jnp.arange(scene.particles.mass.size)))
    scene = replace(scene, material=replace(scene.material, strength=uneven))
    dt = scene.numerics.time_step * CFL / campaign.grids["rough"].cfl
    scene = replace(scene, numerics=replace(scene.numerics, time_step=dt))
    pairs = {feature: tuple(make(scene, state) for make in both) for feature, both in FEATURES.items()}
    if scene.grid.dimension == 2:
        pairs["tied ends"] = ends_of_a_section("tied")
        pairs["ends without walls (free field)"] = ends_of_a_section("free field")
    return [row(name, feature, pair, repeats) for feature, pair in pairs.items()]


def row(name: str, feature: str, pair: Sequence[tuple[Scene, State]], repeats: int) -> dict[str, Any]:
    """A scene with a feature beside the same without it."""
    (flops, size), (flops_without, size_without) = (cost(*variant) for variant in pair)
    us, us_without = microseconds([*pair], repeats)
    return {
        "scene": name,
        "feature": feature,
        "flops": flops,
        "flops_without": flops_without,
        "bytes": size,
        "bytes_without": size_without,
        "us_per_step": round(us, 1),
        "us_per_step_without": round(us_without, 1),
    }


def run(quick: bool) -> Report:
    """Every feature, in the section and in 3D."""
    rows = [one for name in (["paper_section"] if quick else ["paper_section", "paper"]) for one in rows_of(name, 7)]
    saved = {
        f"{one['scene']}, {one['feature']}": round(1 - one["us_per_step_without"] / one["us_per_step"], 3)
        for one in rows
    }
    return Report({"share_of_step_saved_without": saved}, rows)
