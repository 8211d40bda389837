"""Initial stress: the equilibrium of elastic loading by gravity.

Damped elastic loading with small strains converges to one linear problem on the grid, K u = f(stress_0) + load. It is
solved directly, by conjugate gradients without a matrix, at the particles' initial positions. The stress then balances
gravity exactly there, so that velocities and displacements start from zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm import tensors
from jaxmpm.boundary import hold
from jaxmpm.equations import MASS_FLOOR, Maps, acting_stress, closed, external_force, gaps, sheared
from jaxmpm.laws import elastic_increment
from jaxmpm.setup._contact import borne_by_contact
from jaxmpm.setup._law import force_of_water, wave_speed
from jaxmpm.setup._scene import unstressed, with_stress
from jaxmpm.soil import elastic_ratio
from jaxmpm.support import check
from jaxmpm.support.tracing import array, at_once, host, on_host, require_known
from jaxmpm.transfer import near_soil, of_all, of_stored
from jaxmpm.types import Scene, State, Status

TOLERANCE = {"float32": 1e-5, "float64": 1e-10}
"""Of the conjugate gradients, as a share of the load, by precision."""


@partial(jax.jit, static_argnames=("iterations", "gapped"))
def elastic_equilibrium(
    scene: Scene,
    stress: Array,
    *,
    tolerance: float | None = None,
    iterations: int = 2000,
    gapped: bool = False,
    loose: Array | None = None,
    bedding: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Stress in balance with the load, reached elastically from another stress.

    The load is that of gravity, water and body force at time 0. The result depends on the elastic moduli (`bulk`,
    `shear` of the material), never on strength. The nodal mass is the preconditioner. Strain and mean stress are
    averaged as in a step; otherwise the first forces of a run would be out of balance. Derivatives are those of the
    equations: a forward or reverse pass solves once more, with the same tolerance of its own right-hand side.

    Args:
        scene: to load.
        stress: (s, N) Pa to start from.
        tolerance: of the conjugate gradients, as a share of the load; None for that of the precision.
        iterations: their largest number.
        gapped: whether soil lies above nodes of rigid ground by a share of a cell, which the forces close. The problem
            is then not symmetric.
        loose: (nodes,) bool, further nodes that do not move; None for none.
        bedding: stiffness of springs that hold each node in place, over its mass (1/s2). With it the problem has a
            solution whatever holds the soil. None for none.

    Returns:
        Stress (s, N) Pa; the residual, norm of the net force over that of the load, on free nodes; and the net force of
        each node over its load (nodes,).
    """
    grid, particles = scene.grid, scene.particles
    scene = near_soil(_sticking(scene), particles.position)
    d, loose = grid.dimension, None if loose is None else of_stored(scene.grid, loose)
    maps = Maps(scene, particles.position)
    mass = maps.to_grid(particles.mass[None], None)
    carries = mass > MASS_FLOOR * jnp.mean(particles.mass)
    gap, undrained, shears = gaps(scene, mass[:, 0]) if gapped else None, None, sheared(scene)
    if gapped and not isinstance(shears, bool):
        weighed = maps.to_grid((particles.mass * shears)[None], None)[:, 0]
        undrained = jnp.where(carries[:, 0], weighed / jnp.where(carries[:, 0], mass[:, 0], 1), 0)

    def free(nodal: Array) -> Array:
        nodal = jnp.where(carries, nodal, 0)
        return hold(scene, nodal if loose is None else jnp.where(loose[:, None], 0, nodal))

    def internal_force(stress: Array) -> Array:
        force = maps.to_grid(None, acting_stress(scene, stress, particles.volume, maps))
        return free(closed(scene, gap, force, undrained, pressing=False))

    def stress_of(nodal_displacement: Array) -> Array:
        entries = tensors.entries(maps.gradient(nodal_displacement))
        strain = maps.unlocked(tensors.strain_increment(entries, jnp.ones((), stress.dtype)), particles.volume)
        return tensors.compress(elastic_increment(scene.material.bulk, scene.material.shear, strain), d)

    load = mass * scene.loads.gravity
    external = external_force(scene, particles.position, jnp.zeros((), stress.dtype))
    if external is not None:
        load = load + maps.to_grid(external, None)
    if scene.loads.pore_pressure is not None:
        load = load + maps.to_grid(None, acting_stress(scene, jnp.zeros_like(stress), particles.volume, maps))
        # The rest is linear in the effective stress.
        scene = replace(scene, loads=replace(scene.loads, pore_pressure=None))
    load = free(load)
    net = load + internal_force(stress)
    norm = jnp.linalg.norm(load)
    method = _bicgstab if gapped else jax.scipy.sparse.linalg.cg
    accuracy = TOLERANCE[stress.dtype.name] if tolerance is None else tolerance
    weight = jax.lax.stop_gradient(jnp.where(carries, mass, 1))

    def extended(force: Array, scale: Array) -> Array:
        return jnp.concatenate([force, jnp.full_like(force[:1], scale)])

    def solve(matrix: Callable[[Array], Array], right: Array) -> Array:
        # The scale is constant, so that it is 0 where a derivative is solved for.
        force, scale = right[:-1], right[-1, 0]
        scale = jnp.where(scale > 0, scale, jnp.linalg.norm(force))
        solution, _ = method(
            lambda u: matrix(extended(u, scale))[:-1], force, M=lambda r: jnp.where(carries, r / weight, 0), tol=0.0,
            atol=accuracy * scale, maxiter=iterations,
        )  # fmt: skip
        return extended(solution, right[-1, 0])

    def product(u: Array) -> Array:
        force = -internal_force(stress_of(free(u[:-1])))
        if bedding is not None:
            force = force + free(bedding * mass * u[:-1])
        return jnp.concatenate([force, u[-1:]])

    if gapped:
        # An average divides sums of one array by each other, which only its derivative shows to be linear.
        _, product = jax.linearize(product, extended(jnp.zeros_like(net), jnp.zeros_like(norm)))
    solution = jax.lax.custom_linear_solve(
        product,
        extended(net, jax.lax.stop_gradient(norm)), solve, transpose_solve=solve, symmetric=not gapped,
    )[:-1]  # fmt: skip
    balanced = stress + stress_of(free(solution))
    unbalanced, weights = load + internal_force(balanced), jnp.linalg.norm(load, axis=1)
    share = jnp.linalg.norm(unbalanced, axis=1) / jnp.where(weights > 0, weights, jnp.inf)
    return balanced, jnp.linalg.norm(unbalanced) / norm, of_all(scene.grid, share)


