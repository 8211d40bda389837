"""Tests, in rooms like those of the packages."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout."""
