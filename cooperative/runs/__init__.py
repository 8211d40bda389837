"""Runs of samples: the model of a grid, samples through lanes and workers, restart points, stopping."""

from cooperative.runs._bars import Bar, advance, bars
from cooperative.runs._columns import COLUMNS, beyond_toe
from cooperative.runs._compiled import keep_compiled, machine, memory_mappings, release_programs
from cooperative.runs._executors import Workers, cores_to_use, dask_executor, process_pool, run_through
from cooperative.runs._frames import Frames
from cooperative.runs._ground import (
    Drawn,
    HazardPlan,
    SampleSoil,
    StoredGrid,
    StoredGround,
    ground_of,
    keep_drawn,
    keep_ground,
    read_drawn,
    read_ground,
    samples_of,
    soil_of,
)
from cooperative.runs._initial import keep_initial
from cooperative.runs._known import foreign, phases_of, rows_reader
from cooperative.runs._model import GridModel, build, coefficients_of, column_plan, sampling_of
from cooperative.runs._packed import Packed, packed
from cooperative.runs._random_soil import RandomSoil, random_soil
from cooperative.runs._samples import finished, run_samples
from cooperative.runs._size import GridSize, check_coefficients, check_size, grid_size
from cooperative.runs._stopping import Stop, Stopped, heeding
from cooperative.runs._trial import Cost, cost_of

__all__ = [
    "COLUMNS",
    "Bar",
    "Cost",
    "Drawn",
    "Frames",
    "GridModel",
    "GridSize",
    "HazardPlan",
    "Packed",
    "RandomSoil",
    "SampleSoil",
    "Stop",
    "Stopped",
    "StoredGrid",
    "StoredGround",
    "Workers",
    "advance",
    "bars",
    "beyond_toe",
    "build",
    "check_coefficients",
    "check_size",
    "coefficients_of",
    "column_plan",
    "cores_to_use",
    "cost_of",
    "dask_executor",
    "finished",
    "foreign",
    "grid_size",
    "ground_of",
    "heeding",
    "keep_compiled",
    "keep_drawn",
    "keep_ground",
    "keep_initial",
    "machine",
    "memory_mappings",
    "packed",
    "phases_of",
    "process_pool",
    "random_soil",
    "read_drawn",
    "read_ground",
    "release_programs",
    "rows_reader",
    "run_samples",
    "run_through",
    "samples_of",
    "sampling_of",
    "soil_of",
]
