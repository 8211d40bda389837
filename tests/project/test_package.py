"""What the package says of itself, and the commands that help a newcomer: doctor and example."""

import itertools
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from importlib import import_module, metadata
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest
from packaging.requirements import Requirement

import jaxmpm
from cooperative import doctor
from cooperative.__main__ import main
from cooperative._arguments import COMMANDS, parser
from cooperative._commands import COMMANDS as FUNCTIONS
from cooperative.example_scenes import SCHEMA, example, examples
from cooperative.runs import _compiled, memory_mappings, release_programs
from cooperative.scene import json_schema, parse
from tests import ROOT

CMAKE = shutil.which("cmake")
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_one_version():
    assert jaxmpm.__version__ == metadata.version("jaxmpm")
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M)[1] == jaxmpm.__version__
    assert re.search(r"^## ([0-9.]+)", (ROOT / "CHANGELOG.md").read_text(), re.M)[1] == jaxmpm.__version__


def test_every_package_ships_and_says_that_it_is_typed():
    shipped = PROJECT["tool"]["scikit-build"]["wheel"]["packages"]
    for name in ("jaxmpm", "kl", "cooperative"):
        assert shipped[name] == name
        assert (ROOT / name / "py.typed").exists()


def test_no_file_has_what_a_later_python_warns_of():
    folders = ("jaxmpm", "kl", "cooperative", "benchmarks", "tests", "notebooks")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert len(files) > 200
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in files:
            compile(path.read_text(), str(path), "exec", dont_inherit=True)


@pytest.mark.parametrize("kind", ["oldest", "newest"])
def test_pinned_versions_are_those_that_the_package_allows(kind):
    text = (ROOT / "packaging" / f"constraints-{kind}.txt").read_text()
    pinned = [Requirement(line) for line in text.splitlines() if line and not line.startswith("#")]
    allowed = {r.name.replace("_", "-"): r for r in map(Requirement, PROJECT["project"]["dependencies"])}
    names = {each.name.replace("_", "-") for each in pinned}
    assert names >= allowed.keys()
    for each in pinned:
        (version,) = each.specifier
        assert version.operator == "=="
        if (wanted := allowed.get(each.name.replace("_", "-"))) is not None:
            assert wanted.specifier.contains(version.version)


def test_kernels_are_compiled_with_the_headers_of_the_oldest_jax():
    """A newer runtime takes them, an older one does not: with JAX 0.11.2 those of jaxlib 0.12 stopped every run."""
    (headers,) = [r for r in map(Requirement, PROJECT["build-system"]["requires"]) if r.name == "jaxlib"]
    (jax,) = [r for r in map(Requirement, PROJECT["project"]["dependencies"]) if r.name == "jax"]
    oldest = next(each.version for each in jax.specifier if each.operator == ">=")
    major, minor = map(int, oldest.split("."))
    assert headers.specifier.contains(f"{oldest}.0")
    assert not headers.specifier.contains(f"{major}.{minor + 1}.0")


def test_wheels_have_all_instruction_sets_and_checkouts_those_of_their_machine():
    """What the build is told where it makes an editable install, and nowhere else."""
    scikit = PROJECT["tool"]["scikit-build"]
    told = [each for each in scikit["overrides"] if "cmake" in each]
    assert told == [{"if": {"state": "editable"}, "cmake": {"define": {"JAXMPM_INSTRUCTIONS": "native"}}}]
    assert scikit["cmake"] == {"define": {"JAXMPM_INSTRUCTIONS": "all", "JAXMPM_CUDA": "auto"}}


@pytest.mark.skipif(CMAKE is None or COMPILER is None, reason="no CMake or no C++ compiler")
@pytest.mark.parametrize("asked", [[], ["-DJAXMPM_INSTRUCTIONS=native"]])
def test_the_build_compiles_the_instruction_sets_that_it_is_asked_for(asked, tmp_path):
    sources = [f"-DPython_EXECUTABLE={sys.executable}", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *asked]
    subprocess.run([CMAKE, "-S", ROOT, "-B", tmp_path, *sources], check=True, capture_output=True)
    commands = [each["command"] for each in json.loads((tmp_path / "compile_commands.json").read_text())]
    units = [
        (isa[1], re.search(r"JAXMPM_SCALAR=(\w+)", text)[1])
        for text in commands
        if (isa := re.search(r"JAXMPM_ISA=(\w+)", text))
    ]
    every = ["portable", "avx2", "avx512"] if platform.machine() in ("x86_64", "AMD64") else ["portable"]
    sets = [jaxmpm.transfer.native_instructions() or every[0]] if asked else every
    assert sorted(units) == sorted(itertools.product(sets, ("float", "double")))


