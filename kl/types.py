"""Types of numbers: host arrays are NumPy's and always float64; arrays of programs are JAX's and may be traced."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from jax import Array

HostArray: TypeAlias = npt.NDArray[np.float64]
HostIndex: TypeAlias = npt.NDArray[np.int64]
# Either kind: arguments and results of covariances and trends.
EitherArray: TypeAlias = HostArray | Array
# A parameter: a number, or an array to differentiate, batch or vary from point to point.
Parameter: TypeAlias = float | Array


def size_of(value: Parameter) -> Parameter:
    """Absolute value; `abs` of a union has no type.

    Args:
        value: number or array.

    Returns:
        The same shape.
    """
    return value.__abs__()
