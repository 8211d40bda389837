"""A finished sample is written to the campaign's folder."""

from __future__ import annotations

import os
from pathlib import Path

from cooperative.store._folder import Store, restart_path, sample_path
from cooperative.store._index import add_to_index, stamp_of
from cooperative.store._samples import KIND, SCHEMA, Sample, fill_sample
from foundation import files


def write_sample(store: Store, grid: str, sample: Sample) -> Path:
    """Write one finished sample, whole or not at all, and its line in the index; its restart point is removed.

    Raises ValueError for a store opened for reading or a sample that is there already, OSError (with the
    errno of the system, for example ENOSPC) when the disk refuses; no half file is left then.
    """
    path = sample_path(store, grid, sample.number)
    if store.lock is None:
        raise ValueError(f"{store.folder} is open for reading: use open_store to write {path.name}")
    if os.path.lexists(path):
        raise ValueError(f"{path} is finished already: results are never overwritten, delete it to redo it")

    files.write_sealed(path, KIND, SCHEMA, lambda file: fill_sample(file, store, grid, sample))
    add_to_index(store, grid, stamp_of(path), sample.record)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)
    return path
