"""The suite's own tools: what the cache of compiled programs holds, and what is left behind, are as they should be."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tests import conftest
from tests.conftest import SESSION, known, left_behind

RUN = """if True:
    import sys
    import jax
    import numpy as np
    import jaxmpm as mpm
    hits = []
    jax.monitoring.register_event_listener(lambda name, **_: hits.append(name) if "cache_hits" in name else None)
    slope = mpm.Slope(crest=4.0, height=4.0, run_per_rise=1.0, toe=8.0, foundation=1.0)
    soil = mpm.Soil(young=1e7, strength=8e3, softening_modulus=60e3)
    scene, state = mpm.slope(slope, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    np.save(sys.argv[1], np.asarray(mpm.solve(scene, state, t_end=0.3).state.displacement))
    print(len(hits))
"""


def run(file, **environment):
    """Displacements of a short slide, in a process of its own, and how many programs came from the cache."""
    settings = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", **environment}
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(file)], env=os.environ | settings, capture_output=True, text=True, check=True
    )
    return np.load(file), int(done.stdout)


@pytest.mark.slow
def test_programs_from_the_cache_give_the_same_bits(tmp_path):
    fresh, none = run(tmp_path / "fresh.npy", JAX_COMPILATION_CACHE_DIR=str(tmp_path / "cache"))
    cached, hits = run(tmp_path / "cached.npy", JAX_COMPILATION_CACHE_DIR=str(tmp_path / "cache"))
    assert none == 0
    assert hits > 10
    assert fresh.tobytes() == cached.tobytes()
    assert np.ptp(fresh) > 1e-3


def test_flags_that_jaxlib_does_not_know_are_recognised():
    assert known("--xla_backend_optimization_level=0")
    assert not known("--xla_no_such_flag=0")


def test_programs_are_released_between_tests_but_not_looked_at_after_each(monkeypatch):
    looks = []
    monkeypatch.setattr(conftest, "release_programs", lambda: looks.append(conftest._looked))
    monkeypatch.setattr(conftest, "_looked", -conftest.BETWEEN_LOOKS)
    for _ in range(3):
        conftest.pytest_runtest_teardown()
    assert looks == [-conftest.BETWEEN_LOOKS]


def test_a_process_left_behind_is_named():
    session = "of this test"
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, env={SESSION: session}) as left:
        (line,) = left_behind(session, seconds=0.2)
        assert f"process {left.pid}" in line
        assert "input()" in line
        left.communicate(b"\n")
    assert left_behind(session, seconds=5.0) == []
