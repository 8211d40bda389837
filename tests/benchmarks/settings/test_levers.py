"""The table of what particles and time step change: its file, and what it makes of one."""

import numpy as np
import pytest

from benchmarks.settings import levers, levers_runs

PLAIN = ("section", "rough", 1.0, 0.5, "class")
FASTER = ("section", "rough", 1.0, 0.9, "class")


def outcome(displacement, *, status=2, steps=100, time=2.0, energy=-1.0):
    values = status, steps, time, displacement, 0.0, 0.0, energy
    return dict(zip(levers_runs.MEASURED, map(float, values), strict=True))


def test_the_default_time_step_is_that_of_the_table():
    values = levers.run(quick=True).values
    assert values["samples_cfl"] == 1600
    assert values["classes_changed_cfl"] == values["broke_off_cfl"] == values["runs_that_gain_energy_cfl"] == 0
    assert values["spearman_cfl"] > 0.99
    assert values["cost_share_cfl"] < 0.62


def test_changed_classes_energy_and_broken_runs_are_counted():
    plain = {0: outcome(0.1), 1: outcome(1.2, status=3), 2: outcome(1.1, status=3, time=1.0), 3: outcome(0.2)}
    faster = {
        0: outcome(0.1, steps=50),
        1: outcome(0.9, steps=50),
        2: outcome(1.1, status=3, energy=2.0),
        4: outcome(0.3),
    }
    row = levers.row(FASTER, {PLAIN: plain, FASTER: faster})
    assert (row["samples"], row["fail"], row["classes_changed"]) == (3, 1, 1)
    assert (row["runs_that_gain_energy"], row["broke_off"]) == (1, 0)
    assert row["cost_share"] == pytest.approx(200 / 300, abs=1e-3)


def test_slopes_that_fail_sooner_rank_above():
    runs = [outcome(1.05, status=3, time=1.0), outcome(1.2, status=3, time=4.0), outcome(0.5)]
    rank = levers.rank_by({name: np.array([run[name] for run in runs]) for name in levers_runs.MEASURED})
    assert rank == pytest.approx([21.0, 6.0, 0.5])
