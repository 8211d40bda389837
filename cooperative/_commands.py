"""The commands: site, new, check, draw, fos, run, resume, status, report, export, sweep, example, doctor, complete."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import jax

from cooperative import campaign, doctor, runs
from cooperative.folder import SLIDES
from cooperative.reporting import _exports as exports
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import draw, progress_of, report, watched, words, words_of_cost
from cooperative.scene import (
    Campaign,
    begin,
    campaigns_of,
    examples,
    parse,
    read_scene,
    starters,
    write_example,
)
from cooperative.store import GRIDS, Source, own_folder, read_store
from cooperative.tools import site, sweep
from jaxmpm import __version__
from jaxmpm.support.extras import extra
from jaxmpm.support.text import printable

CLEAR = "\x1b[2J\x1b[H"
"""Has a terminal begin an empty screen."""
LONGEST_TRIAL = 3600.0
"""Seconds of a trial at most; it shows no more after ten."""
Command = Callable[[argparse.Namespace], None]


def default_workers() -> int:
    """One process per core on CPU; on other devices, or without any, one process for all lanes."""
    return len(runs.cores_to_use()) if not runs.missing_device() and jax.default_backend() == "cpu" else 1


def run(given: argparse.Namespace) -> None:
    """Run a campaign of a scene, or go on where it was."""
    scene = _scene(given)
    for remark in runs.warnings_of(parse(scene)):
        warnings.warn(remark, stacklevel=2)
    _run(scene, given.out, given)


def _scene(given: argparse.Namespace) -> Source:
    """The scene that a command is given, with its files."""
    return read_scene(given.scene, outside=given.allow_outside)


def resume(given: argparse.Namespace) -> None:
    """Go on with a campaign from its folder, which holds its scene."""
    _run(read_store(given.folder).source, given.folder, given)


def _run(scene: Source, folder: Path, given: argparse.Namespace) -> None:
    with runs.stop_by_signals(ends_process=True):
        executor = None if given.dask is None else runs.dask_executor(given.dask)
        campaign.run(
            scene, folder, workers=given.workers, executor=executor, refined_runs=given.refined_runs,
            slides_t_end=given.slides_t_end, progress=True, verify=given.verify,
        )  # fmt: skip
    print(report(folder))


def status(given: argparse.Namespace) -> None:
    """Say how far a campaign is; it may be running."""
    if given.watch is None:
        print(words(progress_of(given.folder)))
        return
    for now in watched(given.folder, given.watch):
        # A terminal shows each in place of the one before.
        print(f"{CLEAR if sys.stdout.isatty() else ''}{now}", flush=True)


def show(given: argparse.Namespace) -> None:
    """Write report.html with all figures of a campaign, and print its summary."""
    print(report(given.folder, slides=given.slides, again=given.again))


def export(given: argparse.Namespace) -> None:
    """Write what a campaign holds for other programs: tables, series for ParaView, hazard maps, netCDF."""
    if given.sample is None and given.frames is not None:
        raise ValueError(f"--frames {given.frames} is for one sample: give --sample too")
    if given.sample is not None and given.kinds:
        raise ValueError(f"--as {given.kinds[0]} is for the whole campaign: leave out --sample, which writes particles")
    if given.sample is None:
        for path in exports.export(given.folder, given.kinds):
            print(path)
    else:
        print(exports.export_sample(given.folder, given.sample, given.grid, frames=given.frames))


def sweep_over(given: argparse.Namespace) -> None:
    """Run a campaign for each value of each parameter in the scene's [sweep], or go on where it was."""
    with runs.stop_by_signals(ends_process=True):
        sweep.run(_scene(given), given.out, workers=given.workers, progress=True)
    print(f"{given.out / 'sweep.json'}, {given.out / 'sweep.csv'}, figures in {given.out / 'figures'}")


def estimate(given: argparse.Namespace) -> None:
    """Estimate layers and random soil of soundings and laboratory values, and write them for a scene."""
    print(*site.answer(given), sep="\n")


def new(given: argparse.Namespace) -> None:
    """Write a commented scene of your own to fill in, and the schema for editors beside it."""
    for path in begin(given.kind, given.out or Path(f"{given.kind}.toml")):
        print(path)


def check(given: argparse.Namespace) -> None:
    """Read a scene and say what it will cost on this machine, from a trial of ten seconds."""
    if not 0 < given.seconds <= LONGEST_TRIAL:
        raise ValueError(f"--seconds {given.seconds:g}: give more than 0 and at most {LONGEST_TRIAL:g}")
    scene, *others = _campaigns(given)
    for each in (scene, *others):
        runs.check_size(each)
    print("\n".join(map(printable, words_of_cost(scene, runs.cost_of(scene, given.seconds)))))
    if others:
        print(f"  sweep          {1 + len(others)} campaigns, each of about this time")


def _campaigns(given: argparse.Namespace) -> list[Campaign]:
    """The campaign of a scene; of a sweep all, and a line about the first one."""
    campaigns = campaigns_of(_scene(given))
    if len(campaigns) > 1:
        base = "This is its base; `jaxmpm sweep` runs all of them."
        print(f"{given.scene} is a sweep of {len(campaigns)} campaigns. {base}")
    return campaigns