def _bicgstab(
    matrix: Callable[[Array], Array],
    right: Array,
    *,
    M: Callable[[Array], Array],
    tol: float,
    atol: Array,
    maxiter: int,
) -> tuple[Array, None]:
    """Biconjugate gradients, stabilised; that of JAX transposes the matrix once more.

    They begin again from the best solution so far where the residual has grown far beyond its own, or no longer has a
    part along the first one: rounding has taken over then.

    Source: van der Vorst (1992), SIAM Journal on Scientific and Statistical Computing 13, 631-644,
    doi:10.1137/0913035.

    Args:
        matrix: function that multiplies by it.
        right: side of the equations.
        M: preconditioner.
        tol: not used.
        atol: norm of the residual at which to stop.
        maxiter: largest number of iterations.

    Returns:
        The best solution, and None.
    """
    rounding, one, zero = jnp.finfo(right.dtype).eps, jnp.ones((), right.dtype), jnp.zeros_like(right)

    class Now(NamedTuple):
        solution: Array
        residual: Array
        shadow: Array
        alpha: Array
        omega: Array
        rho: Array
        p: Array
        q: Array

    def begun(solution: Array, residual: Array) -> Now:
        return Now(solution, residual, residual, one, one, one, zero, zero)

    def goes_on(carried: tuple[Now, Array, Array, Array]) -> Array:
        _, _, least, number = carried
        return (jnp.vdot(least, least) > atol**2) & (number < maxiter)

    def iteration(carried: tuple[Now, Array, Array, Array]) -> tuple[Now, Array, Array, Array]:
        now, best, least, number = carried
        rho = jnp.vdot(now.shadow, now.residual)
        p = now.residual + rho / now.rho * now.alpha / now.omega * (now.p - now.omega * now.q)
        along = M(p)
        q = matrix(along)
        alpha = rho / jnp.vdot(now.shadow, q)
        half = now.residual - alpha * q
        early = jnp.vdot(half, half) < atol**2
        beside = M(half)
        t = matrix(beside)
        omega = jnp.vdot(t, half) / jnp.vdot(t, t)
        solution = now.solution + alpha * along + jnp.where(early, 0, omega * beside)
        residual = jnp.where(early, half, half - omega * t)
        size, smallest = jnp.linalg.norm(residual), jnp.linalg.norm(least)
        best, least = (jnp.where(size < smallest, new, old) for new, old in ((solution, best), (residual, least)))
        along_first = jnp.abs(jnp.vdot(now.shadow, residual)) > rounding * size * jnp.linalg.norm(now.shadow)
        sound = along_first & (size <= GROWN * smallest) & (alpha != 0) & (omega != 0)
        after = Now(solution, residual, now.shadow, alpha, omega, rho, p, q)
        now = jax.tree.map(partial(jnp.where, sound), after, begun(best, least))
        return now, best, least, number + 1

    start = begun(zero, right), zero, right, jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(goes_on, iteration, start)[1], None


