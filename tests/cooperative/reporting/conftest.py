"""A campaign that has run and is reported, for all tests of reports."""

import pytest

from cooperative import run
from cooperative.reporting import report
from tests.cooperative.reporting.test_report import SCENE


@pytest.fixture(scope="session")
def done(tmp_path_factory):
    """A finished campaign: its folder, which no test changes, and its summary."""
    folder = tmp_path_factory.mktemp("campaign") / "reported"
    summary = run(SCENE, folder)
    report(folder)
    return folder, summary
