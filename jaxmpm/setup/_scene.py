"""A Scene from particles, a grid and a material: every number and choice checked."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from foundation import check
from foundation.text import shown
from jaxmpm.laws import (
    BaseMotion,
    WaterSurface,
    WaterTable,
    Zoned,
    declared,
    excesses,
    hardens,
    in_total_stress,
    laws_of,
    remembers_gap,
    snaps_back,
    with_parameters,
)
from jaxmpm.setup._motion import check_motion
from jaxmpm.tensors import CARRIED
from jaxmpm.transfer import Linear, inside, locate, passes_for
from jaxmpm.types import Engine, Grid, Kernel, Material, Particles, Scene, Scheme, State, Status, Wall

MEMBERS = [name for name in vars(Material) if not name.startswith("_")] + ["PARAMETERS"]
"""Members of the protocol `Material`."""


def scene(
    particles: Particles,
    grid: Grid,
    material: Material,
    *,
    kernel: Kernel,
    gravity: float | Sequence[float] = 0.0,
    walls: Sequence[Wall] = (),
    wall_friction: float | None = None,
    wall_cohesion: float | None = None,
    wall_pressure: ArrayLike | None = None,
    scheme: Scheme = Scheme.MUSL,
    cfl: float = 0.5,
    speed: float | None = None,
    flip: float = 1.0,
    damping: float = 0.0,
    fbar: bool = False,
    cell_average: bool | None = None,
    finite_strain: bool = False,
    internal_length: float | None = None,
    body_force: Callable[[Array, Array], Array] | None = None,
    water: WaterTable | WaterSurface | None = None,
    pore_pressure: ArrayLike | None = None,
    motion: BaseMotion | None = None,
    tied: tuple[int, int] | None = None,
    cut: ArrayLike | None = None,
    engine: Engine | None = None,
) -> Scene:
    """Build a scene of any particles and law; numbers take the precision of the particles' positions.

    It warns of linear hats where they do not work: with USL, or with particles on the faces of cells.

    Args:
        particles: position (d, N) m inside the grid, mass (N,) kg, volume (N,) m3.
        grid: background grid.
        material: law with parameters () or (N,).
        kernel: an object, for example GIMP(half_size).
        gravity: downwards (m/s2), or a vector (d,).
        walls: planes that constrain nodes.
        wall_friction: as in `Scene`.
        wall_cohesion: as in `Scene`.
        wall_pressure: as in `Scene`.
        scheme: when the stress is updated.
        cfl: time_step = cfl cell / (c + speed), c the fastest elastic wave.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the grid.
        flip: as in `Discretisation`.
        damping: as in `Discretisation`.
        fbar: as in `Discretisation`.
        cell_average: as in `Discretisation`.
        finite_strain: as in `Discretisation`.
        internal_length: as in `Discretisation`.
        body_force: as in `Scene`.
        water: as in `Scene`. The strength of undrained soil does not depend on the mean stress, so a table below the
            surface changes nothing there, and a pool is a pressure on the surface.
        pore_pressure: as in `Scene`; needs a law of effective stress.
        motion: as in `Scene`.
        tied: as in `Scene`.
        cut: as in `Scene`.
        engine: as in `Scene`.

    Returns:
        Scene.

    Raises:
        ValueError: If shapes, numbers or choices do not fit; the message names each.
    """
    d = _check_grid(grid)
    dtype = _check_particles(particles, grid)
    _check_walls(walls, grid, wall_friction, bonded=wall_cohesion is not None or wall_pressure is not None)
    _check_kernel(kernel, grid)
    _check_choices(scheme, engine, cfl=cfl, flip=flip, damping=damping)
    _warn_of_hats(kernel, scheme, particles, grid)
    g = _gravity(gravity, d)
    if speed is None:
        speed = math.sqrt(float(np.linalg.norm(g)) * (grid.shape[-1] - 1) * grid.cell)
    check.not_negative("speed", speed, "m/s")
    number = _number_of(dtype)
    material = _checked_material(material, particles, dtype)
    if wall_pressure is not None and np.shape(wall_pressure) != (math.prod(grid.shape),):
        raise ValueError(f"wall_pressure has shape {np.shape(wall_pressure)}: give ({math.prod(grid.shape)},), in Pa")
    if fbar and material.FRICTIONAL:
        raise ValueError(
            "fbar = True with a frictional soil: it averages the mean stress, on which friction depends, and soil at a "
            "free surface would lose its strength; leave fbar out, cell_average is the cure for such soils"
        )
    if fbar and cell_average:
        raise ValueError("fbar = True with cell_average = True: both average the volumetric strain, give one of them")
    if motion is not None:
        check_motion(motion, d)
    if cut is not None and (np.shape(cut) != (math.prod(grid.shape),) or np.asarray(cut).dtype != bool):
        raise ValueError(f"cut has shape {np.shape(cut)}: give ({math.prod(grid.shape)},), one bool for each node")
    if tied is not None:
        _check_tied(tied, grid, particles, walls, internal_length)
    if water is not None or pore_pressure is not None:
        _check_water(water, pore_pressure, material, particles)
    if internal_length is not None and material.initial_history(particles) is None:
        raise ValueError(f"internal_length = {internal_length:g} m, but the soil does not soften: leave it out")
    built = Scene(
        grid=grid,
        particles=particles,
        material=material,
        gravity=number(g),
        time_step=number(cfl * grid.cell / (wave_speed(particles, material) + speed)),
        kernel=kernel,
        walls=tuple(walls),
        scheme=scheme,
        engine=engine,
        fbar=bool(fbar),
        cell_average=bool(material.FRICTIONAL and d > 1) if cell_average is None else bool(cell_average),
        finite_strain=bool(finite_strain),
        nonlocal_passes=None if internal_length is None else passes_for(internal_length, kernel, grid.cell),
        body_force=body_force,
        flip=None if flip == 1 else number(flip),
        damping=None if damping == 0 else number(damping),
        wall_friction=None if wall_friction is None else number(wall_friction),
        wall_cohesion=None if wall_cohesion is None else number(wall_cohesion),
        wall_pressure=None if wall_pressure is None else number(wall_pressure),
        water=jax.tree.map(number, water),
        pore_pressure=None if pore_pressure is None else number(pore_pressure),
        motion=jax.tree.map(number, motion),
        tied=tied,
        cut=None if cut is None else jnp.asarray(cut),
    )
    check_scene(built)
    return built


def unstressed(scene: Scene, *, apic: bool = False) -> State:
    """State without motion, stress and history.

    Args:
        scene: to start.
        apic: with a velocity gradient (d, d, N) of 0.

    Returns:
        State.
    """
    particles, d = scene.particles, scene.grid.dimension
    return State(
        displacement=jnp.zeros_like(particles.position),
        velocity=jnp.zeros_like(particles.position),
        stress=jnp.zeros((len(CARRIED[d]), *particles.mass.shape), particles.mass.dtype),
        volume_ratio=jnp.ones_like(particles.mass),
        history=scene.material.initial_history(particles),
        step=jnp.zeros((), jnp.int32),
        status=jnp.asarray(int(Status.RUNNING), jnp.int32),
        affine=jnp.zeros((d, *particles.position.shape), particles.mass.dtype) if apic else None,
        gap=jnp.zeros_like(particles.mass) if remembers_gap(scene.material) else None,
    )


def check_scene(scene: Scene, axes: Scene | None = None) -> None:
    """Check the numbers of a scene. Traced values are skipped.

    Args:
        scene: to check.
        axes: leaves that have lanes first, None without lanes.

    Raises:
        ValueError: If a number is beyond its limit, softening snaps back, a residual exceeds its peak, or dilation
            exceeds friction.
    """
    check.within_limits(scene)
    laws = laws_of(scene.material)
    for law, own in zip(laws, (None,) * len(laws) if axes is None else laws_of(axes.material), strict=True):
        lanes = own if jax.tree.leaves(own) else None
        refuse_snap_back(law, lanes)
        _refuse_hardening(law, lanes)
        _refuse_excess(law, lanes)


def refuse_snap_back(material: Material, axes: Material | None = None) -> None:
    """Check that strength falls less steeply than the soil unloads elastically.

    Args:
        material: a law.
        axes: parameters that have lanes first, None without lanes.

    Raises:
        ValueError: If it does not.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(material)):
        return
    back = snaps_back(material) if axes is None else jax.vmap(snaps_back, in_axes=(axes,))(material)
    if back is not None and bool(np.any(back)):
        steepest = float(np.max(np.asarray(material.steepest_softening)))
        raise ValueError(
            f"softening of {steepest:g} Pa per unit of shear strain is steeper than elastic unloading (shear modulus "
            f"{float(np.min(np.asarray(material.shear))):g} Pa), which snaps back: soften more slowly, raise the "
            "stiffness, or, where softening is scaled by the cell, take smaller cells"
        )


