"""Compiled programs kept between commands, so that the second run of a scene does not compile again."""

from __future__ import annotations

import hashlib
import os
import platform
from pathlib import Path

import jax
import platformdirs

from jaxmpm import native_library

SHORTEST = 0.1
"""Seconds from which on a compilation is worth keeping."""

VARIABLE = "JAX_COMPILATION_CACHE_DIR"


def keep_compiled(parent: Path | None = None) -> Path | None:
    """Have JAX keep what it compiles, for this process and those that it starts; gives the folder.

    parent: of that folder; None takes the user's cache folder. JAX's own variables are heeded:
    JAX_COMPILATION_CACHE_DIR names another folder, JAX_ENABLE_COMPILATION_CACHE=0 keeps nothing (None).
    """
    if not jax.config.jax_enable_compilation_cache:  # type: ignore[attr-defined]
        return None
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
    told = hashlib.sha256(f"{platform.machine()} {platform.processor()}".encode())
    processor = Path("/proc/cpuinfo")
    if processor.exists():
        lines = processor.read_text().splitlines()
        told.update("".join(sorted({x for x in lines if x.startswith(("model name", "flags", "Features"))})).encode())
    library = native_library()
    if library is not None:
        told.update(library.read_bytes())
    return told.hexdigest()[:16]
