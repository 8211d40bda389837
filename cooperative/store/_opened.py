"""A campaign's folder, opened to write or to read."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from cooperative.store._folder import GRIDS, SLIDES, Store
from cooperative.store._index import drop_indices
from cooperative.store._lock import take_lock
from cooperative.store._readme import write_readme
from cooperative.store._scene_text import differences, kept_scene, scene_digest
from foundation.files import set_aside, write_aside
from foundation.text import shown


def open_store(folder: str | Path, scene_text: str, *, verify: bool = False) -> Store:
    """Open the campaign folder for the one controller, made if it is not there.

    verify: have every sample's file read and verified anew, those too that have not changed since they were verified.

    Raises ValueError when the folder cannot be written, holds something else or a campaign of another scene
    (naming what differs), or is held by another controller.
    """
    folder = Path(folder)
    scene_digest(scene_text)  # no folder is made for a text that is no scene
    scene_path = folder / "scene.toml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [entry.name for entry in folder.iterdir() if not entry.name.startswith(".")]
        if others and not scene_path.exists():
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
        if scene_path.exists():
            found = differences(kept_scene(scene_path), scene_text)
            if found:
                raise ValueError(
                    f"folder {folder} belongs to another scene ({'; '.join(found)}): "
                    "give another folder, or the scene that it was started with"
                )
        else:
            write_aside(scene_path, scene_text.encode())
        write_readme(folder, scene_text)
        for directory in (folder / "samples", *(folder / "samples" / grid for grid in (*GRIDS, SLIDES))):
            _claim(directory)
            for leftover in directory.glob(".*.part"):
                leftover.unlink()
        if verify:
            drop_indices(folder)
    except BaseException:
        os.close(lock)
        raise
    kept = kept_scene(scene_path)
    return Store(folder, kept, scene_digest(kept), lock)


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it. ValueError if it is none."""
    scene_path = Path(folder) / "scene.toml"
    if not scene_path.exists():
        raise ValueError(f"folder {folder} has no scene.toml: give the folder of a campaign")
    scene_text = kept_scene(scene_path)
    return Store(Path(folder), scene_text, scene_digest(scene_text), None)


def _claim(directory: Path) -> None:
    """Make a folder of samples; what stands in its place, a link that leads elsewhere above all, is set aside."""
    if directory.is_symlink() or (directory.exists() and not directory.is_dir()):
        warnings.warn(
            f"{directory} is a link or a file, not a folder: set aside as {set_aside(directory)}", stacklevel=3
        )
    directory.mkdir(parents=True, exist_ok=True)