def _sticking(scene: Scene) -> Scene:
    """The scene at rest, where soil sticks to walls with friction, and to the base."""
    boundary = scene.boundary
    walls = tuple(replace(wall, hold="fixed") if wall.hold == "friction" else wall for wall in boundary.walls)
    boundary = replace(boundary, walls=walls)
    if boundary.base is not None:
        on_base = jnp.any(boundary.base.normal != 0, axis=1)
        boundary = replace(boundary, base=None, cut=on_base if boundary.cut is None else boundary.cut | on_base)
    return replace(scene, boundary=boundary)


def _gapped(scene: Scene) -> bool:
    """Whether undrained soil lies above nodes of rigid ground by a share of a cell."""
    if sheared(scene) is False:
        return False
    if check.is_traced(scene):
        return True  # the forces close what there is

    gap = at_once(_gaps_at_rest, scene)
    return gap is not None and bool(np.any(np.asarray(gap)))


@jax.jit
def _gaps_at_rest(scene: Scene) -> Array | None:
    scene = near_soil(_sticking(scene), scene.particles.position)
    mass = Maps(scene, scene.particles.position).to_grid(scene.particles.mass[None], None)
    return gaps(scene, mass[:, 0])


GROWN = 1e3
"""Growth of the residual over its least at which biconjugate gradients begin again."""

RESIDUAL = 1e-3
"""Largest unbalanced share of the load."""

ROUNDED = 0.1
"""Unbalanced share of the load up to which it may be rounding of the displacement: in float32 strains are differences
of displacements, and over hundreds of cells these are large. What is then left is solved for from the stress found."""

BEDDING = 0.01
"""Stiffness of springs that hold nodes in place, over that of the body along its largest extent."""

LOOSE, LOOSE_MOST = 0.1, 0.02
"""Share of a node's load in its springs from which on nothing else holds the node, and largest share of such soil."""

BORNE, RATIOS = 1e-3, (0.01, 100.0, 401)
"""Share of the vertical stress by which level soil that does not yield changes; ratios at rest that are tried."""

ROUNDS = 4
"""Searches for nodes that nothing holds, each with those before held in place."""


def at_rest(scene: Scene, *, apic: bool = False) -> State:
    """Motionless state with the stress of elastic gravity loading.

    Args:
        scene: to load.
        apic: with a velocity gradient (d, d, N).

    Returns:
        State.

    Raises:
        ValueError: If the body is not held against its load, or its moduli differ by too many orders of magnitude.
    """
    return settled(scene, unstressed(scene, apic=apic))


def settled(scene: Scene, state: State) -> State:
    """State with the stress of elastic gravity loading, solved from the columns' own weight.

    The horizontal stress to start from is K0 times the vertical one: the scene's `k0`, by default nu / (1 - nu). The
    loading adds what the ground's shape asks for, nothing where it is level. A contact bears no more than its strength:
    where soil that sticks to it would draw on it by more, the soil comes to rest on it, or in a steady slide. Numbers
    of the soil, the loads and the water may be traced. Soil then sticks to contacts, and a lane that is not balanced
    has the status BAD_PARAMETER.

    Args:
        scene: to load.
        state: without gravity, body force and water it is returned unchanged.

    Returns:
        State.

    Raises:
        ValueError: If the scene has ends without walls, which hold nothing, or as for `at_rest`.
    """
    if scene.free_field is not None:
        raise ValueError(
            "ends = 'free field' hold nothing at rest: the stress of such a section is that of `section`, build it anew"
        )
    loads = scene.loads
    weightless = not check.is_traced(loads.gravity) and not np.any(np.asarray(loads.gravity))
    if weightless and loads.body_force is None and loads.water is None:
        return state
    stress = of_level_ground(scene, overburden(scene), scene.loads.k0)
    gapped = _gapped(scene)
    balanced, residual, _ = elastic_equilibrium(scene, stress, gapped=gapped)
    if check.is_traced(residual):
        status = jnp.where(residual < RESIDUAL, state.status, int(Status.BAD_PARAMETER))
        return with_stress(scene, replace(state, status=status), balanced)
    if RESIDUAL <= float(residual) < ROUNDED:
        balanced, residual, _ = elastic_equilibrium(scene, balanced, gapped=gapped)
    if not float(residual) < RESIDUAL:
        balanced = _with_loose_soil(scene, stress, gapped, float(residual))
    if scene.boundary.friction is not None:
        balanced = borne_by_contact(scene, replace(state, stress=balanced))
    return with_stress(scene, state, balanced)