@pytest.mark.skipif(CMAKE is None or COMPILER is None, reason="no CMake or no C++ compiler")
def test_the_build_refuses_instruction_sets_that_it_does_not_know(tmp_path):
    told = [CMAKE, "-S", ROOT, "-B", tmp_path, f"-DPython_EXECUTABLE={sys.executable}", "-DJAXMPM_INSTRUCTIONS=sse"]
    done = subprocess.run(told, capture_output=True, text=True)
    assert done.returncode
    assert "JAXMPM_INSTRUCTIONS = sse: give all or native" in done.stderr


@pytest.mark.skipif(CMAKE is None or COMPILER is None, reason="no CMake or no C++ compiler")
@pytest.mark.parametrize(
    ("plugin", "asked", "built"),
    [(False, "auto", False), (True, "auto", True), (True, "off", False), (False, "on", True)],
)
def test_kernels_for_gpus_are_built_where_jax_has_a_cuda_plugin(plugin, asked, built, tmp_path):
    """With nvcc on the machine: a checkout without a GPU does not wait for them, a wheel has none."""
    if built and shutil.which("nvcc") is None:
        pytest.skip("no nvcc")
    if plugin:
        (tmp_path / "jax_cuda13_plugin.py").touch()
    told = ["-S", ROOT, "-B", tmp_path / "build", f"-DPython_EXECUTABLE={sys.executable}", f"-DJAXMPM_CUDA={asked}"]
    surroundings = os.environ | {"PYTHONPATH": str(tmp_path)}
    told.append("-DCMAKE_EXPORT_COMPILE_COMMANDS=ON")
    subprocess.run([CMAKE, *told], check=True, capture_output=True, env=surroundings)
    units = {Path(each["file"]).name for each in json.loads((tmp_path / "build" / "compile_commands.json").read_text())}
    assert ({"cuda_kernels.cu", "cuda_order.cu", "cuda_ffi.cc"} <= units) == built


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize(("target", "extras"), [("demo", {"interactive"}), ("test", {"interactive", "test"})])
def test_a_target_installs_what_it_needs(target, extras):
    """By what make would do in a fresh clone: the checkout is always built by what .venv holds."""
    surroundings = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    told = ["make", "--dry-run", "--always-make", target]
    planned = subprocess.run(told, cwd=ROOT, env=surroundings, capture_output=True, text=True, check=True).stdout
    installs = [line for line in planned.splitlines() if "--editable" in line]
    assert {re.search(r"'\.\[(\w+)\]'", line)[1] for line in installs} == extras
    assert all("--no-build-isolation" in line for line in installs)
    assert re.search(r"install .*\bjax\b(?s:.*)--editable", planned)


def test_the_command_on_the_path_is_there():
    module, name = PROJECT["project"]["scripts"]["jaxmpm"].split(":")
    assert getattr(import_module(module), name) is main


def test_examples_are_the_scenes_that_ship(tmp_path, monkeypatch, capsys):
    source = ROOT / PROJECT["tool"]["scikit-build"]["wheel"]["packages"]["cooperative/scenes"]
    assert examples() == {path.stem: path for path in sorted(source.glob("*.toml"))}
    monkeypatch.chdir(tmp_path)
    assert main(["example", "demo"]) == 0
    assert capsys.readouterr().out == "demo.toml\nscene.schema.json\n"
    written = (tmp_path / "demo.toml").read_text()
    assert parse(written).name.startswith("demo")
    assert written == "#:schema ./scene.schema.json\n" + example("demo")
    assert json.loads((tmp_path / "scene.schema.json").read_text()) == json_schema()
    assert SCHEMA.parent == ROOT / PROJECT["tool"]["scikit-build"]["wheel"]["packages"]["cooperative"]
    assert main(["example", "demo"]) == 2
    assert "exists already" in capsys.readouterr().err
    with pytest.raises(ValueError, match="no example scene is called 'nope': give one of cho, cho_cphi, demo, "):
        example("nope")


