"""States on disk: restart points, and series of particles that ParaView opens.

A restart point is HDF5, sealed (see `jaxmpm.support.files`), with every leaf of the state by its name; reading it
executes nothing. A series is VTKHDF 2.0: an unstructured grid of one vertex per particle, with a `Steps` group for the
times.

Source: VTK file formats, VTKHDF specification, https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.laws import declared, of_skeleton
from jaxmpm.support import check, hdf5
from jaxmpm.support.text import shown
from jaxmpm.types import Scene, State

KIND = "jaxmpm restart point"
SCHEMA = 1

VERTEX = 1
"""VTK's number of a cell that is one point."""

COLUMNS = {
    ("vector", 1): (3, [0]),
    ("vector", 2): (3, [0, 2]),
    ("vector", 3): (3, [0, 1, 2]),
    ("tensor", 3): (6, [0, 1, 2]),
    ("tensor", 4): (6, [0, 1, 2, 5]),
    ("tensor", 6): (6, [0, 1, 2, 3, 4, 5]),
}
"""Number of VTK's columns, 3 or 6, and those of the components that a dimension has, by kind and their number."""

Fields = Mapping[str, np.ndarray]


def save_state(path: str | Path, state: State, *, about: Mapping[str, object] | None = None) -> None:
    """Write every leaf of a state, bit for bit, to a restart file.

    A write that fails leaves the previous file as it is, and no part of a new one.

    Args:
        path: file to write; an existing one is replaced.
        state: of one lane or many.
        about: further values by name, numbers, texts or arrays; `load_state` returns them.

    Raises:
        OSError: If the system refuses.

    Example:
        >>> import tempfile, pathlib
        >>> import jaxmpm as mpm
        >>> soil, grid = mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,))
        >>> _, state = mpm.column(4.0, soil, grid)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "point.h5")
        ...     mpm.save_state(path, state, about={"time": 0.0})
        ...     again, about = mpm.load_state(path, like=state)
        >>> bool((again.stress == state.stress).all()), float(about["time"])
        (True, 0.0)
    """

    def fill(file: h5py.File) -> None:
        leaves = file.create_group("state")
        for name, leaf in _named(state).items():
            leaves[name] = np.asarray(leaf)
        rest = file.create_group("about")
        for name, value in (about or {}).items():
            rest[name] = value

    hdf5.write_sealed(path, KIND, SCHEMA, fill)


def load_state(path: str | Path, like: State) -> tuple[State, dict[str, Any]]:
    """Read a restart file into a state of the same structure as another.

    Args:
        path: file that `save_state` wrote.
        like: state with the structure, shapes and dtypes that are expected, for example the scene's initial one.

    Returns:
        State, and the further values by name.

    Raises:
        DamagedFile: If the file cannot be trusted.
        ValueError: If a leaf is missing, superfluous or of another shape or dtype than that of `like`; the message
            names it.
    """
    named = _named(like)
    with hdf5.read_sealed(path, KIND, SCHEMA) as file:
        names = file.names("state")
        arrays = {name: file.array("state", name) for name in names if name in named}
        about = {name: file.value("about", name) for name in file.names("about")}
    if named.keys() != arrays.keys() | set(names):
        raise ValueError(
            f"{path} holds {shown(sorted(names))}, the scene's state has {sorted(named)}: give its own scene"
        )
    for name, leaf in named.items():
        there, expected = (arrays[name].shape, arrays[name].dtype), (np.shape(leaf), np.dtype(leaf.dtype))
        if there != expected:
            raise ValueError(f"{path} holds {name} as {there}, the scene's state as {expected}: give its own scene")
    leaves = [jnp.asarray(arrays[name]) for name in named]
    return jax.tree.unflatten(jax.tree.structure(like), leaves), about


def write_vtkhdf(path: str | Path, scene: Scene, states: Iterable[State], times: Sequence[float]) -> None:
    """Write a run as a series of particles for ParaView.

    Points are current positions (m). Fields: displacement (m), velocity (m/s) of the grid at the particle, effective
    stress (Pa, xx yy zz xy yz xz), pore_pressure (Pa) where there is water, plastic_strain or the leaves of the
    material's history, volume_ratio, and the strength (Pa) if the material has one, nan in zones without.

    Args:
        path: file to write; an existing one is replaced.
        scene: of the run.
        states: one state of one lane at each time, taken one by one.
        times: s, ascending.

    Raises:
        ValueError: If a state has lanes, or the numbers of states and times differ.
        OSError: If the system refuses.
    """
    strength = declared(scene.material).get("strength")
    count = scene.particles.mass.shape[-1]
    constant = {} if strength is None else {"strength": np.broadcast_to(np.asarray(strength.value), (count,))}
    fields = (_fields_of(scene, state) for state in states)
    write_particles(path, np.asarray(scene.particles.position), times, fields, constant=constant)


