"""The native engine under sanitizers: whatever the positions, it stays within its arrays."""

from __future__ import annotations

import itertools
import platform
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import ROOT

NATIVE = ROOT / "jaxmpm" / "transfer" / "native"
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")

BASE = {"portable": []}
ALL = BASE | {
    "avx2": ["-mavx2", "-mfma"],
    "avx512": ["-mavx2", "-mfma", "-mavx512f", "-mavx512vl", "-mavx512dq", "-mavx512bw"],
}


def _build(folder: Path, sanitizers: str, sets: dict[str, list[str]]) -> Path:
    if COMPILER is None:
        pytest.skip("no C++ compiler to build the sanitized driver with")
    flags = ["-std=c++20", "-g1", f"-fsanitize={sanitizers}", "-fno-sanitize-recover=all", f"-I{NATIVE}", "-pthread"]
    flags += [f"-DJAXMPM_{name.upper()}" for name in sets]
    empty = folder / "empty.cc"
    empty.write_text("int main() {}\n")
    if subprocess.run([COMPILER, *flags, empty, "-o", folder / "empty"], capture_output=True).returncode:
        pytest.skip(f"{COMPILER} cannot build with -fsanitize={sanitizers}")
    objects = []
    for (name, machine), scalar in itertools.product(sets.items(), ("float", "double")):
        objects.append(folder / f"{name}_{scalar}.o")
        kernels = [f"-DJAXMPM_ISA={name}", f"-DJAXMPM_SCALAR={scalar}", *machine, "-c", NATIVE / "kernels.cc"]
        subprocess.run([COMPILER, *flags, *kernels, "-o", objects[-1]], check=True)
    driver = folder / "fuzz"
    sources = [NATIVE / "engine.cc", ROOT / "tests" / "native_fuzz.cc"]
    subprocess.run([COMPILER, *flags, *sources, *objects, "-o", driver], check=True)
    return driver


def _outcome(driver: Path, text: str) -> str:
    """What the driver printed: last, how many cases it got through, or what stopped it."""
    done = subprocess.run([driver], input=text, capture_output=True, text=True)
    if done.returncode == 0:
        return done.stdout
    return f"{done.stdout[-2000:]}{done.stderr[-4000:]}exit status {done.returncode}"


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _build(tmp_path_factory.mktemp("address"), "address", BASE)


odd = st.sampled_from(["nan", "inf", "-inf", "1e30", "-1e30", "4294967296", "-2147483649", "0", "-0", "0.5", "1e-40"])


@st.composite
def cases(draw: st.DrawFn) -> str:
    """A case as tests/native_fuzz.cc reads it."""
    dimension = draw(st.integers(1, 3))
    shape = [draw(st.integers(3, 7)) for _ in range(3)]
    near = st.floats(-3, 10).map(float.hex)
    on_knots = st.integers(-2, 20).map(lambda i: str(i / 2))
    pool = draw(st.lists(st.one_of(near, on_knots, odd), min_size=1, max_size=30))
    # Enough particles for many slabs now and then, the same few positions over and over.
    particles = draw(st.sampled_from([0, 1, 2, 31, 32, 33, 100, 4096, 4500]))
    numbers = [pool[(i * 7919) % len(pool)] for i in range(dimension * particles)]
    head = (dimension, *shape, draw(st.integers(0, 2)), draw(st.sampled_from([0.05, 0.25, 0.5])), particles, 3)
    return " ".join(map(str, (*head, *numbers)))


HURRIED = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large]}


@settings(max_examples=25, derandomize=True, **HURRIED)
@given(case=cases())
@pytest.mark.slow
def test_stays_within_its_arrays(driver: Path, case: str) -> None:
    assert _outcome(driver, case).endswith("1 cases\n")


@pytest.mark.slow
def test_every_instruction_set_stays_within_its_arrays(tmp_path: Path) -> None:
    sets = ALL if platform.machine() in ("x86_64", "AMD64") else BASE
    everywhere = _build(tmp_path, "address,undefined", sets)

    @settings(max_examples=200, **HURRIED)
    @given(case=cases())
    def fuzz(case: str) -> None:
        assert _outcome(everywhere, case).endswith("1 cases\n")

    fuzz()
