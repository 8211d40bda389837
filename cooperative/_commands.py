"""The commands: run, resume, status, report, export, sweep, example, doctor."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import jax

from cooperative import __version__, campaign, doctor, sweep, write_aside
from cooperative.reporting import SLIDES, progress_of, report, words
from cooperative.reporting import _exports as exports
from cooperative.runs import Stopped, cores_to_use, dask_executor, heeding, keep_compiled
from cooperative.scene import example, examples, read_scene
from cooperative.store import GRIDS, read_store
from foundation.text import printable

Command = Callable[[argparse.Namespace], None]


def default_workers() -> int:
    """One process per core on CPU; on other devices one process for all lanes."""
    return len(cores_to_use()) if jax.default_backend() == "cpu" else 1


def run(given: argparse.Namespace) -> None:
    """Run a campaign of a scene, or go on where it was."""
    _run(read_scene(given.scene), given.out, given)


def resume(given: argparse.Namespace) -> None:
    """Go on with a campaign from its folder, which holds its scene."""
    _run(read_store(given.folder).scene_text, given.folder, given)


def _run(text: str, folder: Path, given: argparse.Namespace) -> None:
    with heeding(ends_process=True):
        executor = None if given.dask is None else dask_executor(given.dask)
        campaign.run(
            text, folder, workers=given.workers, executor=executor, refined_runs=given.refined_runs, progress=True
        )
    print(report(folder))


def status(given: argparse.Namespace) -> None:
    """Say how far a campaign is; it may be running."""
    print(words(progress_of(given.folder)))


def show(given: argparse.Namespace) -> None:
    """Write report.html with all figures of a campaign, and print its summary."""
    print(report(given.folder, slides=given.slides, again=given.again))


def export(given: argparse.Namespace) -> None:
    """Write what a campaign holds as CSV, one HDF5 file and VTKHDF for ParaView."""
    if given.sample is None and given.frames is not None:
        raise ValueError(f"--frames {given.frames} is for one sample: give --sample too")
    if given.sample is None:
        for path in exports.export(given.folder):
            print(path)
    else:
        print(exports.export_sample(given.folder, given.sample, given.grid, frames=given.frames))


def sweep_over(given: argparse.Namespace) -> None:
    """Run a campaign for each value of each parameter in the scene's [sweep], or go on where it was."""
    with heeding(ends_process=True):
        sweep.run(read_scene(given.scene), given.out, workers=given.workers, progress=True)
    print(f"{given.out / 'sweep.json'}, figures in {given.out / 'figures'}")


def write_example(given: argparse.Namespace) -> None:
    """Write an example scene to start from."""
    out = given.out or Path(f"{given.name}.toml")
    text = example(given.name)
    if out.exists():
        raise ValueError(f"{out} exists already: give another name with --out")
    write_aside(out, text.encode())
    print(out)


def examine(given: argparse.Namespace) -> None:
    """Say what this installation is, and check in seconds that it computes what it should."""
    if not doctor.examine():
        raise ValueError("the self-check found wrong answers: see above")


EPILOG = """examples:
  jaxmpm example demo                     write demo.toml
  jaxmpm run demo.toml --out out/demo     run it, or go on where it was
  jaxmpm status out/demo                  how far it is, from another terminal
  jaxmpm report out/demo                  write report.html again

exit codes: 0 done; 2 a scene, folder or argument that cannot be used, said in one line; 130 stopped by Ctrl-C, to be
gone on with by the same command.
"""


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments."""
    whole = argparse.ArgumentParser(
        prog="jaxmpm",
        description="Campaigns of random slopes.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"jaxmpm {__version__}")
    commands = whole.add_subparsers(required=True, metavar="COMMAND")

    def command(
        name: str, does: Callable[[argparse.Namespace], None], *, scene: bool = False
    ) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=does.__doc__, description=does.__doc__)
        added.set_defaults(does=does)
        if scene:
            added.add_argument("scene", type=Path, help="scene in TOML")
            added.add_argument("--out", type=Path, required=True, help="folder to write to")
        else:
            added.add_argument("folder", type=Path, help="folder of the campaign")
        return added

    runs, sweeps = (
        (command("run", run, scene=True), command("resume", resume)),
        command("sweep", sweep_over, scene=True),
    )
    for heavy in (*runs, sweeps):
        heavy.add_argument(
            "--workers", type=int, default=default_workers(), help="samples to run at a time (%(default)s)"
        )
    for each in runs:
        each.add_argument("--dask", metavar="ADDRESS", help="run them on the Dask cluster of this scheduler")
        each.add_argument(
            "--refined-runs",
            type=int,
            metavar="RUNS",
            help="allow more than the scene does; the folder keeps it",
        )
    command("status", status)
    shows = command("report", show)
    shows.add_argument("--slides", type=int, default=SLIDES, help="slides drawn at several times (%(default)s)")
    shows.add_argument("--again", action="store_true", help="run these samples again and draw more moments")
    writes = command("export", export)
    writes.add_argument("--sample", type=int, help="write this sample's series alone")
    writes.add_argument("--grid", choices=GRIDS, default="refined", help="grid of that sample (%(default)s)")
    writes.add_argument("--frames", type=int, help="run the sample again and write so many moments")
    starts = commands.add_parser("example", help=write_example.__doc__, description=write_example.__doc__)
    starts.add_argument("name", choices=examples(), metavar="NAME", help=", ".join(examples()))
    starts.add_argument("--out", type=Path, help="file to write (NAME.toml)")
    starts.set_defaults(does=write_example)
    checks = commands.add_parser("doctor", help=examine.__doc__, description=examine.__doc__)
    checks.set_defaults(does=examine)
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
    """Run the command; errors of the user's making are one line on stderr and exit code 2."""
    given = parser().parse_args(arguments)
    try:
        with _warning_in_lines():
            keep_compiled()
            given.does(given)
    except (ValueError, OSError) as error:
        # The text of an OSError of our own stands alone; that of the system's needs the file's name beside it.
        own = isinstance(error, OSError) and error.filename is None and error.strerror
        print(f"error: {printable(str(own or error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        stopped = interrupt if isinstance(interrupt, Stopped) else Stopped()
        print(f"\n{stopped}", file=sys.stderr)
        return stopped.exit_code
    return 0