def sketch(given: argparse.Namespace) -> None:
    """Draw a scene: ground, layers, water, walls, exposed places, and one random field on both grids."""
    scene = _campaigns(given)[0]
    suffixes = (".png", ".html") if scene.dimension == 3 and interactive.installed() else (".png",)
    paths = [given.out] if given.out else [given.scene.with_suffix(suffix) for suffix in suffixes]
    draw(scene, *paths, sample=given.sample)
    print(*paths, sep="\n")


def stability(given: argparse.Namespace) -> None:
    """Compute a slope's factor of safety, by limit equilibrium in seconds and by the solver's limit load."""
    from cooperative.tools import safety  # which imports matplotlib

    scene, start = _campaigns(given)[0], time.perf_counter()
    # A scene's folder may come from somebody else, with a link of this name.
    folder = given.out or own_folder(given.scene.with_name(f"{given.scene.stem}-fos"))

    def announce(result: safety.Safety) -> None:
        print(*map(printable, safety.lines_of_equilibrium(scene.name, result)), sep="\n", flush=True)

    def progress(factors: Sequence[float], displacements: Sequence[float]) -> None:
        print(safety.progress_line(factors, displacements, time.perf_counter() - start), file=sys.stderr, flush=True)

    result = safety.factor_of_safety(
        scene, k_h=given.k_h, water=given.water, sample=given.sample, grid=given.grid, solver=not given.quick,
        progress=progress, announce=announce,
    )  # fmt: skip
    print(*map(printable, safety.lines_of_solver(result)), *safety.write_safety(result, scene, folder), sep="\n")


def example(given: argparse.Namespace) -> None:
    """Write an example scene to start from, and the schema for editors beside it."""
    for path in write_example(given.name, given.out or Path(f"{given.name}.toml")):
        print(path)


def examine(given: argparse.Namespace) -> None:
    """Say what this installation is, and check in seconds that it computes what it should."""
    if not doctor.examine():
        raise ValueError("the self-check did not pass: see above")


def complete(given: argparse.Namespace) -> None:
    """Print a script that has a shell complete commands, options and files; needs the extra completion."""
    shtab = extra("shtab", "shtab is not installed")
    whole = parser()
    for command in whole._subparsers._group_actions[0].choices.values():  # type: ignore[union-attr]
        for argument in command._actions:
            if argument.type is Path:
                argument.complete = shtab.FILE
    print(shtab.complete(whole, given.shell))


EXAMPLES = {
    "site": ("cpt-1.gef cpt-2.gef --n-kt 14 2 --out site", "layers and random soil of soundings, for a scene"),
    "example": ("demo", "write demo.toml"),
    "new": ("--kind section", "write section.toml, a scene of your own to fill in"),
    "check": ("section.toml", "what it will cost"),
    "draw": ("section.toml", "see it, as section.png; in 3D with plotly also as a page that turns"),
    "fos": ("section.toml --quick", "its factor of safety by limit equilibrium, in seconds"),
    "run": ("demo.toml --out out/demo", "run it, or go on where it was"),
    "status": ("out/demo --watch", "how far it is, from another terminal, until it ends"),
    "resume": ("out/demo --refined-runs 40", "go on, and allow more refined runs than its scene"),
    "report": ("out/demo", "write report.html again"),
    "export": ("out/demo", "write what it holds for other programs"),
    "sweep": ("sweep.toml --out out/sweep", "a campaign for each value in the scene's [sweep]"),
    "doctor": ("", "is all well here?"),
    "completion": ("bash", "print what has this shell complete commands"),
}
"""Of each command: arguments, and what it then does."""

EXIT_CODES = """
exit codes: 0 done; 2 a scene, folder or argument that cannot be used, named in one line, or wrong answers in doctor's
self-check; 130 stopped by Ctrl-C, 143 by SIGTERM. Then the same run, resume or sweep goes on from what is finished.
"""

TAKES = {"scene": "scene in TOML", "folder": "folder of the campaign"}
"""Files and folders that commands take, in words."""


