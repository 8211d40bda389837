"""A campaign on disk: a folder with its scene and one HDF5 file per finished sample and grid.

Files are written aside and sealed with a checksum (`jaxmpm.support.files`). A sample file is read as if a stranger had
written it: one that does not match its seal, holds anything but the numbers and texts expected, or is no file at all is
named, set aside and counted as not done.

    README.txt                    what the folder is, for whoever finds it later
    scene.toml                    the scene, verbatim; none of a campaign that was written in Python
    campaign.json                 what goes with the scene, see `Source`
    samples/rough/000123.h5       coefficients, row, fields, provenance of sample 123 on the rough grid
    samples/refined/000123.h5
    samples/slides/000123.h5      the same run to the end of its slide, where samples/refined has it until it failed
    samples/rough.index           the rows of files that were verified, so that unchanged files are not read again
    ground.h5, drawn.h5           ground, grids and random soil that a report draws (`cooperative.runs`)
    initial/rough.h5              stress of a grid at rest, solved once (`cooperative.runs`)
    restart/refined-000123.h5     a long run under way (`cooperative.runs`), removed once it has ended
    progress.log                  what was done when, where there was no terminal to show it (`cooperative.runs`)
    .lock                         held by the one controller; the kernel frees it when the process ends
"""

from cooperative.names import GRIDS
from cooperative.store._disk import (
    check_frames,
    read_rows,
    read_sample,
    restart_path,
    sample_path,
    write_sample,
)
from cooperative.store._opened import lock_holder, open_store, read_store
from cooperative.store._samples import COARSE, MOVING, SLIDES, Record, Rows, Sample, Store, mixed_versions
from cooperative.store._source import (
    CAMPAIGN,
    MOST_TEXT,
    SCENE,
    Source,
    refuse_another,
    scene_digest,
    stored_source,
    table_of,
    tables_of,
)
from jaxmpm.support.files import DamagedFile, own_folder, write_aside
from jaxmpm.support.hdf5 import Scalar

__all__ = [
    "CAMPAIGN",
    "COARSE",
    "GRIDS",
    "MOST_TEXT",
    "MOVING",
    "SCENE",
    "SLIDES",
    "DamagedFile",
    "Record",
    "Rows",
    "Sample",
    "Scalar",
    "Source",
    "Store",
    "check_frames",
    "lock_holder",
    "mixed_versions",
    "open_store",
    "own_folder",
    "read_rows",
    "read_sample",
    "read_store",
    "refuse_another",
    "restart_path",
    "sample_path",
    "scene_digest",
    "stored_source",
    "table_of",
    "tables_of",
    "write_aside",
    "write_sample",
]
