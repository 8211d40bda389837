"""Lanes over several devices give the results of one device, bit for bit; a machine with one pays nothing."""

import ast
import os
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run._devices import mesh_of

CHILD = """
import jax, numpy as np, jaxmpm as mpm
from jaxmpm.run._devices import devices_of, mesh_of
assert [len(devices_of(lanes)) for lanes in (None, 1, 2, 4, 5, 6)] == [3, 1, 2, 2, 1, 3]
assert [mesh_of(lanes) and mesh_of(lanes).size for lanes in (1, 2, 4, 5, 6)] == [None, 2, 2, None, 3]
soil = mpm.Soil(young=5e6, strength=9e3)
scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
seen = []

def ends():
    runs = mpm.solve_each(scene, state, {"strength": np.linspace(6e3, 30e3, 7)}, width=4, t_end=0.2, every=0.05,
        rules=[mpm.Exceeds(1e-3)], hooks=mpm.run.Hooks(observe=lambda n, t, midway: seen.append(t)))
    return {n: (int(r.status), int(r.state.step), np.asarray(r.state.displacement)) for n, r in runs}

several = ends()
with jax.default_device(jax.local_devices()[0]):
    one = ends()
    assert devices_of() == devices_of(6) == jax.local_devices()[:1]
with jax.default_device("cpu"):
    assert devices_of() == jax.local_devices()[:1]
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


PROCESS = """
import sys
import jax, numpy as np, jaxmpm as mpm
jax.distributed.initialize(sys.argv[1], num_processes=2, process_id=int(sys.argv[2]))
assert (jax.device_count(), jax.local_device_count()) == (4, 2)
soil = mpm.Soil(young=5e6, strength=9e3)
scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
strength, numbers = np.linspace(6e3, 30e3, 8), range(jax.process_index(), 8, jax.process_count())
runs = mpm.solve_each(scene, state, {"strength": strength[list(numbers)]}, numbers=numbers, width=2, t_end=0.2)
print({number: float(np.abs(result.state.displacement).max()) for number, result in runs})
"""


def test_processes_of_a_cluster_run_samples_of_their_own():
    """As docs/clusters.md has them, two on this machine with two devices each."""
    flags = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    asked = [sys.executable, "-c", PROCESS, address]
    processes = [
        subprocess.Popen([*asked, str(n)], env=flags, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for n in range(2)
    ]
    ended = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], [error[-2000:] for _, error in ended]
    moved = [ast.literal_eval(out.splitlines()[-1]) for out, _ in ended]  # what connects them prints lines before
    assert [sorted(of_process) for of_process in moved] == [[0, 2, 4, 6], [1, 3, 5, 7]]
    scene, state = mpm.column(4.0, mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,)))
    alone = mpm.solve_each(scene, state, {"strength": np.linspace(6e3, 30e3, 8)}, width=1, t_end=0.2)
    assert {n: float(np.abs(r.state.displacement).max()) for n, r in alone} == moved[0] | moved[1]


@pytest.mark.skipif(jax.local_device_count() > 1, reason="this machine has several devices")
def test_one_device_has_no_mesh():
    assert mesh_of(64) is None
