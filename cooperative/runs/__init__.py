"""Runs of samples: the model of a grid, samples through lanes and workers, restart points."""

from cooperative.runs._executors import Workers, dask_executor, process_pool, run_through
from cooperative.runs._model import GridModel, build, coefficients_of, expansion_of, run_samples, sampling_of

__all__ = [
    "GridModel",
    "Workers",
    "build",
    "coefficients_of",
    "dask_executor",
    "expansion_of",
    "process_pool",
    "run_samples",
    "run_through",
    "sampling_of",
]
