"""Locking and its cures: Cook's membrane, elastic, beside finite elements of order 4, and a notched strip of clay.

The membrane, in plane strain, is held along a vertical edge and carries a vertical load on the strip at its other end.
The mean deflection of that strip is twice the elastic energy over the load, by Clapeyron's theorem, so that its error
is that of the energy: it falls in the order 2 lambda of the cell, lambda the exponent of the displacements around the
re-entrant held corner. Sources: Cook (1974), J. Struct. Div. 100(9), 1851-1863 (the panel); Williams (1952),
10.1115/1.4010553 (lambda).

The strip, torn apart between two deep notches, is the case in which Nagtegaal, Parks and Rice (1974),
10.1016/0045-7825(74)90032-2, got no limit load with elements that lock. Sources of its load: Ewing and Hill (1967),
J. Mech. Phys. Solids 15, 115-124; Hill (1950), The Mathematical Theory of Plasticity, chapter IX (round roots).
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skfem
from scipy.optimize import brentq
from scipy.sparse.linalg import splu
from skfem.helpers import ddot, div, sym_grad

import jaxmpm as mpm
from jaxmpm import tensors
from jaxmpm.diagnostics import unbalanced_force
from jaxmpm.grid import Wall
from jaxmpm.setup._initial_stress import elastic_equilibrium
from tests.verification import order

LENGTH, HELD, RISE, END_RISE = 48.0, 44.0, 44.0, 16.0  # the panel, m: from 44 m high to 16 m
STRIP = 8.0  # of the load, m
DOMAIN_HEIGHT = 64.0  # of whole cells, m
YOUNG, FORCE = 1e7, 1e3  # Pa, N/m: deflections of 1e-3 m, so that the geometry stays as it is
SOIL = mpm.Soil(young=YOUNG)
CELLS = [8.0, 4.0, 2.0, 1.0]
CURES = {"none": {}, "F-bar": {"fbar": True}, "average over cells": {"cell_average": True}}
CURED = [cure for cure in CURES if cure != "none"]


def lower(x):
    return RISE / LENGTH * x


def upper(x):
    return HELD + END_RISE / LENGTH * x


AREA = STRIP * (upper(LENGTH - STRIP / 2) - lower(LENGTH - STRIP / 2))


def pushed(x, t):
    """Acceleration (m/s2) of what stands at x: of the strip, upwards."""
    upwards = FORCE / (AREA * SOIL.unit_weight / 9.81)
    return jnp.stack([jnp.zeros_like(x[0]), jnp.where(x[0] > LENGTH - STRIP, upwards, 0.0)])


def share_inside(position, spacing):
    """Share of the boxes around the points (2, N) that lies between the two slanted edges."""
    x = position[0] + spacing * ((np.arange(64) + 0.5) / 64 - 0.5)[:, None]
    z = position[1]
    inside = np.minimum(upper(x), z + spacing / 2) - np.maximum(lower(x), z - spacing / 2)
    return np.maximum(inside, 0).mean(axis=0) / spacing


def membrane(cell, poisson, cure):
    """The panel of four particles a cell, those on an edge with the mass and volume of what lies inside."""
    spacing = cell / 2
    scene, state = mpm.block(
        (LENGTH, DOMAIN_HEIGHT),
        replace(SOIL, poisson=poisson),
        mpm.Discretisation(cell, (spacing,) * 2, **CURES[cure]),
        domain=(LENGTH, DOMAIN_HEIGHT),
        corner=(0.0, 0.0),
        speed=1.0,
    )
    share = share_inside(np.asarray(scene.particles.position), spacing)
    inside = np.flatnonzero(share)
    particles, state = jax.tree.map(lambda leaf: leaf[..., inside] if leaf.ndim else leaf, (scene.particles, state))
    particles = replace(particles, mass=particles.mass * share[inside], volume=particles.volume * share[inside])
    boundary = replace(scene.boundary, walls=(Wall(0, "low", 1, "fixed"),))
    return replace(scene, particles=particles, boundary=boundary, loads=replace(scene.loads, body_force=pushed)), state


def deflection(scene, state):
    """Mean deflection (m) of the loaded strip: twice the energy of the stress in balance, over the load."""
    stress, residual, _ = elastic_equilibrium(scene, state.stress, tolerance=1e-7, iterations=20000)
    assert float(residual) < 1e-6
    full = tensors.expand(stress, 2)
    shearing = tensors.second_invariant(tensors.deviator(full)) / scene.material.shear
    twice_energy = jnp.sum(scene.particles.volume * (shearing + tensors.mean(full) ** 2 / scene.material.bulk))
    return float(twice_energy) / FORCE


@cache
def reference(poisson):
    """The same by triangles of order 4, which do not lock, with small ones at the re-entrant corner."""
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, 1, 13), np.linspace(0, 1, 9))
    x, s = LENGTH * mesh.p[0], mesh.p[1]
    mesh = skfem.MeshTri(np.stack([x, (1 - s) * lower(x) + s * upper(x)]), mesh.t)
    for _ in range(14):
        corner = np.flatnonzero(np.isclose(mesh.p[0], 0) & np.isclose(mesh.p[1], HELD))
        around = np.unique(mesh.t[:, np.isin(mesh.t, corner).any(axis=0)])
        mesh = mesh.refined(np.flatnonzero(np.isin(mesh.t, around).any(axis=0)))
    bulk, shear = YOUNG / (3 * (1 - 2 * poisson)), YOUNG / (2 * (1 + poisson))
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP4()), intorder=8)

    @skfem.BilinearForm
    def stiffness(u, v, _):
        return 2 * shear * ddot(sym_grad(u), sym_grad(v)) + (bulk - 2 * shear / 3) * div(u) * div(v)

    @skfem.LinearForm
    def load(v, w):
        return np.where(w.x[0] > LENGTH - STRIP, FORCE / AREA, 0.0) * v[1]

    free = basis.complement_dofs(basis.get_dofs(lambda x: np.isclose(x[0], 0)))
    matrix, force = stiffness.assemble(basis)[free][:, free].tocsc(), load.assemble(basis)[free]
    solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
    return force @ solve(force) / FORCE


def singular_order(poisson):
    """2 lambda of the corner between the held edge and the upper one (Williams 1952, held and free edges)."""
    angle, kappa = np.pi / 2 + np.arctan(END_RISE / LENGTH), 3 - 4 * poisson

    def characteristic(a):
        return np.sin(a * angle) ** 2 - ((kappa + 1) ** 2 - 4 * (a * np.sin(angle)) ** 2) / (4 * kappa)

    return 2 * brentq(characteristic, 0.3, 0.9)


def error(cell, poisson, cure):
    """Relative error of the deflection."""
    return deflection(*membrane(cell, poisson, cure)) / reference(poisson) - 1


@pytest.mark.parametrize("poisson", [pytest.param(0.3, marks=pytest.mark.slow), 0.499])
@pytest.mark.parametrize("cure", [pytest.param("F-bar", marks=pytest.mark.slow), "average over cells"])
def test_cured_panels_converge_as_fast_as_the_corner_lets_any_method(x64, poisson, cure):
    errors = np.abs([error(cell, poisson, cure) for cell in CELLS])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > singular_order(poisson))


def test_error_with_a_cure_hardly_grows_with_the_bulk_modulus_and_without_it_does(x64):
    # From 0.49 to 0.4999 the bulk modulus grows a hundredfold, the reference by 1 per cent.
    errors = {cure: np.abs([error(2.0, poisson, cure) for poisson in (0.49, 0.4999)]) for cure in CURES}
    assert errors["none"][1] > 5 * errors["none"][0]
    assert all(errors[cure][1] < 2 * errors[cure][0] for cure in CURED)


@pytest.mark.slow
def test_without_a_cure_the_panel_locks_near_incompressibility_only(x64):
    cells = CELLS[:3]
    compressible, locked = (-np.array([error(cell, poisson, "none") for cell in cells]) for poisson in (0.3, 0.499))
    assert order(cells, compressible) > singular_order(0.3)
    assert order(cells, locked) < singular_order(0.499)
    for cure in CURED:
        assert np.all(locked > 4 * np.abs([error(cell, 0.499, cure) for cell in cells]))


@pytest.mark.parametrize("cure", CURES)
def test_damped_steps_end_at_the_same_deflection(x64, cure):
    scene, state = membrane(4.0, 0.499, cure)
    direct = deflection(scene, state)
    # Near the critical rate of the first mode, of some 8 s.
    result = mpm.solve(
        replace(scene, numerics=replace(scene.numerics, damping=jnp.asarray(1.6))), state, t_end=20.0
    ).raise_if_failed()
    weight = scene.particles.mass * (scene.particles.position[0] > LENGTH - STRIP)
    stepped = float(jnp.sum(weight * result.state.displacement[1]) / jnp.sum(weight))
    assert abs(stepped / direct - 1) < 1e-4


@pytest.mark.parametrize("poisson", [pytest.param(0.3, marks=pytest.mark.slow), 0.49])
@pytest.mark.parametrize("cure", CURED)
def test_slope_with_a_cure_starts_in_balance(x64, poisson, cure):
    soil = mpm.Soil(poisson=poisson)
    scene, state = mpm.slope(mpm.Slope(), soil, mpm.Discretisation(1.0, (0.5, 0.5), **CURES[cure]))
    after = mpm.step(scene, state, scene.numerics.time_step)
    acceleration = jnp.linalg.norm(after.velocity, axis=0) / scene.numerics.time_step
    assert float(jnp.max(acceleration)) < 1e-3 * 9.81
    assert float(unbalanced_force(scene, state)) < 1e-4
    assert float(mpm.diagnostics.unbalanced_force(scene, state)) < 1e-4


LIGAMENT, WIDTH, ARM, GRIP = 1.0, 9.0, 2.0, 0.5  # half of the ligament and of the strip, length either side, m
STRENGTH, PULL = 10e3, 0.016  # Pa, m/s
CAPACITY = 2 + np.pi


@cache
def notched_loads(cell, poisson, cure):
    """Load over strength and half ligament in ten parts of a pull: the strip is torn by a grip of great mass.

    Half of it, beside a plane of symmetry. The notch is a slot one cell high, its sides on faces of cells.
    """
    soil = mpm.Soil(young=5000 * STRENGTH, poisson=poisson, strength=STRENGTH, tension_cutoff=None)
    top = 2 * ARM + cell
    with jax.enable_x64(True):
        scene, state = mpm.block(
            (WIDTH, top + GRIP),
            soil,
            mpm.Discretisation(cell, (cell / 2,) * 2, **CURES[cure]),
            domain=(WIDTH + cell, top + 2 * GRIP),
            corner=(0.0, 0.0),
            speed=1.0,
        )
        x, z = np.asarray(scene.particles.position)
        inside = np.flatnonzero((x < LIGAMENT) | (np.abs(z - top / 2) > cell / 2))
        particles, state = jax.tree.map(lambda leaf: leaf[..., inside] if leaf.ndim else leaf, (scene.particles, state))
        z = particles.position[1]
        grip = z > top
        scene = replace(
            scene,
            particles=replace(particles, mass=jnp.where(grip, 1e4, 1.0) * particles.mass),
            material=replace(scene.material, strength=jnp.where(grip, 1e3, 1.0) * STRENGTH),
            boundary=replace(scene.boundary, walls=(Wall(0, "low", 1, "roller"), Wall(1, "low", 1, "fixed"))),
        )
        state = replace(state, velocity=state.velocity.at[1].set(PULL * jnp.minimum(z / top, 1.0)))
        times = np.linspace(0.0, 0.96, 11)
        run = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed()
        momentum = [float(jnp.sum(scene.particles.mass * grip * s.velocity[1])) for s in run.snapshots]
        elapsed = np.diff([int(s.step) for s in run.snapshots]) * float(scene.numerics.time_step)
        return -np.diff(momentum) / elapsed / (STRENGTH * LIGAMENT)


def round_root_loss(radius):
    """What a round root takes off the load, over the strength: stress is 2 c (1 + log(1 + distance / radius)) there."""
    return 2 * radius * (np.exp(np.pi / 2) - 1 - np.pi / 2)


@pytest.mark.parametrize("poisson", [0.3, 0.49])
@pytest.mark.parametrize("cell", [0.5, *(pytest.param(cell, marks=pytest.mark.slow) for cell in (0.25, 0.125))])
@pytest.mark.parametrize("cure", CURED)
def test_notched_strip_has_its_limit_load_with_a_cure_and_none_without(cell, poisson, cure):
    # Between sharp notches as deep as these (ligament below 0.116 of the width) the load is (2 + pi) c, by Prandtl's
    # field. A slot bears no more, nor less than a notch around it: that with the round root through the slot's corners.
    radius = cell / np.sqrt(2)
    deeper = radius - cell / 2
    least = CAPACITY * (1 - deeper / LIGAMENT) - round_root_loss(radius)
    cured, plain = (notched_loads(cell, poisson, each) for each in (cure, "none"))
    assert least < cured.max() < CAPACITY
    assert abs(cured[-1] / cured[-4] - 1) < 0.02
    assert plain[-1] > CAPACITY
    assert plain[-1] / plain[-4] - 1 > 0.03