def of_level_ground(scene: Scene, vertical: np.ndarray | Array, k0: ArrayLike | None) -> Array:
    """Stress of level ground under its own weight.

    Args:
        scene: with its soil.
        vertical: effective stress (N,) Pa, positive in compression.
        k0: () or (N,) horizontal over vertical stress; None for that of elastic loading.

    Returns:
        Stress (s, N) Pa.
    """
    d, dtype = scene.grid.dimension, scene.particles.mass.dtype
    vertical = -vertical.astype(dtype)
    bulk, shear, k0 = on_host((scene.material.bulk, scene.material.shear, k0))
    ratio = elastic_ratio(bulk, shear) if k0 is None else k0
    sideways = vertical * host(ratio).asarray(ratio, dtype)
    upright = {1: 0, 2: 2, 3: 2}[d]
    parts = [vertical if c == upright else sideways if c < 3 else vertical * 0 for c in tensors.CARRIED[d]]
    return array(host(parts).stack(parts), dtype)


def check_borne(scene: Scene) -> None:
    """Raise ValueError for a k0 that level ground does not bear.

    Args:
        scene: with particles on a lattice; traced numbers pass.
    """
    k0 = scene.loads.k0
    if k0 is None or check.is_traced(scene):
        return
    vertical = np.asarray(overburden(scene))
    yields = np.asarray(_yields(scene, vertical, k0))
    if not yields.any():
        return
    worst = int(np.argmax(np.where(yields, vertical, 0)))
    tried = jnp.geomspace(*RATIOS)
    borne = ~np.asarray(jax.vmap(_yields, in_axes=(None, None, 0))(scene, vertical, tried)[:, worst])
    low, high = np.asarray(tried)[borne][[0, -1]] if borne.any() else (np.nan, np.nan)
    place = ", ".join(f"{x:.4g}" for x in np.asarray(scene.particles.position)[:, worst])
    ratio = float(np.broadcast_to(np.asarray(k0), vertical.shape)[worst])
    raise ValueError(
        f"k0 = {ratio:.4g}: level soil yields so at ({place}) m, under {vertical[worst]:.4g} Pa, where it bears "
        f"{low:.2g} to {high:.2g}, from its active to its passive limit"
    )


@jax.jit
def _yields(scene: Scene, vertical: Array, k0: Array) -> Array:
    """Whether each particle (N,) yields at once under a stress of level ground that is not that of elastic loading."""
    law, particles = scene.material, scene.particles
    stress = tensors.expand(of_level_ground(scene, vertical, k0), scene.grid.dimension)
    history = law.history_at_rest(law.initial_history(particles), stress)
    none = tensors.by_component(lambda s: s if tensors.absent(s) else 0 * s, stress)
    after, _ = law.update(none, stress, history, scene.numerics.time_step)
    pairs = zip(after, stress, strict=True)
    change = jnp.max(jnp.stack([jnp.abs(new - old) for new, old in pairs if not tensors.absent(old)]), axis=0)
    not_elastic = jnp.abs(k0 - elastic_ratio(law.bulk, law.shear)) > BORNE * k0
    return not_elastic & (vertical > 0) & ~(change <= BORNE * vertical)


