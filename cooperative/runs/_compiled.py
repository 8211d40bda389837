"""Compiled programs, stored between commands.

The second run of a scene does not compile again. Programs are released before a process has loaded too many.
"""

from __future__ import annotations

import gc
import hashlib
import os
import platform
import threading
from pathlib import Path

import jax
import platformdirs

try:
    from jax._src import compilation_cache as jax_cache
except ImportError:
    jax_cache = None  # type: ignore[assignment]

from jaxmpm.transfer import native_library

SHORTEST = 0.0
"""Seconds from which on a compilation is worth keeping: the hundred small ones of a start take a second together."""

VARIABLE = "JAX_COMPILATION_CACHE_DIR"

MAPPINGS, MOST_MAPPINGS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.6
"""Share of the memory mappings that a process may hold, from which on its programs are released."""

_jaxs_entries = getattr(jax_cache, "get_file_cache", None)


def keep_compiled(parent: Path | None = None) -> Path | None:
    """Have JAX keep what it compiles, for this process and those that it starts; gives the folder.

    Args:
        parent: of that folder; None takes the user's cache folder. JAX's own variables apply: JAX_COMPILATION_CACHE_DIR
            names another folder, JAX_ENABLE_COMPILATION_CACHE=0 keeps nothing (None). A damaged entry is compiled and
            written anew; where JAX_COMPILATION_CACHE_MAX_SIZE bounds the folder, JAX alone writes and reads it.
    """
    if not jax.config.jax_enable_compilation_cache:  # type: ignore[attr-defined]
        return None
    if _jaxs_entries is not None:
        jax_cache.get_file_cache = _entries  # type: ignore[assignment]
    if VARIABLE not in os.environ:
        parent = platformdirs.user_cache_path("jaxmpm") if parent is None else parent
        os.environ[VARIABLE] = str(parent / machine())
        jax.config.update("jax_compilation_cache_dir", os.environ[VARIABLE])
        for name, value in (("min_compile_time_secs", SHORTEST), ("min_entry_size_bytes", 0)):
            if os.environ.setdefault(f"JAX_PERSISTENT_CACHE_{name.upper()}", str(value)) == str(value):
                jax.config.update(f"jax_persistent_cache_{name}", value)
    return Path(os.environ[VARIABLE])


def machine() -> str:
    """Sixteen letters that another processor, or another build of the native library, does not share.

    JAX names what it keeps by program, flags and version, but on CPU by neither the processor's instructions nor what a
    library called from the program is; code built for one machine may be illegal on another.
    """
    digest = hashlib.sha256(f"{platform.machine()} {platform.processor()}".encode())
    processor = Path("/proc/cpuinfo")
    if processor.exists():
        lines = processor.read_bytes().splitlines()
        digest.update(b"".join(sorted({x for x in lines if x.startswith((b"model name", b"flags", b"Features"))})))
    library = native_library()
    if library is not None:
        digest.update(library.read_bytes())
    return digest.hexdigest()[:16]


def _entries(folder: str) -> object:
    """The entries of a folder, and its name, as JAX asks for them: ours, or JAX's own for what ours do not do."""
    bounded = getattr(jax.config, "jax_compilation_cache_max_size", -1) != -1
    compared = getattr(jax.config, "jax_compilation_cache_check_contents", False)
    if bounded or compared or "://" in folder:
        return _jaxs_entries(folder)  # type: ignore[misc]
    return _Entries(folder), folder


class _Entries:
    """Files of compiled programs, named as JAX names them, each with its SHA-256 at the end.

    JAX writes them in place and never replaces one, so that it compiles what a killed process left half written again
    in every process. Here a file whose end is not the SHA-256 of the rest counts as missing, those that JAX wrote too,
    and is replaced. Decompression stops before the SHA-256, so that JAX reads these files too.
    """

    def __init__(self, folder: str) -> None:
        self._path = Path(folder)
        self._path.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> bytes | None:
        """The program of this key, None where there is none that is whole."""
        try:
            stored = self._file(key).read_bytes()
        except FileNotFoundError:
            return None
        program = stored[: -hashlib.sha256().digest_size]
        return program if stored == _sealed(program) else None

    def put(self, key: str, program: bytes) -> None:
        """Write the program beside its place and rename it: processes may write the same one at the same time."""
        file = self._file(key)
        part = file.with_name(f".{key}.{os.getpid()}-{threading.get_ident()}")
        try:
            part.write_bytes(_sealed(program))
            os.replace(part, file)
        finally:
            part.unlink(missing_ok=True)

    def _file(self, key: str) -> Path:
        return self._path / f"{key}-cache"


def _sealed(program: bytes) -> bytes:
    return program + hashlib.sha256(program).digest()


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
