"""An expansion in an HDF5 file, whole or not there at all; nothing read is executed.

Layout: attributes `format`, `version`; datasets `index`, `origin`, `extent`; groups `axis0`, ... with the modes'
arrays and form, and under each a group `covariance` and an attribute `solver` (JSON).
"""

from __future__ import annotations

import io
import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5py
import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation.check import require
from foundation.files import write_aside
from kl.axis import (
    CellModes,
    ClosedForm,
    Constant,
    Corrected,
    CosineExponential,
    Covariance,
    Exponential,
    Haar,
    Infinite,
    Legendre,
    LegendreModes,
    Matern32,
    Matern52,
    Nystrom,
    Periodic,
    SecondOrderMarkov,
    SineModes,
    SquaredExponential,
    Triangular,
)
from kl.field._bedding import Bedding
from kl.field._expansion import Expansion
from kl.types import HostArray

_FORMAT = "Karhunen-Loeve expansion"
_VERSION = 1


def _by_name(*classes: type) -> dict[str, Any]:
    return {each.__name__: each for each in classes}


_FAMILIES = _by_name(
    SquaredExponential,
    Exponential,
    Matern32,
    Matern52,
    SecondOrderMarkov,
    CosineExponential,
    Triangular,
    Infinite,
    Periodic,
    Corrected,
)
_FORMS = _by_name(LegendreModes, CellModes, SineModes)
_SOLVERS = _by_name(Nystrom, Legendre, Haar, ClosedForm, Constant)


def save(expansion: Expansion, path: str | Path) -> None:
    """Write `expansion` to `path`, replacing it whole or not at all; raises what `foundation.files.aside` raises."""
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
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
    write_aside(path, image.getbuffer())


def load(path: str | Path) -> Expansion:
    """Read an expansion that `save` wrote, in the dtype it was written in.

    Raises ValueError for a file that is damaged, incomplete or of another kind, naming what is wrong with it.
    """
    try:
        with h5py.File(path, "r") as file:
            return _read(file)
    except (KeyError, TypeError, OSError, json.JSONDecodeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{path} holds no complete expansion ({error}): make it again with `save`") from error


def _read(file: h5py.File) -> Expansion:
    require(
        file.attrs.get("format") == _FORMAT and file.attrs.get("version") == _VERSION,
        f"{file.filename} is not an expansion of version {_VERSION}: make it again with `save`",
    )
    index = file["index"][()]
    origin, extent = (tuple(map(float, file[name][()])) for name in ("origin", "extent"))
    axes, covariances, solvers = [], [], []
    for number in range(len(origin)):
        group = file[f"axis{number}"]
        form = _FORMS[group.attrs["form"]]
        arrays = {name: group[name][()] for name in _arrays(form)}
        count = len(arrays["fractions"])
        for name, array in arrays.items():
            require(
                len(array) == count and np.isfinite(array).all(),
                f"axis{number}/{name} in {file.filename} is damaged: make the file again with `save`",
            )
        require(
            (index[number] >= 0) & (index[number] < count),
            f"index in {file.filename} points at modes that axis{number} lacks: make the file again with `save`",
        )
        arrays = {name: _as_written(array) for name, array in arrays.items()}
        axes.append(form(**arrays, origin=origin[number], extent=extent[number]))
        covariances.append(_read_covariance(group["covariance"]))
        solver = json.loads(group.attrs["solver"])
        solvers.append(_SOLVERS[solver.pop("name")](**solver))
    bedding = Bedding(**json.loads(file.attrs["bedding"])) if "bedding" in file.attrs else None
    return Expansion(tuple(covariances), tuple(axes), jnp.asarray(index), bedding, tuple(solvers), origin, extent)


def _as_written(array: HostArray) -> Array:
    kept = jnp.asarray(array)
    require(
        kept.dtype == array.dtype,
        f"the file holds {array.dtype}, which JAX has disabled: set jax_enable_x64 to read it",
    )
    return kept


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


def _read_covariance(group: h5py.Group) -> Covariance:
    family = _FAMILIES[group.attrs["family"]]
    values: dict[str, Covariance | Array | float] = {}
    for each in fields(family):
        if each.name == "base":
            values[each.name] = _read_covariance(group["base"])
        elif each.metadata.get("static"):
            values[each.name] = float(group.attrs[each.name])
        else:
            values[each.name] = _as_written(group[each.name][()])
    return family(**values)
