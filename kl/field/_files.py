"""An expansion in an HDF5 file, written atomically; reading executes nothing and follows no reference out of the file.

Layout: attributes `format`, `version`; datasets `index`, `origin`, `extent`; groups `axis0`, ... with the modes'
arrays and form, and under each a group `covariance` and an attribute `solver` (JSON).
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import get_args

import h5py
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import files, hdf5
from foundation.check import require
from kl import axis
from kl.axis import AxisModes, Covariance, Solver
from kl.field._bedding import Bedding
from kl.field._expansion import Expansion
from kl.types import HostArray

_FORMAT = "Karhunen-Loeve expansion"
_VERSION = 1


def _by_name(*classes: type) -> dict[str, type]:
    return {each.__name__: each for each in classes}


_FAMILIES = _by_name(
    axis.SquaredExponential,
    axis.Exponential,
    axis.Matern32,
    axis.Matern52,
    axis.SecondOrderMarkov,
    axis.CosineExponential,
    axis.Triangular,
    axis.Infinite,
    axis.Periodic,
    axis.Corrected,
)
_FORMS = _by_name(*get_args(AxisModes))
_SOLVERS = _by_name(*get_args(Solver))


def save(expansion: Expansion, path: str | Path) -> None:
    """Write an expansion to a file, whole or not at all.

    Args:
        expansion: from `expand`.
        path: file to write; an existing one is replaced.

    Raises:
        OSError: If the system refuses, with its errno, the file's name and a remedy.
    """
    with hdf5.hdf5_aside(path) as file:
        file.attrs.update(format=_FORMAT, version=_VERSION)
        file["index"] = np.asarray(expansion.index)
        file["origin"], file["extent"] = expansion.origin, expansion.extent
        if expansion.bedding is not None:
            file.attrs["bedding"] = json.dumps(asdict(expansion.bedding))
        parts = zip(expansion.axes, expansion.covariance, expansion.solvers, strict=True)
        for number, (modes, covariance, solver) in enumerate(parts):
            group = file.create_group(f"axis{number}")
            group.attrs["form"] = type(modes).__name__
            group.attrs["solver"] = json.dumps({"name": type(solver).__name__, **asdict(solver)})
            for name in _arrays(type(modes)):
                group[name] = np.asarray(getattr(modes, name))
            _write_covariance(group.create_group("covariance"), covariance)


def load(path: str | Path) -> Expansion:
    """Read an expansion that `save` wrote, in the dtype it was written in.

    Args:
        path: file to read.

    Returns:
        The expansion.

    Raises:
        ValueError: If the file is damaged, incomplete or of another kind, or has float64 values while JAX has disabled
            them.
        OSError: If the system refuses.
    """
    try:
        with hdf5.contents(path, files.read_plain(os.path.realpath(path))) as contents:
            expansion = _read(contents)
    except files.DamagedFile as error:
        raise ValueError(f"{path} holds no complete expansion ({error}): make it again with `save`") from error
    return jax.tree.map(_as_written, expansion)


def _read(file: hdf5.Contents) -> Expansion:
    about = file.scalars("/")
    require(
        (about.get("format"), about.get("version")) == (_FORMAT, _VERSION),
        f"{file.path} is not an expansion of version {_VERSION}: make it again with `save`",
    )
    origin, extent = (tuple(file.array("/", name, dimensions=1, kinds="f").tolist()) for name in ("origin", "extent"))
    index = file.array("/", "index", dimensions=2, kinds="iu")
    require(
        1 <= len(origin) <= 3 and len(extent) == len(index) == len(origin) and index.shape[1] > 0,
        f"index, origin and extent in {file.path} are of different boxes: make the file again with `save`",
    )
    require(
        np.isfinite([*origin, *extent]) & (np.array([*np.ones(len(origin)), *extent]) > 0),
        f"the box in {file.path} goes from {origin} over {extent} m: make the file again with `save`",
    )
    axes, covariances, solvers = [], [], []
    for number in range(len(origin)):
        modes, count = _read_modes(file, f"axis{number}", origin[number], extent[number])
        require(
            (index[number] >= 0) & (index[number] < count),
            f"index in {file.path} points at modes that axis{number} lacks: make the file again with `save`",
        )
        axes.append(modes)
        covariances.append(_read_covariance(file, f"axis{number}/covariance"))
        solver = json.loads(str(file.scalars(f"axis{number}")["solver"]))
        solvers.append(_SOLVERS[solver.pop("name")](**solver))
    bedding = Bedding(**json.loads(str(about["bedding"]))) if "bedding" in about else None
    return Expansion(
        tuple(covariances), tuple(axes), jnp.asarray(index, jnp.int32), bedding, tuple(solvers), origin, extent
    )


def _read_modes(file: hdf5.Contents, group: str, origin: float, extent: float) -> tuple[AxisModes, int]:
    """The modes of an axis and their number."""
    form = _FORMS[str(file.scalars(group)["form"])]
    arrays = {}
    for name in _arrays(form):
        dimensions = 2 if name in ("coefficients", "levels") else 1
        array = arrays[name] = file.array(group, name, dimensions=dimensions, kinds="f")
        require(
            len(array) == len(arrays["fractions"]) and array.size and np.isfinite(array).all(),
            f"{group}/{name} in {file.path} is damaged: make the file again with `save`",
        )
    return form(**arrays, origin=origin, extent=extent), len(arrays["fractions"])


def _as_written(array: HostArray) -> Array:
    converted = jnp.asarray(array)
    require(
        converted.dtype == array.dtype,
        f"the file holds {array.dtype}, which JAX has disabled: set jax_enable_x64 to read it",
    )
    return converted


def _arrays(form: type) -> list[str]:
    return [each.name for each in fields(form) if not each.metadata.get("static")]


def _write_covariance(group: h5py.Group, covariance: Covariance) -> None:
    group.attrs["family"] = type(covariance).__name__
    for each in fields(_FAMILIES[type(covariance).__name__]):
        value = getattr(covariance, each.name)
        if each.name == "base":
            _write_covariance(group.create_group("base"), value)
        elif each.metadata.get("static"):
            group.attrs[each.name] = value
        else:
            group[each.name] = np.asarray(value)


def _read_covariance(file: hdf5.Contents, group: str) -> Covariance:
    scalars = file.scalars(group)
    family = _FAMILIES[str(scalars["family"])]
    values: dict[str, Covariance | HostArray | float] = {}
    for each in fields(family):
        if each.name == "base":
            values[each.name] = _read_covariance(file, f"{group}/base")
        elif each.metadata.get("static"):
            values[each.name] = float(scalars[each.name])
        else:
            dimensions = 1 if each.name == "hermite" else 0
            array = file.array(group, each.name, dimensions=dimensions, kinds="fiu")
            require(
                np.isfinite(array).all(),
                f"{group}/{each.name} in {file.path} is not finite: make the file again with `save`",
            )
            values[each.name] = array
    return family(**values)