def _refuse_hardening(material: Material, axes: Material | None = None) -> None:
    """Raise ValueError if residual cohesion or friction exceeds its peak."""
    if check.is_traced(material):
        return
    harder = hardens(material) if axes is None else jax.vmap(hardens, in_axes=(axes,))(material)
    if harder is not None and bool(np.any(harder)):
        raise ValueError(
            "softening leaves more cohesion or friction than the peak has: give residuals of at most the peak at each "
            "particle"
        )


def _refuse_excess(material: Material, axes: Material | None = None) -> None:
    """Raise ValueError if a number of the law exceeds the one that limits it: dilation above friction."""
    if check.is_traced(material):
        return
    excess_of = excesses(material) if axes is None else jax.vmap(excesses, in_axes=(axes,))(material)
    for name, excess in excess_of.items():
        worst, parameter = float(np.max(np.asarray(excess))), declared(material)[name].parameter
        if worst > 0:
            above = f"{math.degrees(worst):.3g} degrees" if parameter.angle else f"{worst:.3g} {parameter.unit}"
            raise ValueError(
                f"{name} is up to {above.rstrip()} above the {parameter.at_most}: give at most the {parameter.at_most}"
            )


def wave_speed(particles: Particles, material: Material) -> float:
    """Speed of the fastest elastic wave at any particle (m/s)."""
    density = np.asarray(particles.mass, float) / np.asarray(particles.volume, float)
    return math.sqrt(float(np.max(np.asarray(material.p_wave_modulus, float) / density)))