def test_doctor_tells_what_it_runs_on_and_that_it_is_well(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_SECONDS", 0.01)
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    for name in ("jaxmpm", "jax", "transfers on CPU", "C++ compiler", "cores", "device", "column at rest", "a step"):
        assert re.search(rf"^{re.escape(name)}: +\S", printed, re.M)
    held, allowed = memory_mappings()
    assert re.search(rf"^memory mappings: +[\d,]+ of the {allowed:,} that a process may hold", printed, re.M)
    assert 0 < held < allowed
    assert printed.endswith("well\n")


def test_nothing_is_released_where_the_system_gives_no_number_of_mappings(monkeypatch, tmp_path):
    monkeypatch.setattr(_compiled, "MAPPINGS", tmp_path / "none")
    assert memory_mappings() is None
    assert not release_programs(most=0)
    assert dict(doctor.installation())["memory mappings"] == "this system gives neither their number nor a limit"


@pytest.mark.parametrize(("kind", "untimed"), [("NVIDIA H100 80GB HBM3", False), ("NVIDIA A100-SXM4-40GB", True)])
def test_doctor_says_which_gpu_nobody_has_timed(kind, untimed, monkeypatch):
    monkeypatch.setattr(doctor.jax, "devices", lambda: [SimpleNamespace(platform="gpu", device_kind=kind)])
    assert dict(doctor.installation())["device"] == f"gpu: {kind}" + " (the solver runs here, untimed)" * untimed


@pytest.mark.skipif(not jaxmpm.transfer.native_available(), reason="native kernels were not built")
@pytest.mark.parametrize("wrong", ["sums", "gathers", "derivatives"])
def test_doctor_compares_each_transfer(wrong, monkeypatch):
    sound = doctor.transferred

    def transferred(*arguments, engine):
        found = sound(*arguments, engine=engine)
        off = 1 + 1e-5 * (engine is jaxmpm.Engine.NATIVE)
        return found | {wrong: jax.tree.map(lambda a: a * off, found[wrong])}

    assert doctor.engines_apart() < doctor._APART
    monkeypatch.setattr(doctor, "transferred", transferred)
    assert doctor.engines_apart() == pytest.approx(1e-5, rel=0.1)


@pytest.mark.parametrize("errors", [(0.02, 0.0), (0.0, 0.06), (float("nan"), 0.0)])
def test_doctor_finds_wrong_answers(errors, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "column_errors", lambda: errors)
    monkeypatch.setattr(doctor, "step_speed", lambda: (1, 1, 1.0))
    assert main(["doctor"]) == 2
    assert "NOT WELL" in capsys.readouterr().out


def test_a_shell_completes_commands_and_files(capsys):
    shtab = pytest.importorskip("shtab")
    assert main(["completion", "bash"]) == 0
    printed = capsys.readouterr().out
    assert "--refined-runs" in printed
    assert "completion" in printed
    assert shtab.FILE["bash"] in printed


def test_completion_says_what_it_needs(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert "pip install shtab" in capsys.readouterr().err


def help_of(capsys, *arguments):
    """What a command says when it is asked for help, its lines joined."""
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--help"])
    assert ended.value.code == 0
    return " ".join(capsys.readouterr().out.split())


def test_help_has_examples_and_exit_codes(capsys):
    printed = help_of(capsys)
    for name, (_, arguments, what) in COMMANDS.items():
        assert f"jaxmpm {name} {arguments}".strip() + f" {what}" in printed
    assert "exit codes: 0" in printed
    assert "named in one line, or wrong answers in doctor's self-check; 130" in printed


def test_every_command_has_an_example_which_it_takes():
    (commands,) = parser()._subparsers._group_actions
    assert set(COMMANDS) == set(commands.choices) == set(FUNCTIONS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_ends_with_its_example(name, capsys):
    typed = shlex.split(help_of(capsys, name).rpartition("example: ")[2])
    assert typed[:2] == ["jaxmpm", name]
    assert parser().parse_args(typed[1:]).command == name
