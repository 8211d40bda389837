"""How many faults, put one at a time into the packages, do the tests notice?

A mutant is the code with one operator, number, `not`, `return`, or choice of the least or the largest changed. `count`
of all mutants of the rooms in TESTS are drawn by a seed, each is put into a copy of the repository, and tests run until
one fails. It is killed if that test passes without it. What it does to tests that did not run nobody knows: there run
at most FILES files, of the folder that TESTS names for its room and of its package where they name what its module
offers. `survived` means that it survived the tests of its room. It may survive because it changes nothing.

What runs on GPUs alone has no mutants. `--only` takes beginnings of their names. A command that was stopped goes on
where it was, and one after tests have changed tries the survivors again.
"""

from __future__ import annotations

import ast
import itertools
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT, Report, beginning_so, code_digest, stored_row
from jaxmpm.transfer import native

TESTS = {
    "jaxmpm/laws": "tests/jaxmpm/laws",
    "jaxmpm/equations": "tests/jaxmpm/step",
    "jaxmpm/transfer": "tests/jaxmpm/step",
    "jaxmpm/run": "tests/jaxmpm/run",
    "kl": "tests/kl",
    "cooperative/estimate": "tests/cooperative/estimate",
    "cooperative/measure": "tests/cooperative/effects",
}
"""Rooms that mutants are drawn from, and the tests of each."""

ON_GPUS = "jaxmpm/transfer/native/cuda.py"

COMPILE = {"test_cuda.py", "test_native_fuzz.py"}
"""Tests of C++ alone, which take minutes to compile: none runs for a mutant."""

FILES = 8
"""Most test files that run for a mutant."""

LIMIT = 900.0
"""Most seconds for a mutant."""

LATE = "out of time"

OPERATORS: dict[type[ast.AST], tuple[Any, ...]] = {
    **{ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt)},
    **{ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,)},
    **{ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,)},
    **{ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Pow: (ast.Mult,)},
    **{ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,)},
}
CHOICES = {"minimum": "maximum", "min": "max", "argmin": "argmax", "any": "all", "floor": "ceil"}
CHOICES |= {other: one for one, other in CHOICES.items()}

CLEAR = """import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
"""
"""`sitecustomize.py` of the copy: without it an editable install finds the packages of the checkout."""