def check_shape(name: str, value: ArrayLike, particles: Particles) -> None:
    """Check that a parameter is a number or one value per particle.

    Args:
        name: of the parameter, for the message.
        value: () or (N,).
        particles: N of them.

    Raises:
        ValueError: If it has another shape.
    """
    if np.shape(value) not in ((), particles.mass.shape):
        raise ValueError(
            f"{name} has shape {np.shape(value)}: give a number or {particles.mass.shape}, one value per particle"
        )


def _number_of(dtype: np.dtype) -> Callable[[ArrayLike], Array]:
    return lambda value: jnp.asarray(value, dtype)


def _check_grid(grid: Grid) -> int:
    d = len(grid.shape)
    if d not in (1, 2, 3):
        raise ValueError(f"grid.shape = {grid.shape}: give 1, 2 or 3 axes")
    for a, nodes in enumerate(grid.shape):
        check.whole(f"grid.shape[{a}]", nodes, least=3)
    check.positive("grid.cell", grid.cell, "m")
    check.axes("grid.origin", grid.origin, d)
    return d


def _check_particles(particles: Particles, grid: Grid) -> np.dtype:
    """Their precision."""
    d, arrays = grid.dimension, (particles.position, particles.mass, particles.volume)
    shapes = tuple(np.shape(array) for array in arrays)
    count = shapes[0][-1] if shapes[0] else 0
    if shapes != ((d, count), (count,), (count,)) or not count:
        raise ValueError(
            f"particles have position {shapes[0]}, mass {shapes[1]} and volume {shapes[2]}: give ({d}, N), (N,) and "
            f"(N,) on a grid of {d} axes, N at least 1"
        )
    dtypes = {np.dtype(array.dtype) for array in arrays}
    if len(dtypes) > 1:
        raise ValueError(f"particles mix {', '.join(sorted(map(str, dtypes)))}: give all arrays one dtype")
    check.within_limits(particles)
    out = ~np.asarray(inside(grid, locate(grid, jnp.asarray(particles.position))))
    if out.any():
        first = np.asarray(particles.position)[:, int(np.argmax(out))]
        raise ValueError(
            f"{int(out.sum())} particles, one of them at {first.tolist()} m, stand on or beyond the outermost cells of "
            f"the grid of {grid.shape} nodes from {grid.origin} m: enlarge the grid by a cell of padding on each side"
        )
    return check.dtype(dtypes.pop())


