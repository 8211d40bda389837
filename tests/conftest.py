"""Fixtures and settings that all tests share."""

from collections.abc import Iterator

import jax
import pytest
from hypothesis import settings

# A first call compiles, so a deadline per example means nothing; the same examples every time keep main green.
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")


@pytest.fixture
def x64() -> Iterator[None]:
    """Run the test in float64."""
    with jax.enable_x64(True):
        yield