def _typed(name: str) -> str:
    """The example of a command as one types it."""
    return f"jaxmpm {name} {EXAMPLES[name][0]}".rstrip()


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments."""
    lines = "\n".join(f"  {_typed(name):<45} {what}" for name, (_, what) in EXAMPLES.items())
    whole = argparse.ArgumentParser(
        prog="jaxmpm",
        description="Campaigns of random slopes.",
        epilog=f"examples:\n{lines}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"jaxmpm {__version__}")
    commands = whole.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, does: Command, *takes: str) -> argparse.ArgumentParser:
        epilog = f"example: {_typed(name)}"
        added = commands.add_parser(name, help=does.__doc__, description=does.__doc__, epilog=epilog)
        added.set_defaults(does=does)
        for each in takes:
            added.add_argument(each, type=Path, help=TAKES[each])
        if "scene" in takes:
            added.add_argument(
                "--allow-outside", action="store_true", help="let the scene name files outside its folder"
            )
        return added

    first, again, sweeps = (
        command("run", run, "scene"),
        command("resume", resume, "folder"),
        command("sweep", sweep_over, "scene"),
    )
    for begun in (first, sweeps):
        begun.add_argument("--out", type=Path, required=True, help="folder to write to")
    for heavy in (first, again, sweeps):
        heavy.add_argument(
            "--workers", type=int, default=default_workers(), help="samples to run at a time (%(default)s)"
        )
    for each in (first, again):
        each.add_argument("--dask", metavar="ADDRESS", help="run them on the Dask cluster of this scheduler")
        each.add_argument(
            "--refined-runs",
            type=int,
            metavar="RUNS",
            help="allow more than the scene does; the folder keeps it",
        )
        each.add_argument(
            "--slides-t-end",
            type=float,
            metavar="SECONDS",
            help="let slides that had not come to rest go on until then; the folder keeps it",
        )
        each.add_argument(
            "--verify",
            action="store_true",
            help="read the files of all finished samples anew, unchanged ones too, and solve for the stress at rest",
        )
    looks = command("status", status, "folder")
    looks.add_argument(
        "--watch",
        type=float,
        nargs="?",
        const=5.0,
        metavar="SECONDS",
        help="say it again every so many seconds (5) until the campaign ends",
    )
    shows = command("report", show, "folder")
    shows.add_argument("--slides", type=int, default=SLIDES, help="slides drawn at several times (%(default)s)")
    shows.add_argument("--again", action="store_true", help="run these samples again and draw more moments")
    writes = command("export", export, "folder")
    writes.add_argument(
        "--as",
        dest="kinds",
        nargs="+",
        choices=exports.KINDS,
        metavar="KIND",
        help=f"{', '.join(exports.KINDS)} (the first {len(exports.DEFAULT)})",
    )
    writes.add_argument("--sample", type=int, help="write this sample's series alone")
    writes.add_argument("--grid", choices=GRIDS, default="refined", help="grid of that sample (%(default)s)")
    writes.add_argument("--frames", type=int, help="run the sample again and write so many moments")
    site.add_arguments(command("site", estimate))
    begins = command("new", new)
    begins.add_argument(
        "--kind", choices=tuple(starters()), default="slope", help="of ground: %(choices)s (%(default)s)"
    )
    begins.add_argument("--out", type=Path, help="file to write (KIND.toml)")
    costs = command("check", check, "scene")
    costs.add_argument("--seconds", type=float, default=10.0, help="of the trial (%(default)g)")
    draws = command("draw", sketch, "scene")
    draws.add_argument("--out", type=Path, help="PNG, PDF, SVG or in 3D HTML to write (beside the scene)")
    draws.add_argument("--sample", type=int, default=0, help="whose field is drawn (%(default)s)")
    factors = command("fos", stability, "scene")
    factors.add_argument(
        "--k-h", type=float, help="horizontal acceleration over gravity, towards the toe (the scene's)"
    )
    factors.add_argument("--water", type=float, default=0.0, metavar="METRES", help="raise the water level by so much")
    factors.add_argument("--sample", type=int, help="a sample's soil instead of the median")
    factors.add_argument("--grid", choices=GRIDS, default="refined", help="grid of the solver (%(default)s)")
    factors.add_argument("--quick", action="store_true", help="limit equilibrium alone")
    factors.add_argument("--out", type=Path, help="folder for fos.png and fos.json (SCENE-fos)")
    starts = command("example", example)
    starts.add_argument("name", choices=tuple(examples()), metavar="NAME", help=", ".join(examples()))
    starts.add_argument("--out", type=Path, help="file to write (NAME.toml)")
    command("doctor", examine)
    completes = command("completion", complete)
    completes.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="of %(choices)s", metavar="SHELL")
    return whole


@contextmanager
def _warning_in_lines() -> Iterator[None]:
    """Have warnings shown as one line each, without the line of code that they come from."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"warning: {printable(str(message))}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


def main(arguments: list[str] | None = None) -> int:
    """Run the command; errors of the user's making are one line on stderr and exit code 2.

    Returns:
        The exit code.
    """
    given = parser().parse_args(arguments)
    try:
        with _warning_in_lines():
            runs.keep_compiled()
            runs.set_flags()
            given.does(given)
    except (ValueError, OSError) as error:
        # The text of an OSError of our own stands alone; that of the system's needs the file's name beside it.
        own = isinstance(error, OSError) and error.filename is None and error.strerror
        if isinstance(error, OSError) and error.filename is not None:
            own = f"{error.filename} cannot be used ({error.strerror}): give a file or folder that you may use"
        print(f"error: {printable(str(own or error))}", file=sys.stderr)
        return 2
    except (RuntimeError, AssertionError):
        # JAX raises either where it was told to use a device that is not there.
        if not (why := runs.missing_device()):
            raise
        print(f"error: {printable(why)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        stopped = interrupt if isinstance(interrupt, runs.Stopped) else runs.Stopped()
        # Whoever looks, draws or exports leaves nothing that the same command could go on with.
        print(f"\n{stopped if given.does in (run, resume, sweep_over) else stopped.by}", file=sys.stderr)
        return stopped.exit_code
    return 0