def _check_walls(walls: Sequence[Wall], grid: Grid, friction: float | None, *, bonded: bool) -> None:
    for wall in walls:
        if not isinstance(wall, Wall):
            raise ValueError(f"walls hold {wall!r}: give Wall(axis, side, index, hold)")
        if wall.axis not in range(grid.dimension) or wall.index not in range(grid.shape[wall.axis]):
            raise ValueError(f"{wall}: there is no such axis or node on a grid of {grid.shape} nodes")
        if wall.side not in ("low", "high") or wall.hold not in ("fixed", "roller", "friction"):
            raise ValueError(f"{wall}: side is 'low' or 'high', hold is 'fixed', 'roller' or 'friction'")
    rough = any(wall.hold == "friction" for wall in walls)
    if rough != (friction is not None):
        raise ValueError(
            f"wall_friction = {friction} with walls of {sorted({wall.hold for wall in walls})}: give it with, and only "
            "with, walls of 'friction'"
        )
    if bonded and not rough:
        raise ValueError("wall_cohesion or wall_pressure without walls of 'friction': leave them out")
    if friction is not None:
        check.not_negative("wall_friction", friction)


def _check_kernel(kernel: Kernel, grid: Grid) -> None:
    missing = [name for name in ("shape", "deviation") if not hasattr(kernel, name)]
    if missing or isinstance(kernel, type) or type(kernel).__hash__ is None:
        raise ValueError(f"kernel = {kernel!r}: give a hashable object with shape and deviation, e.g. GIMP((0.5, 0.5))")
    half = getattr(kernel, "half_size", None)
    if half is not None:
        check.axes("half_size", half, grid.dimension)
        check.positive("half_size", half, "m")
    _check_weights(kernel, grid)  # type: ignore[arg-type]


@lru_cache
def _check_weights(kernel: Kernel, grid: Grid) -> None:
    reach = (np.arange(64) + 0.5) / 64 + 0.5
    r = jnp.asarray(reach - np.arange(3)[:, None], jnp.float32)
    for axis in range(grid.dimension):
        value, slope = (np.asarray(each).sum(0) for each in kernel.shape(axis, grid.cell, r))
        if not (np.abs(value - 1) < 1e-5).all() or not (np.abs(slope * grid.cell) < 1e-4).all():
            raise ValueError(
                f"{kernel!r} weighs a particle by {value.min():g} to {value.max():g} over its three nodes along axis "
                f"{axis} in cells of {grid.cell:g} m: give functions that add up to 1 and reach at most 1.5 cells"
            )


HATS_EDGE = 0.01
"""Distance of a particle from a face (cells) below which there is a warning of hats."""


