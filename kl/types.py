"""Types of numbers: those of the host are NumPy's and always float64, those of programs `jax.Array`, perhaps traced."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from jax import Array

HostArray: TypeAlias = npt.NDArray[np.float64]
HostIndex: TypeAlias = npt.NDArray[np.int64]
# Of either kind: what covariances and trends take and give.
EitherArray: TypeAlias = HostArray | Array
# A parameter: a number, or an array to differentiate, batch or vary from point to point.
Parameter: TypeAlias = float | Array


def size_of(value: Parameter) -> Parameter:
    """|value|; `abs` of a union has no type."""
    return value.__abs__()
