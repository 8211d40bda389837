"""Compiled programs, stored between commands.

The second run of a scene does not compile again. Programs are released before a process has loaded too many.
"""

from __future__ import annotations

import gc
import hashlib
import os
import platform
import warnings
import zlib
from pathlib import Path

import jax
import jaxlib
import platformdirs

from jaxmpm.transfer import native_library

SHORTEST = 0.0
"""Seconds from which on a compilation is worth keeping: the hundred small ones of a start take a second together."""

VARIABLE = "JAX_COMPILATION_CACHE_DIR"

MAPPINGS, MOST_MAPPINGS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.6
"""Share of the memory mappings that a process may hold, from which on its programs are released."""

CHECKED = ".checked"
"""File of a folder whose time is that of the last look for damaged entries."""


def keep_compiled(parent: Path | None = None) -> Path | None:
    """Have JAX keep what it compiles, for this process and those that it starts; gives the folder.

    Args:
        parent: of that folder; None takes the user's cache folder. JAX's own variables apply: JAX_COMPILATION_CACHE_DIR
            names another folder, JAX_ENABLE_COMPILATION_CACHE=0 keeps nothing (None).
    """
    if not jax.config.jax_enable_compilation_cache:  # type: ignore[attr-defined]
        return None
    # JAX compiles what it cannot read, and says so of an entry that another process is writing.
    warnings.filterwarnings("ignore", "Error reading persistent compilation cache entry")
    if VARIABLE not in os.environ:
        parent = platformdirs.user_cache_path("jaxmpm") if parent is None else parent
        os.environ[VARIABLE] = str(parent / machine())
        jax.config.update("jax_compilation_cache_dir", os.environ[VARIABLE])
        delete_damaged(Path(os.environ[VARIABLE]))
    for name, value in (("min_compile_time_secs", SHORTEST), ("min_entry_size_bytes", 0)):
        if os.environ.setdefault(f"JAX_PERSISTENT_CACHE_{name.upper()}", str(value)) == str(value):
            jax.config.update(f"jax_persistent_cache_{name}", value)
    return Path(os.environ[VARIABLE])


def delete_damaged(folder: Path) -> None:
    """Delete entries that JAX cannot read, such as a killed process leaves: JAX never replaces one.

    It looks at those alone that were written since it last looked.

    Args:
        folder: of compiled programs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checked = folder / CHECKED
    since = checked.stat().st_mtime_ns if checked.exists() else 0
    checked.touch()
    for entry in folder.glob("*-cache"):
        try:
            # JAX packs entries by zlib, or by zstd where that is installed, which reads them itself.
            if entry.stat().st_mtime_ns >= since and (content := entry.read_bytes())[:1] in (b"x", b""):
                zlib.decompress(content)
        except FileNotFoundError:
            continue
        except zlib.error:
            entry.unlink(missing_ok=True)


def machine() -> str:
    """Sixteen letters that another processor, jaxlib or build of the native library does not share.

    JAX names what it keeps by program, flags and version, but on CPU by neither the processor's instructions nor what a
    library called from the program is; code built for one machine may be illegal on another.
    """
    digest = hashlib.sha256(f"{platform.machine()} {platform.processor()} {jaxlib.__version__}".encode())
    processor = Path("/proc/cpuinfo")
    if processor.exists():
        lines = processor.read_bytes().splitlines()
        digest.update(b"".join(sorted({x for x in lines if x.startswith((b"model name", b"flags", b"Features"))})))
    library = native_library()
    if library is not None:
        digest.update(library.read_bytes())
    return digest.hexdigest()[:16]


def memory_mappings() -> tuple[int, int] | None:
    """Memory mappings that this process holds, and how many the system allows it; None where that is unknown.

    A process that needs one more ends by a segmentation fault. Each program loaded on CPU holds 8 to 50.
    """
    try:
        return MAPPINGS.read_bytes().count(b"\n"), int(MOST_MAPPINGS.read_bytes())
    except OSError:
        return None


def release_programs(most: int | None = None) -> bool:
    """Release all loaded programs where this process holds more than `most` memory mappings; whether it did.

    Args:
        most: None takes 60 per cent of those allowed. What is called again is read again from the stored programs.
    """
    mappings = memory_mappings()
    if mappings is None or mappings[0] <= (FULL * mappings[1] if most is None else most):
        return False
    jax.clear_caches()
    gc.collect()
    return True