def _warn_of_hats(kernel: Kernel, scheme: Scheme, particles: Particles, grid: Grid) -> None:
    """Warn of hats where they do not work: their slopes jump at the faces of cells."""
    if not isinstance(kernel, Linear):
        return
    if scheme is Scheme.USL:
        warnings.warn(
            "kernel = Linear with scheme = USL: nodes that are nearly empty have no bounded velocity, and slides end "
            "INVERTED; take MUSL, or GIMP",
            stacklevel=3,
        )
    cells = np.asarray(locate(grid, jnp.asarray(particles.position)), float)
    near = np.any(abs(cells - np.round(cells)) < HATS_EDGE, axis=0)
    if near.any():
        warnings.warn(
            f"kernel = Linear with {int(near.sum())} of {near.size} particles within {HATS_EDGE:g} cells of a cell's "
            "face, where the slope of hats jumps: even a uniform motion strains them; move the particles, or take GIMP",
            stacklevel=3,
        )


def _check_choices(scheme: Scheme, engine: Engine | None, *, cfl: float, flip: float, damping: float) -> None:
    if not isinstance(scheme, Scheme):
        raise ValueError(f"scheme = {scheme!r}: give a member of Scheme")
    if engine is not None and not isinstance(engine, Engine):
        raise ValueError(f"engine = {engine!r}: give a member of Engine, or None")
    check.between("cfl", cfl, 0.0, 1.0)
    check.between("flip", flip, 0.0, 1.0, ends=True)
    check.not_negative("damping", damping, "1/s")


def _gravity(gravity: float | Sequence[float], dimension: int) -> np.ndarray:
    """The vector (d,) m/s2; a number acts downwards."""
    if np.ndim(gravity) == 0:
        check.not_negative("gravity", gravity, "m/s2")
        return np.array([0.0] * (dimension - 1) + [-float(np.asarray(gravity))])
    vector = np.asarray(gravity)
    check.axes("gravity", vector.tolist(), dimension)
    return vector


def _checked_material(material: Any, particles: Particles, dtype: np.dtype) -> Any:
    """The material with its numbers in the particles' precision."""
    missing = [name for name in MEMBERS if not hasattr(type(material), name) and not hasattr(material, name)]
    if missing:
        raise ValueError(f"{type(material).__name__} lacks {', '.join(missing)}: derive it from jaxmpm.Law")
    if isinstance(material, Zoned):
        return _checked_zones(material, particles, dtype)
    for name, limit, value in check.parameters(material):
        check.within(name, value, limit)
        check_shape(name, value, particles)
    return jax.tree.map(_number_of(dtype), material)


def _checked_zones(material: Zoned, particles: Particles, dtype: np.dtype) -> Zoned:
    """As `_checked_material`, for each law with the particles of its zone."""
    count = particles.mass.size
    if len(material.counts) != len(material.laws) or min(material.counts) < 1 or sum(material.counts) != count:
        raise ValueError(
            f"counts = {material.counts} for {len(material.laws)} laws and {count} particles: give the number of each "
            "law's particles, 1 or more, together all of them"
        )
    zones = ((law, jax.tree.map(lambda leaf, own=own: leaf[..., own], particles)) for law, own in material.zones)
    return replace(material, laws=tuple(_checked_material(law, own, dtype) for law, own in zones))


def in_total_stress_at(material: Zoned) -> np.ndarray:
    """Particles (N,) bool in zones whose strength is undrained."""
    return np.repeat([in_total_stress(law) for law in material.laws], material.counts)


