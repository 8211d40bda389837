"""Lanes over several devices give the results of one device, bit for bit; a machine with one pays nothing."""

import os
import subprocess
import sys

import jax
import pytest

from jaxmpm.run._devices import mesh_of

CHILD = """
import jax, numpy as np, jaxmpm as mpm
from jaxmpm.run._devices import mesh_of
assert [mesh_of(lanes) and mesh_of(lanes).size for lanes in (1, 2, 4, 5, 6)] == [None, 2, 2, None, 3]
soil = mpm.Soil(young=5e6, strength=9e3)
scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
seen = []

def ends():
    runs = mpm.solve_each(scene, state, {"strength": np.linspace(6e3, 30e3, 7)}, width=4, t_end=0.2, every=0.05,
        rules=[mpm.Exceeds(1e-3)], observe=lambda n, t, midway: seen.append(t))
    return {n: (int(r.status), int(r.state.step), np.asarray(r.state.displacement)) for n, r in runs}

several = ends()
with jax.default_device(jax.local_devices()[0]):
    one = ends()
assert several.keys() == one.keys() == set(range(7))
for n in one:
    assert several[n][:2] == one[n][:2] and np.array_equal(several[n][2], one[n][2]), n
assert len(set(status for status, *_ in one.values())) == 2
print("equal", len(seen) > 0)
"""


def test_lanes_over_devices_equal_those_of_one():
    flags = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=3"}
    ended = subprocess.run([sys.executable, "-c", CHILD], env=flags, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert ended.stdout == "equal True\n"
    assert "donated" not in ended.stderr


@pytest.mark.skipif(jax.local_device_count() > 1, reason="this machine has several devices")
def test_one_device_has_no_mesh():
    assert mesh_of(64) is None
