"""Runs at once: what a scene asks for, else by the device and the size of a run."""

from dataclasses import replace

import jax
import pytest

from cooperative.runs._lanes import lanes_of
from cooperative.scene import Plan


@pytest.mark.parametrize(
    ("backend", "grid", "particles", "lanes"),
    [
        ("cpu", "rough", 42_624, 1),
        ("cpu", "refined", 2_664, 1),
        ("gpu", "rough", 42_624, 128),
        ("gpu", "refined", 681_984, 2),
        ("gpu", "refined", 100_000, 12),
        ("gpu", "refined", 100, 128),
        ("gpu", "refined", 1e7, 2),
    ],
)
def test_runs_at_once_fill_each_of_two_devices(backend, grid, particles, lanes, monkeypatch):
    plan = Plan(samples=10)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(jax, "local_devices", lambda: ["one", "other"])
    assert lanes_of(plan, grid, particles) == lanes
    asked = replace(plan, lanes=5, look_ahead=3)
    assert lanes_of(asked, grid, particles) == (3 if grid == "refined" else 5)
