"""Every pair of features compiles and runs together: a covering set of small scenes, each stepped and checked."""

import random
from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics

CLAY = mpm.Soil(unit_weight=20e3, young=1e7, strength=20e3, tension_cutoff=None)
SOILS = {
    "elastic": replace(CLAY, strength=None),
    "perfectly plastic": CLAY,
    "softening": replace(CLAY, softening_modulus=20e3),
    "exponential softening": replace(CLAY, strain_95=0.5),
    "rate": replace(CLAY, softening_modulus=20e3, rate_coefficient=0.1, viscosity=1e3),
    "cutoff": replace(CLAY, softening_modulus=20e3, tension_cutoff=0.0),
    "mohr-coulomb": mpm.FrictionalSoil(cohesion=5e3, friction=30.0, dilation=5.0, young=1e7),
    "drucker-prager softening": mpm.FrictionalSoil(
        cohesion=5e3,
        friction=30.0,
        softening_strain=0.1,
        law=mpm.laws.DruckerPrager,
        young=1e7,
        tension_cutoff=0.0,
    ),
}
FEATURES = {
    "dimension": (1, 2, 3),
    "scheme": tuple(mpm.Scheme),
    "kernel": (mpm.GIMP, mpm.Linear, mpm.QuadraticBSpline),
    "velocities": ("FLIP", "PIC share", "APIC"),
    "damping": (0.0, 0.5),
    "walls": ("fixed", "roller", "friction"),
    "fbar": (False, True),
    "internal_length": (None, 1.5),
    "soil": tuple(SOILS),
    "body_force": (False, True),
    "dtype": ("float32", "float64"),
    "engine": (mpm.Engine.XLA, None),
    "finite_strain": (False, True),
    "ends": ("walls", "tied"),
}


def allowed(choice):
    """Whether the builders take it: they refuse the rest with a word (tested where they stand)."""
    apic = choice["velocities"] == "APIC" and choice["kernel"] is not mpm.QuadraticBSpline
    frictional = isinstance(SOILS[choice["soil"]], mpm.FrictionalSoil) and choice["fbar"]
    hard = choice["soil"] in ("elastic", "perfectly plastic", "mohr-coulomb") and choice["internal_length"]
    hats = choice["kernel"] is mpm.Linear and choice["scheme"] is mpm.Scheme.USL  # of which a warning says it all
    tied = choice["ends"] == "tied" and (choice["dimension"] == 1 or choice["internal_length"])
    return not (apic or frictional or hard or hats or tied)


def pairs(choice):
    return set(combinations(sorted(choice.items(), key=lambda item: item[0]), 2))


def covering():
    """Choices that hold every allowed pair of features, by greed from a fixed random pool."""
    rng = random.Random(0)
    pool = [{name: rng.choice(values) for name, values in FEATURES.items()} for _ in range(3000)]
    pool = [(choice, pairs(choice)) for choice in pool if allowed(choice)]
    missing = set().union(*(held for _, held in pool))
    chosen = []
    while missing:
        choice, held = max(pool, key=lambda item: len(item[1] & missing))
        chosen.append(choice)
        missing -= held
    return chosen


def built(choice):
    """A block falling onto the floor of its box, at an angle."""
    d = choice["dimension"]
    flip = {"FLIP": 1.0, "PIC share": 0.9, "APIC": 0.0}[choice["velocities"]]
    numerics = mpm.Discretisation(
        1.0,
        (0.5,) * d,
        kernel=choice["kernel"],
        scheme=choice["scheme"],
        flip=flip,
        apic=choice["velocities"] == "APIC",
        damping=choice["damping"],
        fbar=choice["fbar"],
        internal_length=choice["internal_length"],
        finite_strain=choice["finite_strain"],
        dtype=choice["dtype"],
    )
    walls = choice["walls"]
    scene, state = mpm.block(
        (2.0,) * d,
        SOILS[choice["soil"]],
        numerics,
        domain=(5.0,) * d,
        corner=(1.0,) * d,
        velocity=(0.5,) * (d - 1) + (-2.0,),
        gravity=(0.0,) * (d - 1) + (-9.81,),
        walls=walls,
        friction=0.3 if walls == "friction" else 0.0,
        speed=8.0,
    )
    if choice["body_force"]:
        scene = replace(
            scene, loads=replace(scene.loads, body_force=lambda x, t: 0.1 * jnp.sin(3 * t) * jnp.ones_like(x))
        )
    if choice["ends"] == "tied":
        planes = tuple(wall.index for wall in scene.boundary.walls if wall.axis == 0)
        walls = tuple(wall for wall in scene.boundary.walls if wall.axis != 0)
        scene = replace(scene, boundary=replace(scene.boundary, walls=walls, tied=planes))
    return replace(scene, numerics=replace(scene.numerics, engine=choice["engine"])), state


def name(choice):
    return "-".join(getattr(value, "name", getattr(value, "__name__", str(value))) for value in choice.values())


CHOSEN = covering()
FEW = 6  # the first hold most pairs


SPREAD = [pytest.param(c, id=name(c), marks=[] if i < FEW else pytest.mark.slow) for i, c in enumerate(CHOSEN)]


@pytest.mark.parametrize("choice", SPREAD)
def test_features_run_together(choice):
    with jax.enable_x64(choice["dtype"] == "float64"):
        scene, state = built(choice)
        final = jax.jit(mpm.advance)(scene, state, jnp.asarray(120))
        assert mpm.Status(int(final.status)) is mpm.Status.RUNNING
        dtypes = {leaf.dtype for leaf in jax.tree.leaves(final) if jnp.issubdtype(leaf.dtype, jnp.floating)}
        assert dtypes == {jnp.dtype(choice["dtype"])}
        # It has fallen to the floor and not through it, and no energy has come from nowhere.
        assert np.all(np.asarray(diagnostics.position(scene, final)[-1]) > -0.5)
        # The body force pushes by 0.1 m/s2 at most, over less than 5 m.
        stored = diagnostics.kinetic_energy(scene, state) + 0.5 * float(jnp.sum(scene.particles.mass))
        gained = diagnostics.kinetic_energy(scene, final) + diagnostics.potential_energy(scene, final)
        assert float(gained) < float(stored) * 1.02