def write_particles(
    path: str | Path,
    position: np.ndarray,
    times: Sequence[float],
    steps: Iterable[Fields],
    *,
    constant: Fields | None = None,
) -> None:
    """Write a series of particles as VTKHDF.

    Args:
        path: file to write; an existing one is replaced.
        position: initial (d, N) m.
        times: T times (s), ascending.
        steps: T mappings from name to values of the particles, taken one by one: (N,), (d, N) for vectors or, named
            `stress`, (s, N) as `State.stress`; `displacement` moves the points.
        constant: values (N,) by name that hold at all times.

    Raises:
        ValueError: If shapes or the number of steps do not fit.
        OSError: If the system refuses.
    """
    check.finite("times", times, "s")
    if position.ndim != 2 or not len(times) or not (np.diff(times) > 0).all():
        raise ValueError(
            f"position has shape {position.shape} and times are {shown(list(times))}: give (d, N) and ascending times"
        )
    count = position.shape[1]
    with hdf5.hdf5_aside(path) as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = (2, 0)
        root.attrs.create("Type", b"UnstructuredGrid", dtype="S16")
        for name, number in (("NumberOfPoints", count), ("NumberOfCells", count), ("NumberOfConnectivityIds", count)):
            root[name] = np.array([number], np.int64)
        root["Connectivity"], root["Offsets"] = np.arange(count), np.arange(count + 1)
        root["Types"] = np.full(count, VERTEX, np.uint8)
        data, offsets = root.create_group("PointData"), {}
        for name, values in (constant or {}).items():
            data[name], offsets[name] = _rows(name, values, count), np.zeros(len(times), np.int64)
        every = np.arange(len(times)) * count
        for step, fields in enumerate(_exactly(steps, len(times))):
            displacement = fields.get("displacement", np.zeros_like(position))
            _put(root, "Points", step, len(times), _rows("position", position + displacement, count))
            for name, values in fields.items():
                _put(data, name, step, len(times), _rows(name, values, count))
                offsets[name] = every
        group = root.create_group("Steps")
        group.attrs["NSteps"] = len(times)
        group["Values"] = np.asarray(times, np.float64)
        group["PointOffsets"] = every
        group["NumberOfParts"] = np.ones(len(times), np.int64)
        for name, shape in (("PartOffsets", ()), ("CellOffsets", (1,)), ("ConnectivityIdOffsets", (1,))):
            group[name] = np.zeros((len(times), *shape), np.int64)
        for name, offset in offsets.items():
            group[f"PointDataOffsets/{name}"] = offset


def _put(group: h5py.Group, name: str, step: int, steps: int, rows: np.ndarray) -> None:
    """Write the rows (N, ...) of one step into the data set of all steps; the first one makes it."""
    if step == 0:
        shape = (steps * len(rows), *rows.shape[1:])
        group.create_dataset(name, shape, rows.dtype, chunks=rows.shape, compression="gzip", compression_opts=1)
    group[name][step * len(rows) : (step + 1) * len(rows)] = rows


def _exactly(steps: Iterable[Fields], count: int) -> Iterator[Fields]:
    """The steps, one by one; ValueError unless there are `count`, all with the same fields."""
    names, written = None, 0
    for fields in islice(steps, count + 1):
        names = names or fields.keys()
        if fields.keys() != names:
            raise ValueError(f"fields {sorted(names ^ fields.keys())} are not there at all times: give them at each")
        written += 1
        if written <= count:
            yield fields
    if written != count:
        raise ValueError(f"{written if written < count else 'more'} states for {count} times: give one for each")


def _rows(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Values of one field in VTK's layout (N,), (N, 3) or (N, 6), from the components that the dimension has."""
    values = np.asarray(values)
    if values.shape == (count,):
        return values
    kind = ("tensor" if name == "stress" else "vector", len(values) if values.ndim == 2 else 0)
    if values.shape[-1:] != (count,) or kind not in COLUMNS:
        raise ValueError(f"{name} has shape {values.shape}: give one value or column for each of {count} particles")
    size, columns = COLUMNS[kind]
    rows = np.zeros((count, size), values.dtype)
    rows[:, columns] = values.T
    return rows


_grid_velocity = jax.jit(diagnostics.grid_velocity)


def _fields_of(scene: Scene, state: State) -> dict[str, np.ndarray]:
    skeleton = of_skeleton(state.history)
    history = {} if skeleton is None else _named(skeleton)
    if list(history) == [""]:
        history = {"plastic_strain": history[""]}
    fields = {name: getattr(state, name) for name in ("displacement", "volume_ratio")}
    on_device = jax.tree.map(jnp.asarray, state)
    fields["stress"] = diagnostics.effective_stress(scene, on_device)
    if scene.loads.water is not None or scene.loads.pore_pressure is not None:
        fields["pore_pressure"] = diagnostics.pore_pressure(scene, on_device)
    fields["velocity"] = _grid_velocity(scene, on_device)
    return {name: np.asarray(values) for name, values in (fields | history).items()}


def _named(tree: object) -> dict[str, Array]:
    """Leaves of a pytree by their path in it ("history" or "history.x"), in the order of its flattening."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in paths}
