"""A campaign on disk: a folder with one SQLite database, and files of what is too large for it.

    campaign.db                   scene, measured values, allowed runs, a row for each sample and grid, summary
    fields/refined-000123-0f3c2a9b8d71.h5    fields of a run that keeps them, by the SHA-256 in its row
    ground.h5, drawn.h5           ground, grids and random soil that a report draws (`cooperative.runs`)
    initial/rough.h5              stress of a grid at rest, solved once (`cooperative.runs`)
    restart/refined-000123.h5     a long run under way (`cooperative.runs`), removed once it has ended
    progress.log                  what was done when, where there was no terminal to show it (`cooperative.runs`)
    README.txt                    what the folder is, for whoever finds it later
    .lock                         held by the one controller; the kernel frees it when the process ends

Only the controller writes to the database. Anyone may read it at any moment; docs/campaign-db.md has its tables.
"""

from cooperative.names import GRIDS
from cooperative.store._database import BUDGET, DATABASE, FACTORS, IN_TIME, MEASURED, SCORES, SLIDES_END, SUMMARY
from cooperative.store._opened import (
    contents_sum,
    lock_holder,
    open_store,
    read_store,
    refuse_another,
    store_text,
    stored_source,
    stored_text,
    stored_texts,
)
from cooperative.store._runs import fields_path, read_rows, read_sample, restart_path, write_sample
from cooperative.store._samples import (
    COARSE,
    FAILED_AT,
    MOVING,
    SLIDES,
    SLIDES_IN_TIME,
    FinishedRun,
    Rows,
    RunRecord,
    Store,
    mixed_versions,
)
from cooperative.store._source import SCRIPTS, STORED_TABLES, Source, scene_digest, source_from, table_of, tables_of
from jaxmpm.support.files import DamagedFile, own_folder, write_aside
from jaxmpm.support.hdf5 import Scalar

__all__ = [
    "BUDGET",
    "COARSE",
    "DATABASE",
    "FACTORS",
    "FAILED_AT",
    "GRIDS",
    "IN_TIME",
    "MEASURED",
    "MOVING",
    "SCORES",
    "SCRIPTS",
    "SLIDES",
    "SLIDES_END",
    "SLIDES_IN_TIME",
    "STORED_TABLES",
    "SUMMARY",
    "DamagedFile",
    "FinishedRun",
    "Rows",
    "RunRecord",
    "Scalar",
    "Source",
    "Store",
    "contents_sum",
    "fields_path",
    "lock_holder",
    "mixed_versions",
    "open_store",
    "own_folder",
    "read_rows",
    "read_sample",
    "read_store",
    "refuse_another",
    "restart_path",
    "scene_digest",
    "source_from",
    "store_text",
    "stored_source",
    "stored_text",
    "stored_texts",
    "table_of",
    "tables_of",
    "write_aside",
    "write_sample",
]