@dataclass(frozen=True)
class Mutant:
    """One changed expression of a file. span: its bytes in the file; inside: names of the functions and classes that
    the change stands in; change: what became of what."""

    path: str
    name: str
    span: tuple[int, int]
    text: str
    inside: tuple[str, ...]
    change: str

    def put(self, source: bytes) -> bytes:
        """The file with the change."""
        return source[: self.span[0]] + self.text.encode() + source[self.span[1] :]


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in place of a node."""
    match node:
        case ast.Compare(left, ops, right):
            for at, operator in enumerate(ops):
                for other in OPERATORS[type(operator)]:
                    yield ast.Compare(left, [*ops[:at], other(), *ops[at + 1 :]], right)
        case ast.BinOp(left, operator, right):
            yield from (ast.BinOp(left, other(), right) for other in OPERATORS.get(type(operator), ()))
        case ast.BoolOp(operator, values):
            yield from (ast.BoolOp(other(), values) for other in OPERATORS[type(operator)])
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Constant(bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(float(value)):
            yield ast.Constant(2 * value or 1.0)
        case ast.Return(ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield ast.Return(ast.Constant(None))
        case ast.Name(name, ast.Load()) if name in CHOICES:
            yield ast.Name(CHOICES[name], ast.Load())
        case ast.Attribute(value, name, ast.Load()) if name in CHOICES:
            yield ast.Attribute(value, CHOICES[name], ast.Load())


def mutants_of(path: str, text: str) -> list[Mutant]:
    """All mutants of a file, but of its types and its messages."""
    starts = [0, *itertools.accumulate(len(line) for line in text.encode().splitlines(keepends=True))]
    found: list[Mutant] = []
    count: dict[int, Iterator[int]] = {}

    def visit(node: Any, inside: tuple[str, ...]) -> None:
        for changed in changes(node):
            span = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
            new = ast.unparse(changed)
            number = next(count.setdefault(node.lineno, itertools.count(1)))
            closed = new if isinstance(node, ast.Return | ast.Attribute | ast.Name) else f"({new})"
            change = f"{ast.unparse(node)} -> {new}"
            found.append(Mutant(path, f"{path}:{node.lineno}.{number}", span, closed, inside, change))
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside = (*inside, node.name)
        for name, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if name not in ("annotation", "returns") and not isinstance(child, ast.Raise | ast.JoinedStr):
                    visit(child, inside) if isinstance(child, ast.AST) else None

    visit(ast.parse(text), ())
    return found


def drawn(seed: int, count: int) -> list[Mutant]:
    """So many of all mutants of the rooms, in order of their draw."""
    paths = (path for room in TESTS for path in sorted((ROOT / room).rglob("*.py")))
    names = (str(path.relative_to(ROOT)) for path in paths)
    every = [mutant for name in names if name != ON_GPUS for mutant in mutants_of(name, (ROOT / name).read_text())]
    return random.Random(seed).sample(every, count)


def files_for(mutant: Mutant, root: Path) -> list[str]:
    """The test files of a repository that run for a mutant, in their order.

    A file that names the function or class the change stands in comes before one that does not, one of its own room
    before one of its package, one that names more of its module before one that names less, and a short one first.
    """
    room = next(room for room in TESTS if mutant.path.startswith(f"{room}/"))
    module = ast.parse((root / mutant.path).read_text()).body
    offered = {node.name for node in module if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    ranked = []
    for path in (root / "tests" / room.split("/")[0]).rglob("test_*.py"):
        name, text = str(path.relative_to(root)), path.read_text()
        words = set(re.findall(r"\w+", text))
        own = name.startswith(f"{TESTS[room]}/")
        if path.name not in COMPILE and (own or words & offered):
            ranked.append((words.isdisjoint(mutant.inside[:1]), not own, -len(words & offered), text.count("\n"), name))
    return [name for *_, name in sorted(ranked)[:FILES]]


@dataclass(frozen=True)
class Copy:
    """A copy of the repository in which mutants live."""

    folder: Path

    def fill(self) -> None:
        """Copy the files under version control as they stand, the compiled kernels and stored programs.

        Raises:
            RuntimeError: If Python would import other packages than the copy's.
        """
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, listed.split("\0")):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, self.folder / name)
        if (kernels := native.library()) is not None:
            shutil.copy2(kernels, self.folder / "jaxmpm" / "transfer" / "native" / kernels.name)
        if (ROOT / ".cache").is_dir():
            shutil.copytree(ROOT / ".cache", self.folder / ".cache", ignore=shutil.ignore_patterns("bytecode"))
        (self.folder / "sitecustomize.py").write_text(CLEAR)
        command = [sys.executable, "-c", "import jaxmpm; print(jaxmpm.__file__)"]
        at = subprocess.run(command, cwd=self.folder, env=self._environment(), capture_output=True, text=True).stdout
        if not at.startswith(str(self.folder)):
            raise RuntimeError(f"tests of {self.folder} import {at.strip()}: uninstall jaxmpm, or run from a checkout")

    def _environment(self) -> dict[str, str]:
        outer = {name: value for name, value in os.environ.items() if name != "JAXMPM_TEST_SESSION"}
        return outer | {"PYTHONPATH": str(self.folder)}

    def failed(self, tests: Sequence[str], *options: str, limit: float | None = None) -> list[str]:
        """The tests that fail, or LATE for a time limit; "no test" where none can start."""
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options, *tests]
        process = subprocess.Popen(
            command, cwd=self.folder, env=self._environment(), start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            told = process.communicate(timeout=limit)[0]
        except subprocess.TimeoutExpired:
            return [LATE]
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
        named = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", told, re.M)
        return [] if process.returncode in (0, 5) else named or ["no test"]  # 5: nothing to run

    def tried(self, mutant: Mutant, tests: Sequence[str], without: Sequence[str] = ()) -> dict[str, Any]:
        """Run tests, but for some, with the mutant; what became of it, and what told."""
        path, start = self.folder / mutant.path, time.perf_counter()
        source = path.read_bytes()
        path.write_bytes(mutant.put(source))
        try:
            told = self.failed(tests, "-x", *(f"--deselect={test}" for test in without), limit=LIMIT)
        finally:
            path.write_bytes(source)
        fate = LATE if told == [LATE] else "killed" if told else "survived"
        seconds = round(time.perf_counter() - start, 1)
        return {"mutant": mutant.name, "change": mutant.change, "fate": fate, "by": "".join(told[:1]), "s": seconds}


def fates(copy: Copy, mutants: Sequence[Mutant], stored: Path) -> list[dict[str, Any]]:
    """What became of each, kept in a folder; a test that fails without a mutant too tells nothing."""
    without: list[str] = []
    while True:
        rows = [_row(stored, copy, mutant, without) for mutant in mutants]
        telling = sorted({row["by"] for row in rows if "::" in row["by"]})
        broken = copy.failed(telling) if telling else []
        if not broken:
            return [{key: value for key, value in row.items() if key != "tests"} for row in rows]
        if not set(broken) <= set(telling):
            raise RuntimeError(f"{broken[0]} where these run without a mutant: {' '.join(telling)}")
        without += broken
        for row in rows:
            if row["by"] in broken:
                _file(stored, row["mutant"]).unlink()


def run(quick: bool, seed: int = 60, count: int = 200, only: Sequence[str] = ()) -> Report:
    """Try them; `quick` draws two of them."""
    names: Mapping[str, Mutant] = {mutant.name: mutant for mutant in drawn(seed, count)[: 2 if quick else None]}
    names = beginning_so(names, only) if only else names
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the tests and the copy too, as Ctrl-C does
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder).resolve() / "repository")
        copy.fill()
        rows = fates(copy, [*names.values()], ROOT / "out" / "mutants" / code_digest(folders=TESTS))
    values = {name: sum(row["fate"] == name for row in rows) for name in ("killed", "survived", LATE)}
    return Report({"mutants": len(rows)} | {name.replace(" ", "_"): value for name, value in values.items()}, rows)


def _row(stored: Path, copy: Copy, mutant: Mutant, without: Sequence[str]) -> dict[str, Any]:
    """What became of a mutant, as stored or now; now where it survived other tests, or what killed it is gone."""
    file, tests = _file(stored, mutant.name), code_digest(folders=["tests"])
    if file.is_file():
        row = json.loads(file.read_text())
        test, _, name = row["by"].partition("::")
        text = (copy.folder / test).read_text() if name and (copy.folder / test).is_file() else ""
        gone = name and f"def {name.partition('[')[0]}(" not in text
        if gone or (row["fate"] != "killed" and row["tests"] != tests):
            file.unlink()
    row = stored_row(
        stored, file.stem, lambda: copy.tried(mutant, files_for(mutant, copy.folder), without) | {"tests": tests}
    )
    print(f"{mutant.name} {row['fate']}: {mutant.change}", file=sys.stderr, flush=True)
    return row


def _file(stored: Path, name: str) -> Path:
    return stored / f"{name.replace('/', '-')}.json"
