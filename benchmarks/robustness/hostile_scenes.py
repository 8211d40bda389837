"""Scenes that nobody should write, made from the schema, and how the campaign's command ends on each.

A scene ends well when its campaign begins its first run or calibration, or when it is refused. `tried` asks
one process after the other, under a limit of memory; a process that dies or hangs is named and replaced. `python -m
benchmarks.robustness.hostile_scenes` is that process: a scene as JSON in each line of its input, an answer in each of
its output."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import resource
import selectors
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT
from benchmarks.robustness.invented import CALIBRATED, SCENE, SUBSET
from cooperative.scene import TABLES, tables, to_toml

MEMORY = 4 * 2**30
"""Bytes of address space that a scene may take beyond what the process has before."""

PATIENCE = 120.0
"""Seconds after which a process that does not answer counts as hanging; generous, for machines under load."""

ODD: tuple[Any, ...] = (
    0, -1, 1, 2**63, 2**70, -(2**64), 10**12, 0.0, -0.0, -1.0, 1e-300, 1e-9, 1e30, 1e300, float("nan"), float("inf"),
    float("-inf"), True, False, "", "none", "cell", "two-phase", "\n[run]", "\x1b[2J", "x" * 5000, "\u202e", [], [1.0],
    [1.0, 2.0, 3.0], [0.0, 0.0], [1e30, 1e-30], [float("nan"), 1.0], ["a", "b"], [[1.0], [2.0]], {}, {"a": 1},
    "/etc/passwd", "../../../../etc/passwd", "/dev/zero", "=cmd|' /C calc'!A0", "$x_{",
)  # fmt: skip
LATER = ("hazard", "exposed", "sweep")
"""Tables that the scenes are not made from."""
HUGE = {
    "height": 1e6, "crest": 1e9, "toe": 1e12, "foundation": 1e7, "run_per_rise": 1e8, "width": 1e7, "samples": 10**12,
    "levels": 10**9, "replicates": 10**9, "cell": 1e-3, "spacing": [1e-4, 1e-4], "lanes": 10**9, "look_ahead": 10**9,
    "length": [1e-4, 1e-4], "t_end": 1e12, "young": 1e30, "cov": 1e30, "energy": 1.0, "k_t": 10**15,
    "refined_runs": 10**12, "cfl": 1e-12, "unit_weight": 1e-30,
}  # fmt: skip
WORDS = ("name", "slope", "soil", "rough", "sweep", "calibration", "__class__", "a.b", "é", "", "height ")
TEXTS = (
    "[" * 2000,
    "a = " + "[" * 3000,
    "\x00",
    "\ufeff",
    "= 1",
    "[slope]\n[slope]",
    "a" * 200_000,
    f"[{'k' * 300_000}]\na = [{'1,' * 150_000}]",
    '"""',
    "\\u0000",
)


@dataclass(frozen=True)
class Answer:
    """The end of a scene.

    Attributes:
        how: "began", "refused", or what is wrong ("traceback", "noise", "died", "hung").
        message: the end of its standard error.
        seconds: of processor time until then.
    """

    how: str
    message: str
    seconds: float

    @property
    def well(self) -> bool:
        """Whether this is how a scene may end."""
        return self.how in ("began", "refused")


def scenes(count: int, seed: int = 0) -> Iterator[str]:
    """So many scenes, the same for the same seed."""
    generator = random.Random(seed)
    for _ in range(count):
        scene: dict[str, Any] = tomllib.loads(generator.choice((SCENE, SCENE, SUBSET, CALIBRATED)))
        for _ in range(generator.choice((1, 1, 1, 2, 3))):
            _change(scene, generator)
        text = to_toml(scene)
        if generator.random() < 0.1:
            at = generator.randrange(len(text))
            text = text[:at] + generator.choice((*TEXTS, "")) + text[at + generator.randrange(3) :]
        yield text


def _change(scene: dict[str, Any], generator: random.Random) -> None:
    """One change: a key gone, unknown or odd; a table gone, unknown or no table."""
    section = generator.choice([name for name in TABLES if name not in LATER])
    table, keys = scene.get(section), list(tables.keys(TABLES[section]))
    kind = generator.random()
    if not isinstance(table, dict):
        scene[section] = {}
    elif kind < 0.05:
        del scene[section]
    elif kind < 0.1:
        scene[generator.choice((section, *WORDS))] = generator.choice(ODD)
    elif kind < 0.15:
        table[generator.choice(WORDS)] = generator.choice(ODD)
    elif kind < 0.25 and table:
        del table[generator.choice(list(table))]
    elif kind < 0.45:
        key = generator.choice([key for key in keys if key in HUGE] or keys)
        table[key] = HUGE.get(key, generator.choice(ODD))
    else:
        key = generator.choice(keys)
        schema = tables.schema_of(TABLES[section])["properties"][key]
        table[key] = _value(schema, table.get(key), generator)


