"""A campaign's folder, opened to write or to read."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from cooperative.store._folder import GRIDS, SLIDES, Store
from cooperative.store._index import drop_indices
from cooperative.store._lock import take_lock
from cooperative.store._readme import write_readme
from cooperative.store._source import CAMPAIGN, Source, differences, stored_source
from foundation.files import set_aside
from foundation.text import shown


def open_store(folder: str | Path, source: Source | str, *, verify: bool = False) -> Store:
    """Open the campaign folder for the one controller, made if it is not there.

    source: what the campaign is made from, or a scene's text alone. verify: have every sample's file read and verified
    anew, those too that have not changed since they were verified.

    Raises ValueError when the folder cannot be written, holds something else or a campaign of another scene
    (naming what differs), or is held by another controller.
    """
    folder, source = Path(folder), Source(source) if isinstance(source, str) else source
    source.digest  # noqa: B018, no folder is made for a text that is no scene
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [entry.name for entry in folder.iterdir() if not entry.name.startswith(".")]
        there = stored_source(folder)
        if there is None and set(others) - {CAMPAIGN}:
            raise ValueError(
                f"folder {folder} holds {shown(sorted(others)[0])} but no scene.toml, so it is not a campaign: "
                "give a new or empty folder"
            )
        lock = take_lock(folder)
    except OSError as error:
        raise ValueError(
            f"folder {folder} cannot be written ({error.strerror}): give a folder that you may write to"
        ) from error
    try:
        if there is None:
            source.write(folder)
        else:
            refuse_another(folder, source)
        write_readme(folder, source)
        for directory in (folder / "samples", *(folder / "samples" / grid for grid in (*GRIDS, SLIDES))):
            _claim(directory)
            for leftover in directory.glob(".*.part"):
                leftover.unlink()
        if verify:
            drop_indices(folder)
    except BaseException:
        os.close(lock)
        raise
    return Store(folder, stored_source(folder) or source, lock)


def refuse_another(folder: Path, source: Source) -> None:
    """Raise ValueError, naming what differs, for a folder of another campaign."""
    there = stored_source(folder)
    if there is not None and (found := differences(there, source)):
        raise ValueError(
            f"folder {folder} belongs to another scene ({'; '.join(found)}): "
            "give another folder, or the scene that it was started with"
        )


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it. ValueError if it is none."""
    source = stored_source(Path(folder))
    if source is None:
        raise ValueError(f"folder {folder} has no scene.toml: give the folder of a campaign")
    return Store(Path(folder), source, None)


def _claim(directory: Path) -> None:
    """Make a folder of samples; what stands in its place, a link that leads elsewhere above all, is set aside."""
    if directory.is_symlink() or (directory.exists() and not directory.is_dir()):
        warnings.warn(
            f"{directory} is a link or a file, not a folder: set aside as {set_aside(directory)}", stacklevel=3
        )
    directory.mkdir(parents=True, exist_ok=True)
