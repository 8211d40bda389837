"""The random soil of the samples that a report draws, in `drawn.h5` of a campaign's folder.

The file is written with the summary, and sealed. Where it is missing, the scene gives what it holds
(`soil_of`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from cooperative.runs._model import GridModel
from jaxmpm.laws import declared
from jaxmpm.support import files, hdf5
from jaxmpm.support.values import by_value

DRAWN = ("cooperative random soil", 1)
"""Kind and schema of the file."""


@by_value
@dataclass(frozen=True)
class SampleSoil:
    """The random soil of a sample on one grid.

    Args:
        values: of each parameter at the particles (N,), in SI units and degrees, nan in rock.
        time_step: (s).
    """

    values: Mapping[str, np.ndarray]
    time_step: float


Drawn = Mapping[tuple[str, int], SampleSoil]
"""By grid and number of the sample."""


def soil_of(model: GridModel, coefficients: np.ndarray) -> SampleSoil:
    """The random soil of a sample on a grid; where no soil is random its strength, beside what goes with water.

    Args:
        model: the grid.
        coefficients: of the sample (terms,).
    """
    values = {name: np.asarray(value, float) for name, value in model.parameters(coefficients).items()}
    rock = rock_of(model)
    shown = values if model.campaign.random else strength_of(model) | values
    values = {name: np.where(rock, np.nan, value) for name, value in shown.items()}
    return SampleSoil(values, model.time_step(coefficients))


def strength_of(model: GridModel) -> dict[str, np.ndarray]:
    """Strength of a grid's soil with the means of what varies, by parameter (N,) in SI units and degrees.

    A law of the user's own may declare none.

    Args:
        model: the grid.
    """
    count = model.scene.particles.mass.size
    return {
        name: np.broadcast_to(np.rad2deg(number.value) if number.parameter.angle else number.value, count)
        for name, number in declared(model.scene.material).items()
        if number.parameter.reduced and not number.parameter.at_most
    }


def rock_of(model: GridModel) -> np.ndarray:
    """Which particles of a grid are rock (N,).

    Args:
        model: the grid.
    """
    if model.layer is None:
        return np.zeros(model.scene.particles.mass.size, bool)
    return np.array([layer.rock for layer in model.campaign.site.layers])[model.layer]


def keep_drawn(folder: Path, drawn: Drawn) -> None:
    """Write `drawn.h5`, the random soil of samples.

    Args:
        folder: of the campaign.
        drawn: random soil by grid and sample.

    Raises:
        OSError: the disk refuses.
    """

    def fill(file: h5py.File) -> None:
        for (grid, number), soil in drawn.items():
            group = file.create_group(f"{grid}_{number}")
            group.attrs["time_step"] = soil.time_step
            for name, values in soil.values.items():
                group[name] = values.astype(np.float32)

    hdf5.write_sealed(folder / "drawn.h5", *DRAWN, fill)


def read_drawn(folder: Path, keys: Iterable[tuple[str, int]]) -> Drawn:
    """The random soil in `drawn.h5` of these samples, by grid and number.

    Those that it lacks are left out, all of them where it cannot be trusted.

    Args:
        folder: of the campaign.
        keys: grid and number of each sample.
    """
    soils: dict[tuple[str, int], SampleSoil] = {}
    try:
        with hdf5.read_sealed(folder / "drawn.h5", *DRAWN) as file:
            there = file.names("/")
            for grid, number in keys:
                if (group := f"{grid}_{number}") in there:
                    values = {name: file.array(group, name, dimensions=1, kinds="f") for name in file.names(group)}
                    step = float(file.scalars(group)["time_step"])
                    soils[grid, number] = SampleSoil(
                        {name: value.astype(float) for name, value in values.items()}, step
                    )
    except (FileNotFoundError, files.DamagedFile):
        return {}
    return soils