def _value(schema: Any, now: Any, generator: random.Random) -> Any:
    """A value for a key: of its kind now and then, odd otherwise."""
    if generator.random() < 0.6:
        return generator.choice(ODD)
    if "enum" in schema:
        return generator.choice(schema["enum"])
    if schema.get("type") == "boolean":
        return generator.random() < 0.5
    if schema.get("type") == "integer":
        return generator.choice((1, 2, 3, 10, 20, 40, 80, 160))
    factor = generator.choice((1e-3, 0.5, 2.0, 1e3))
    return [number * factor for number in now] if isinstance(now, list) else (now or 1.0) * factor


def tried(texts: Iterable[str]) -> Iterator[tuple[str, Answer]]:
    """Each scene with what came of it."""
    reader: _Reader | None = None
    try:
        for text in texts:
            reader = reader or _Reader()
            answer = reader.answer(text)
            if answer.how in ("died", "hung"):
                reader.end()
                reader = None
            yield text, answer
    finally:
        if reader is not None:
            reader.end()


class _Reader:
    """A process that reads scenes."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, cwd=ROOT,
        )  # fmt: skip

    def answer(self, text: str) -> Answer:
        """Its answer, or what became of it."""
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(text) + "\n")
            process.stdin.flush()
        except BrokenPipeError:
            return Answer("died", "before it read the scene", 0.0)
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if not selector.select(PATIENCE):
                return Answer("hung", f"no answer in {PATIENCE:g} s", PATIENCE)
        line = process.stdout.readline()
        if not line:
            return Answer("died", f"exit status {process.wait()}", 0.0)
        return Answer(**json.loads(line))

    def end(self) -> None:
        """End the process, if it has not ended."""
        self.process.kill()
        self.process.communicate()


class Began(BaseException):
    """The campaign came to its first run or calibration."""


def _began(*_: Any, **__: Any) -> Any:
    raise Began


def answer_in_process(text: str, folder: Path) -> Answer:
    """What `python -m cooperative run` does with a scene in this process, whose runs `main` has made raise `Began`."""
    from cooperative.__main__ import main as command

    scene, out = folder / "scene.toml", folder / "out"
    scene.write_bytes(text.encode("utf-8", "surrogatepass"))
    errors, before = io.StringIO(), time.process_time()
    try:
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
            status = command(["run", str(scene), "--out", str(out), "--workers", "1"])
        how = "refused" if status == 2 else "traceback"
    except Began:
        how = "began"
    except BaseException:
        how = "traceback"
        errors.write(traceback.format_exc())
    seconds = time.process_time() - before
    message = _without_warnings(errors.getvalue())
    if how == "refused" and not _in_words(message):
        how = "noise"
    if how == "refused" and any(path for path in out.rglob("*") if path.is_file() and path.name != ".lock"):
        how, message = "noise", f"the scene was refused, and its folder written: {message}"
    return Answer(how, message[-1500:], round(seconds, 2))


def _in_words(message: str) -> bool:
    """Whether a refusal is one line, or a line for each fault, of characters that can be printed."""
    printable = all(map(str.isprintable, message.splitlines()))
    return printable and message.startswith("error: ") and "Traceback" not in message


def _without_warnings(message: str) -> str:
    """Standard error of a command without warnings, which have a line each."""
    return "".join(line for line in message.splitlines(keepends=True) if not line.startswith("warning: ")).removesuffix(
        "\n"
    )


def by_command_line(text: str, folder: Path) -> Answer:
    """How the command, in a process of its own, ends on a scene that it refuses."""
    scene = folder / "by_command_line.toml"
    scene.write_bytes(text.encode("utf-8", "surrogatepass"))
    command = [sys.executable, "-m", "cooperative", "run", str(scene), "--out", str(folder / "refused")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
    message = _without_warnings(done.stderr)
    well = done.returncode == 2 and _in_words(message)
    return Answer("refused" if well else "traceback", message[-1500:], 0.0)


def main() -> None:
    """Answer for each scene of the input."""
    from cooperative import runs
    from cooperative.scene import factors_of_safety, measure_limit_load

    for module in [module for name, module in sys.modules.items() if name.split(".")[0] == "cooperative"]:
        for real in (runs.run_samples, factors_of_safety, measure_limit_load):
            if vars(module).get(real.__name__) is real:
                setattr(module, real.__name__, _began)
    answers, sys.stdout = sys.stdout, sys.stderr
    limited = False
    for line in sys.stdin:
        with tempfile.TemporaryDirectory() as folder:
            answer = answer_in_process(json.loads(line), Path(folder))
        if not limited and answer.how == "began":
            # What the process needs for any scene is there by now.
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            most = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
            limited = True
        print(json.dumps(asdict(answer)), file=answers, flush=True)


if __name__ == "__main__":
    main()