def _with_loose_soil(scene: Scene, stress: Array, gapped: bool, residual: float) -> Array:
    """Stress in balance with the load everywhere but at nodes that nothing holds.

    Where soil thins out, a node may carry mass of a particle that the node's motion does not strain. The equations of
    equilibrium then have no solution. With springs they have one, in which the springs bear the load of such nodes, and
    the soil that of all others. The balance is then sought with these nodes held in place. In a run they move, until
    their soil lies on its neighbours or on the ground.

    Args:
        scene: to load.
        stress: (s, N) Pa to start from.
        gapped: as of `elastic_equilibrium`.
        residual: unbalanced share of the load with all nodes free.

    Returns:
        Stress (s, N) Pa.

    Raises:
        ValueError: If more than LOOSE_MOST of the load is loose, or the balance is not found.
    """
    position, mass = np.asarray(scene.particles.position, float), scene.particles.mass
    extent = float(np.ptp(position, axis=1).max()) + scene.grid.cell
    bedding = jnp.asarray(BEDDING * (wave_speed(scene.particles, scene.material) / extent) ** 2, stress.dtype)
    nodal = np.asarray(Maps(scene, scene.particles.position).to_grid(mass[None], None)[:, 0], float)
    loose = np.zeros(scene.grid.nodes, bool)
    for _ in range(ROUNDS):
        _, _, share = elastic_equilibrium(scene, stress, gapped=gapped, loose=jnp.asarray(loose), bedding=bedding)
        found = ~(np.asarray(share) < LOOSE)
        lost = float(nodal[loose | found].sum() / nodal.sum())
        if lost > LOOSE_MOST:
            raise ValueError(
                f"nothing holds {lost:.2g} of the soil against its load, {_place(scene, nodal * (loose | found))}: "
                "let walls, a base or soil hold it, or start it with `unstressed`"
            )
        if not found.any():
            break
        loose |= found
        balanced, unbalanced, _ = elastic_equilibrium(scene, stress, gapped=gapped, loose=jnp.asarray(loose))
        residual = float(unbalanced)
        if residual < RESIDUAL:
            check.warn(
                f"soil that thins out starts without equilibrium, {lost:.1e} of all at {int(loose.sum())} nodes, "
                f"{_place(scene, nodal * loose)}: it settles in the first steps"
            )
            return balanced
    raise ValueError(
        f"the initial stress leaves {residual:.1e} of the weight unbalanced (limit {RESIDUAL:g}), "
        f"{_place(scene, nodal * np.nan_to_num(np.asarray(share), nan=1.0, posinf=1.0))}: are the moduli within some "
        "orders of magnitude, and is Poisson's ratio below 0.4999? Else start it with `unstressed`, or take float64"
    )


def _place(scene: Scene, weight: np.ndarray) -> str:
    """Words for where a weight at the nodes (nodes,) is largest."""
    node = np.unravel_index(int(np.argmax(weight)), scene.grid.shape)
    at = ", ".join(f"{start + scene.grid.cell * n:g}" for start, n in zip(scene.grid.origin, node, strict=True))
    return f"most of it at ({at}) m"


def overburden(scene: Scene) -> np.ndarray | Array:
    """Effective vertical stress by weight alone.

    It is the weight per area of the soil above each particle of a lattice in its own column, half of itself included,
    minus the pressure of the water; 0 for particles without a column.

    Args:
        scene: of particles on a lattice.

    Returns:
        (N,) Pa, positive in compression; traced where weight or water are.

    Raises:
        ValueError: If the particles' positions are traced, which tell the columns.

    Example:
        >>> import jaxmpm as mpm
        >>> soil, grid = mpm.Soil(unit_weight=20e3), mpm.Discretisation(cell=1.0, spacing=(0.5,))
        >>> scene, _ = mpm.column(4.0, soil, grid)
        >>> round(float(mpm.overburden(scene).max()))  # Pa, at 3.75 m below the surface
        75000
    """
    where = scene.particles.position
    require_known(
        {"particles' position": where},
        "close over the scene in place of handing it to the function that is transformed, and vary its numbers there",
    )
    *across, z = position = np.asarray(where)
    order = np.lexsort((-z, *across))
    starts = np.r_[True, np.any(np.diff(position[:-1, order], axis=1) != 0, axis=0)]
    if starts.all():
        return np.zeros(z.size)
    particles, loads = scene.particles, scene.loads
    numbers = host(particles, loads)
    mass, volume = (numbers.asarray(array, float) for array in (particles.mass, particles.volume))
    # Not volume over height: the ground's surface may cut a particle.
    gaps = [np.diff(np.unique(axis)) for axis in across]
    height = -np.diff(z[order])[~starts[1:]].min()
    spaced = all(gap.size for gap in gaps)
    area = float(np.prod([np.median(gap) for gap in gaps])) if spaced else volume.max() / height
    weight = -numbers.asarray(loads.gravity, float)[-1] * mass
    if loads.water is not None:
        weight = weight - volume * numbers.asarray(force_of_water(scene)[-1], float)
    # Each column is a row, its uppermost particle first.
    column = np.cumsum(starts) - 1
    place = np.arange(order.size) - np.flatnonzero(starts)[column]
    index = np.full((column[-1] + 1, place.max() + 1), order.size)
    index[column, place] = order
    rows = numbers.append(weight / area, 0.0)[index]
    inverse = np.argsort(order)
    above = (numbers.cumsum(rows, axis=1) - rows / 2)[column[inverse], place[inverse]]
    if loads.pore_pressure is not None:
        above = numbers.where(above > 0, above - numbers.asarray(loads.pore_pressure, float), above)
    return above
