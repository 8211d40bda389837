"""Settings of JAX under which campaigns cannot run, and devices that are not there."""

from __future__ import annotations

import os
import warnings

import jax

ALLOWED: dict[str, tuple[object, ...]] = {
    "jax_numpy_rank_promotion": ("allow", "warn"),
    "jax_numpy_dtype_promotion": ("standard",),
    "jax_disable_jit": (False,),
    "jax_enable_checks": (False,),
    "jax_transfer_guard": ("allow", None, "log", "log_explicit"),
}
"""Values of JAX's settings with which the programs of campaigns are made, the usual one first."""


def unusable_flags() -> dict[str, object]:
    """Settings of JAX with which no campaign runs, and their values."""
    values = {name: getattr(jax.config, name) for name in ALLOWED if hasattr(jax.config, name)}
    return {name: value for name, value in values.items() if value not in ALLOWED[name]}


def check_flags() -> None:
    """Check the settings of JAX in a script.

    Raises:
        ValueError: one with which no campaign runs; the message names it, and a value that will do.
    """
    for name, value in unusable_flags().items():
        usual = ALLOWED[name][0]
        raise ValueError(
            f"{name.upper()} = {value}, with which the programs of campaigns do not run: leave it out, or have "
            f"jax.config.update({name!r}, {usual!r}) before"
        )


def set_flags() -> None:
    """Give settings of JAX with which no campaign runs their usual values, in a process of ours, with a warning."""
    for name, value in unusable_flags().items():
        usual = ALLOWED[name][0]
        jax.config.update(name, usual)
        warnings.warn(f"{name.upper()} = {value} has no effect here, where programs need {usual}", stacklevel=2)


def missing_device() -> str:
    """Why JAX has no device, in words; empty where it has one."""
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        platforms = os.environ.get("JAX_PLATFORMS") or jax.config.jax_platforms  # type: ignore[attr-defined]
        why = f": {error}" if str(error) else ""
        return (
            f"JAX has no device on JAX_PLATFORMS = {platforms}{why}. Leave JAX_PLATFORMS out or give cpu, or install "
            "what JAX needs there"
        )
    return ""