def _check_tied(
    tied: tuple[int, int], grid: Grid, particles: Particles, walls: Sequence[Wall], internal_length: float | None
) -> None:
    whole = isinstance(tied, tuple) and len(tied) == 2 and all(isinstance(node, int) for node in tied)
    if not whole or not 1 <= tied[0] < tied[1] <= grid.shape[0] - 2:
        raise ValueError(f"tied = {tied!r}: give two nodes along x in rising order, from 1 to {grid.shape[0] - 2}")
    along = (np.asarray(particles.position[0], float) - grid.origin[0]) / grid.cell
    if along.min() < tied[0] or along.max() > tied[1]:
        raise ValueError(
            f"particles reach from {along.min():g} to {along.max():g} cells along x, beyond the planes tied at nodes "
            f"{tied[0]} and {tied[1]}: put them between"
        )
    if any(wall.axis == 0 for wall in walls):
        raise ValueError("a wall along x with tied sides, which are no ends: give one or the other")
    if internal_length is not None:
        raise ValueError(
            f"internal_length = {internal_length:g} m with tied sides, across which it does not average: leave it out"
        )


def _check_water(
    water: WaterTable | WaterSurface | None,
    pore_pressure: ArrayLike | None,
    material: Material,
    particles: Particles,
) -> None:
    if isinstance(water, WaterTable):
        check.finite("water's x", water.x, "m")
        check.finite("water's z", water.z, "m")
        if np.ndim(water.x) != 1 or np.shape(water.x) != np.shape(water.z) or np.size(water.x) < 2:
            raise ValueError(
                f"water's x and z have shapes {np.shape(water.x)} and {np.shape(water.z)}: give (m,), m > 1"
            )
        if not np.all(np.diff(np.asarray(water.x)) > 0):
            raise ValueError(
                f"water's x = {shown(np.asarray(water.x).tolist())} m does not rise: give its points in order"
            )
    elif isinstance(water, WaterSurface):
        check.finite("water's heights", water.heights, "m")
        check.finite("water's corner", water.corner, "m")
        check.positive("water's step", water.step, "m")
        shapes = np.shape(water.heights), np.shape(water.corner), particles.position.shape[0]
        if len(shapes[0]) != 2 or min(shapes[0]) < 2 or shapes[1:] != ((2,), 3):
            raise ValueError(
                f"water's heights have shape {shapes[0]}, its corner {shapes[1]}, in {shapes[2]}D: give (nx, ny), 2 or "
                "more along each, and (2,), in 3D"
            )
    elif water is not None:
        raise ValueError(f"water = {shown(water)}: give a WaterTable, a WaterSurface, or None")
    if pore_pressure is not None:
        if in_total_stress(material):
            raise ValueError(
                f"pore pressure by r_u in {type(material).__name__}, whose strength is undrained and does not depend "
                "on it: leave it out, or give the water a level or table, of which a pool loads the ground"
            )
        check.not_negative("pore_pressure", pore_pressure, "Pa")
        if np.shape(pore_pressure) != particles.mass.shape:
            raise ValueError(
                f"pore_pressure has shape {np.shape(pore_pressure)}: give {particles.mass.shape}, one a particle"
            )
        if isinstance(material, Zoned) and np.any(np.asarray(pore_pressure)[in_total_stress_at(material)]):
            raise ValueError("pore_pressure above 0 in a zone whose strength is undrained: give 0 Pa there")


def with_strength(scene: Scene, strength: ArrayLike) -> Scene:
    """The scene with another strength.

    Args:
        scene: with a law that has a strength.
        strength: Pa, a number or one value per particle (N,).

    Returns:
        Scene.

    Raises:
        ValueError: If the law has no strength, the shape is different, a value is not finite and above 0, or softening
            snaps back.
    """
    if "strength" not in declared(scene.material):
        raise ValueError(
            f"{type(scene.material).__name__} has no strength: give a J2 material, as `Soil(strength=..)` makes"
        )
    check.positive("strength", strength, "Pa")
    check_shape("strength", strength, scene.particles)
    value = jnp.asarray(strength, scene.particles.mass.dtype)
    varied = with_parameters(scene.material, {declared(scene.material)["strength"].path: value})
    for law in laws_of(varied):
        refuse_snap_back(law)
    return replace(scene, material=varied)
