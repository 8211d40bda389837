"""Runs of samples: the model of a grid, samples through lanes and workers, restart points, stopping."""

from cooperative.runs._bars import Bar, advance, bars
from cooperative.runs._built import build, keep_initial, verify_initial
from cooperative.runs._compiled import keep_compiled, machine, memory_mappings, release_programs
from cooperative.runs._dask import dask_executor
from cooperative.runs._drawn import Drawn, SampleSoil, keep_drawn, read_drawn, rock_of, soil_of, strength_of
from cooperative.runs._executors import Packed, Workers, packed, run_through
from cooperative.runs._flags import check_flags, missing_device, set_flags
from cooperative.runs._flow import conductivity_of, own_flows, under_own_flow
from cooperative.runs._ground import (
    HazardPlan,
    StoredGrid,
    StoredGround,
    ground_of,
    keep_ground,
    read_ground,
    rows_reader,
)
from cooperative.runs._model import GridModel
from cooperative.runs._processes import cores_to_use, process_pool, refuse_unguarded
from cooperative.runs._random_soil import RandomSoil, random_soil
from cooperative.runs._reach import Reach, reach_of, warnings_of
from cooperative.runs._restart import Frames
from cooperative.runs._samples import COLUMNS, GROUND_MOVED, finished_run, run_samples
from cooperative.runs._sampling import (
    coefficients_of,
    draw_by,
    name_of_rank,
    phases_of,
    samples_of,
    sampling_of,
    scores_of,
    screened_by,
    zone_row,
)
from cooperative.runs._size import (
    Cost,
    GridSize,
    check_all,
    check_coefficients,
    check_size,
    cost_of,
    grid_size,
    seconds_per_step,
)
from cooperative.runs._stopping import Stop, Stopped, stop_by_signals

__all__ = [
    "COLUMNS",
    "GROUND_MOVED",
    "Bar",
    "Cost",
    "Drawn",
    "Frames",
    "GridModel",
    "GridSize",
    "HazardPlan",
    "Packed",
    "RandomSoil",
    "Reach",
    "SampleSoil",
    "Stop",
    "Stopped",
    "StoredGrid",
    "StoredGround",
    "Workers",
    "advance",
    "bars",
    "build",
    "check_all",
    "check_coefficients",
    "check_flags",
    "check_size",
    "coefficients_of",
    "conductivity_of",
    "cores_to_use",
    "cost_of",
    "dask_executor",
    "draw_by",
    "finished_run",
    "grid_size",
    "ground_of",
    "keep_compiled",
    "keep_drawn",
    "keep_ground",
    "keep_initial",
    "machine",
    "memory_mappings",
    "missing_device",
    "name_of_rank",
    "own_flows",
    "packed",
    "phases_of",
    "process_pool",
    "random_soil",
    "reach_of",
    "read_drawn",
    "read_ground",
    "refuse_unguarded",
    "release_programs",
    "rock_of",
    "rows_reader",
    "run_samples",
    "run_through",
    "samples_of",
    "sampling_of",
    "scores_of",
    "screened_by",
    "seconds_per_step",
    "set_flags",
    "soil_of",
    "stop_by_signals",
    "strength_of",
    "under_own_flow",
    "verify_initial",
    "warnings_of",
    "zone_row",
]
