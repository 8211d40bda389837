"""What the commands do. Each loads what it needs itself, so that it begins to speak soon."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cooperative._arguments import parser
from jaxmpm.support.extras import extra
from jaxmpm.support.text import printable

if TYPE_CHECKING:
    from cooperative.scene import Campaign
    from cooperative.store import Source
    from cooperative.tools.in_time import Chart, InTime, Kept

CLEAR = "\x1b[2J\x1b[H"
"""Has a terminal begin an empty screen."""
MOST_LINES = 20
"""Faults of a scene that are printed; the others are counted."""
LONGEST_TRIAL = 3600.0
"""Seconds of a trial at most; it shows no more after ten."""


def default_workers() -> int:
    """One process per core on CPU; on other devices, or without any, one process for all lanes."""
    import jax

    from cooperative import runs

    return len(runs.cores_to_use()) if not runs.missing_device() and jax.default_backend() == "cpu" else 1


def read_source(args: argparse.Namespace) -> Source:
    """The scene that a command names, with its files."""
    from cooperative.scene import read_scene

    return read_scene(args.scene, outside=args.allow_outside)


def read_campaigns(args: argparse.Namespace) -> list[Campaign]:
    """The campaign of a scene; of a sweep all, and a line about the first one."""
    from cooperative.scene import campaigns_of

    campaigns = campaigns_of(read_source(args))
    _say_sweep(args, campaigns)
    return campaigns


def _say_sweep(args: argparse.Namespace, campaigns: Sequence[Campaign]) -> None:
    if len(campaigns) > 1:
        base = "This is its base; `jaxmpm sweep` runs all of them."
        print(f"{args.scene} is a sweep of {len(campaigns)} campaigns. {base}")


def _at_time(campaign: Campaign, text: str | None) -> Campaign:
    """A campaign whose ground rests under the pressure of another time of its rain or drawdown."""
    return campaign if text is None else campaign.resting_at(text)


def run(args: argparse.Namespace) -> None:
    """Answer `jaxmpm run`."""
    from cooperative import runs
    from cooperative.scene import parse

    source = read_source(args)
    for remark in runs.warnings_of(parse(source)):
        warnings.warn(remark, stacklevel=2)
    _run(source, args.out, args)


def resume(args: argparse.Namespace) -> None:
    """Answer `jaxmpm resume`."""
    from cooperative.store import read_store

    if (kept := _asked_in_time(args.folder)) is not None:
        _resume_in_time(kept, args)
        return
    _run(read_store(args.folder).source, args.folder, args)


def _asked_in_time(folder: Path) -> Kept | None:
    """The answers of a folder whose samples were asked in time, None for that of a campaign."""
    from cooperative.store import IN_TIME, read_store, stored_text

    if stored_text(read_store(folder).folder, IN_TIME) is None:
        return None
    from cooperative.tools.in_time import kept_in  # which loads what few folders need

    return kept_in(folder)


def _resume_in_time(kept: Kept, args: argparse.Namespace) -> None:
    """Go on with samples that are asked in time."""
    from cooperative import runs
    from cooperative.scene import campaign_of
    from cooperative.tools import in_time

    for option in ("dask", "slides_t_end", "verify"):
        if getattr(args, option):
            raise ValueError(
                f"--{option.replace('_', '-')} is of a campaign, and samples in {args.folder} are asked in time: leave "
                "it out"
            )
    campaign, folder = campaign_of(kept.store), kept.written_to
    refined_runs = kept.audited if args.refined_runs is None else args.refined_runs
    with runs.stop_by_signals(ends_process=True):
        if kept.chart:
            _chart(in_time.probability_chart(campaign, folder, refined_runs=refined_runs, **_budget(args)), folder)
        else:
            _in_time(campaign, folder, refined_runs, _budget(args))


def _chart(chart: Chart, folder: Path) -> None:
    """Write and print a chart."""
    from cooperative.tools.in_time import chart_lines, write_chart

    print(*map(printable, chart_lines(chart)), *write_chart(chart, folder), sep="\n", flush=True)


def _budget(args: argparse.Namespace) -> dict[str, Any]:
    """Processes that run samples in time, and what says how far they are."""
    return {
        "workers": default_workers() if args.workers is None else args.workers,
        "progress": lambda line: print(line, file=sys.stderr, flush=True),
    }


def _run(source: Source, folder: Path, args: argparse.Namespace) -> None:
    from cooperative import campaign, runs
    from cooperative.reporting import report

    with runs.stop_by_signals(ends_process=True):
        executor = None if args.dask is None else runs.dask_executor(args.dask)
        workers = default_workers() if args.workers is None else args.workers
        ranks = campaign.NO_RANKS
        if isinstance(source.tables.get("coarse"), str):
            from cooperative.tools.safety import RANKS as ranks  # loads what few scenes need
        campaign.run(
            source, folder, workers=workers, executor=executor, refined_runs=args.refined_runs,
            slides_t_end=args.slides_t_end, progress=True, verify=args.verify, ranks=ranks,
        )  # fmt: skip
    print(report(folder))


def status(args: argparse.Namespace) -> None:
    """Answer `jaxmpm status`."""
    from cooperative.reporting import progress_of, watched, words

    progress = partial(progress_of, args.folder)
    if _asked_in_time(args.folder) is not None:
        from cooperative.tools.in_time import progress_in_time

        progress = partial(progress_in_time, args.folder)
    if args.watch is None:
        print(words(progress()))
        return
    for now in watched(progress, args.watch):
        # A terminal shows each in place of the one before.
        print(f"{CLEAR if sys.stdout.isatty() else ''}{now}", flush=True)


def report(args: argparse.Namespace) -> None:
    """Answer `jaxmpm report`."""
    from cooperative.reporting import report

    if (kept := _asked_in_time(args.folder)) is not None:
        from cooperative.tools import in_time

        if kept.chart:
            _chart(in_time.read_chart(args.folder), kept.written_to)
        else:
            answer, slides = in_time.read_in_time(args.folder)
            paths = in_time.write_in_time(answer, kept.written_to, slides, drawn=args.slides, again=args.again)
            print(*map(printable, in_time.lines(answer, slides)), *paths, sep="\n")
        return
    print(report(args.folder, slides=args.slides, again=args.again))


def export(args: argparse.Namespace) -> None:
    """Answer `jaxmpm export`."""
    from cooperative.exports import export, export_sample

    if args.sample is None and args.frames is not None:
        raise ValueError(f"--frames {args.frames} is for one sample: give --sample too")
    if args.sample is not None and args.kinds:
        raise ValueError(f"--as {args.kinds[0]} is for the whole campaign: leave out --sample, which writes particles")
    if args.sample is None:
        for path in export(args.folder, args.kinds):
            print(path)
    else:
        print(export_sample(args.folder, args.sample, args.grid, frames=args.frames))


def sweep(args: argparse.Namespace) -> None:
    """Answer `jaxmpm sweep`."""
    from cooperative import runs
    from cooperative.tools import sweep

    with runs.stop_by_signals(ends_process=True):
        workers = default_workers() if args.workers is None else args.workers
        sweep.run(read_source(args), args.out, workers=workers, progress=True)
    print(f"{args.out / 'sweep.json'}, {args.out / 'sweep.csv'}, figures in {args.out / 'figures'}")


def site(args: argparse.Namespace) -> None:
    """Answer `jaxmpm site`."""
    from cooperative.tools import site

    print(*site.answer(args), sep="\n")


def new(args: argparse.Namespace) -> None:
    """Answer `jaxmpm new`."""
    from cooperative.example_scenes import begin

    for path in begin(args.kind, args.out or Path(f"{args.kind}.toml")):
        print(path)


def example(args: argparse.Namespace) -> None:
    """Answer `jaxmpm example`."""
    from cooperative.example_scenes import write_example

    for path in write_example(args.name, args.out or Path(f"{args.name}.toml")):
        print(path)


def check(args: argparse.Namespace) -> None:
    """Answer `jaxmpm check`."""
    from cooperative import runs
    from cooperative.reporting import words_of_cost
    from cooperative.scene import check_scene

    if args.measure is not None and not 0 < args.measure <= LONGEST_TRIAL:
        raise ValueError(f"--measure {args.measure:g} s: give more than 0 and at most {LONGEST_TRIAL:g}")
    campaigns = check_scene(args.scene, runs.check_all, outside=args.allow_outside)
    _say_sweep(args, campaigns)
    cost = runs.cost_of(campaigns[0], args.measure)
    print("\n".join(map(printable, words_of_cost(campaigns[0], cost))))
    if len(campaigns) > 1:
        print(f"  sweep          {len(campaigns)} campaigns" + ", each of about this time" * bool(cost.step))


def draw(args: argparse.Namespace) -> None:
    """Answer `jaxmpm draw`."""
    from cooperative.reporting import draw, installed

    campaign = read_campaigns(args)[0]
    suffixes = (".png", ".html") if campaign.dimension == 3 and installed() else (".png",)
    paths = [args.out] if args.out else [args.scene.with_suffix(suffix) for suffix in suffixes]
    draw(campaign, *paths, sample=args.sample)
    print(*paths, sep="\n")


def slide(args: argparse.Namespace) -> None:
    """Answer `jaxmpm slide`."""
    from tqdm import tqdm

    from cooperative.one_run import animation_path, lines, slide, write_slide
    from jaxmpm.support.files import not_linked

    campaign = _at_time(read_campaigns(args)[0], args.time)
    folder = args.out or not_linked(args.scene.with_name(f"{args.scene.stem}-slide"))
    animation, end = animation_path(folder, args.animate), campaign.run.last(args.grid)
    with tqdm(total=end, unit="s", bar_format="{l_bar}{bar}| {n:.1f} of {total:g} s {postfix}", disable=None) as bar:

        def progress(seconds: float, displacement: float) -> None:
            bar.set_postfix_str(f"{displacement:.3g} m", refresh=False)
            bar.update(min(seconds, end) - bar.n)

        result = slide(
            campaign, args.sample, mean=args.mean, divide=args.divide, grid=args.grid, frames=args.frames,
            progress=progress,
        )  # fmt: skip
    print(*map(printable, lines(result)), sep="\n")
    print(*write_slide(result, folder, animation=animation, vtk=args.vtk), sep="\n")


def fos(args: argparse.Namespace) -> None:
    """Answer `jaxmpm fos`."""
    from cooperative.tools import safety
    from jaxmpm.support.files import not_linked

    campaign, start = _at_time(read_campaigns(args)[0], args.time), time.perf_counter()
    # A scene's folder may come from somebody else, with a link of this name. It is made once there is an answer.
    folder = args.out or not_linked(args.scene.with_name(f"{args.scene.stem}-fos"))

    def announce(result: safety.Safety) -> None:
        print(*map(printable, safety.lines_of_equilibrium(campaign.name, result)), sep="\n", flush=True)

    def progress(factors: Sequence[float], displacements: Sequence[float]) -> None:
        print(safety.progress_line(factors, displacements, time.perf_counter() - start), file=sys.stderr, flush=True)

    result = safety.factor_of_safety(
        campaign, k_h=args.k_h, water=args.water, sample=args.sample, grid=args.grid, solver=not args.quick,
        progress=progress, announce=announce,
    )  # fmt: skip
    print(*map(printable, safety.lines_of_solver(result)), *safety.write_safety(result, campaign, folder), sep="\n")


def seepage(args: argparse.Namespace) -> None:
    """Answer `jaxmpm seepage`."""
    import numpy as np

    from cooperative import runs
    from cooperative.one_run import animation_path
    from cooperative.tools import in_time
    from cooperative.tools.seepage import lines, wetted, write_animation, write_wetted
    from jaxmpm.support.files import not_linked

    storms = _storms(args)
    campaign, folder = next(iter(storms.values())), args.out
    folder = folder or not_linked(args.scene.with_name(f"{args.scene.stem}-seepage"))
    in_time.check_classes(storms)
    animation = None if args.animate is None else animation_path(folder, args.animate)
    if args.frames < 2:
        raise ValueError(f"--frames {args.frames}: give 2 or more")
    result = wetted(campaign, factors=not args.flow, sample=args.sample)
    print(*map(printable, lines(result)), *write_wetted(result, folder), sep="\n", flush=True)
    if animation is not None:
        times = np.linspace(0.0, result.moments[-1].time, args.frames).tolist()
        moving = wetted(result.campaign, factors=False, sample=args.sample, times=times)
        print(write_animation(moving, animation), flush=True)
    budget = _budget(args)
    with runs.stop_by_signals(ends_process=True):
        if args.probability and len(storms) == 1:
            _in_time(campaign, folder, args.refined_runs, budget)
        elif args.probability:
            answers = {
                name: _in_time(storm, folder / "campaigns" / name, args.refined_runs, budget)
                for name, storm in storms.items()
            }
            print(*map(printable, in_time.lines_of_year(in_time.annual_in_time(answers))), sep="\n", flush=True)
        if args.chart:
            _chart(in_time.probability_chart(campaign, folder, refined_runs=args.refined_runs, **budget), folder)


def _storms(args: argparse.Namespace) -> dict[str, Campaign]:
    """The campaigns of a scene's classes of storms, its `[[scenario]]`s, by name; its own alone without frequencies."""
    from cooperative.scene import SCENARIO, parse, variants

    source = read_source(args)
    if SCENARIO in source.tables:
        storms = {variant.name: parse(variant.source) for variant in variants(source)}
        if any(storm.plan.annual_frequency is not None for storm in storms.values()):
            return storms
    return {"": read_campaigns(args)[0]}


def _in_time(campaign: Campaign, folder: Path, refined_runs: int | None, budget: dict[str, Any]) -> InTime:
    """Run a campaign's samples in time, and write and print what comes of it."""
    from cooperative.tools.in_time import lines, probability_in_time, slides_in_time, write_in_time

    answer = probability_in_time(campaign, folder, refined_runs=refined_runs, **budget)
    slides = slides_in_time(answer, folder, **budget)
    print(*map(printable, lines(answer, slides)), *write_in_time(answer, folder, slides), sep="\n", flush=True)
    return answer


def doctor(args: argparse.Namespace) -> None:
    """Answer `jaxmpm doctor`."""
    from cooperative import doctor

    if not doctor.examine():
        raise ValueError("the self-check did not pass: see above")


def completion(args: argparse.Namespace) -> None:
    """Answer `jaxmpm completion`."""
    shtab = extra("shtab", "shtab is not installed")
    whole = parser()
    for command in whole._subparsers._group_actions[0].choices.values():  # type: ignore[union-attr]
        for argument in command._actions:
            if argument.type is Path:
                argument.complete = shtab.FILE
    print(shtab.complete(whole, args.shell))


OF_SCENES = (site, example, new, check, draw, slide, fos, seepage, run)
OF_FOLDERS = (status, resume, report, export, sweep, doctor, completion)
COMMANDS: dict[str, Callable[[argparse.Namespace], None]] = {
    function.__name__: function for function in (*OF_SCENES, *OF_FOLDERS)
}
LIBRARIES = {
    **dict.fromkeys(("run", "resume"), ("cooperative.campaign", "cooperative.reporting")),
    **dict.fromkeys(("status", "report", "check", "draw"), ("cooperative.runs", "cooperative.reporting")),
    **{"export": ("cooperative.exports",), "slide": ("cooperative.one_run",), "doctor": ("cooperative.doctor",)},
    **{
        name: (f"cooperative.tools.{room}",)
        for name, room in (("site", "site"), ("fos", "safety"), ("seepage", "seepage"), ("sweep", "sweep"))
    },
}
"""Modules by command, whose loading takes seconds; commands without any need neither JAX nor NumPy."""
RESUMABLE = ("run", "resume", "seepage", "sweep")


@contextmanager
def _warning_in_lines() -> Iterator[None]:
    """Have warnings shown as one line each, without the line of code that they come from."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_, **__: f"warning: {printable(str(message))}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


def _lines_of(error: Exception) -> Iterator[str]:
    """An error in lines: one, or of several faults one each, by the tables that they are about."""
    from jaxmpm.support.check import Faults

    faults = error.errors if isinstance(error, Faults) else ()
    if len(faults) < 2:
        yield f"error: {error}"
        return
    yield f"error: {len(faults)} faults"
    of_tables = dict[tuple[str | int, ...], list[ValueError]]()
    for fault in faults:
        of_tables.setdefault(getattr(fault, "path", ())[:1], []).append(fault)
    grouped = [*chain.from_iterable(of_tables.values())]
    yield from (f"  {fault}" for fault in grouped[:MOST_LINES])
    if len(grouped) > MOST_LINES:
        yield f"  and {len(grouped) - MOST_LINES} more"


def execute(args: argparse.Namespace) -> int:
    """Run the command; errors of the user's making are one line each on stderr and exit code 2.

    Args:
        args: of the command line.

    Returns:
        The exit code.

    Raises:
        BrokenPipeError: whoever read the output has left.
    """
    if args.command in LIBRARIES:
        from cooperative import runs
    try:
        with _warning_in_lines():
            if args.command in LIBRARIES:
                runs.keep_compiled()
                runs.set_flags()
            COMMANDS[args.command](args)
    except BrokenPipeError:  # of whoever read the output
        raise
    except (ValueError, OSError) as error:
        # The text of an OSError of our own stands alone; that of the system's needs the file's name beside it.
        message = isinstance(error, OSError) and error.filename is None and error.strerror
        if isinstance(error, OSError) and error.filename is not None:
            message = f"{error.filename} cannot be used ({error.strerror}): give a file or folder that you may use"
        print(
            f"error: {printable(message)}" if message else "\n".join(map(printable, _lines_of(error))), file=sys.stderr
        )
        return 2
    except (RuntimeError, AssertionError):
        # JAX raises either where it was told to use a device that is not there.
        if args.command not in LIBRARIES or not (why := runs.missing_device()):
            raise
        print(f"error: {printable(why)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        from cooperative.runs import Stopped

        stopped = interrupt if isinstance(interrupt, Stopped) else Stopped()
        # Whoever looks, draws or exports leaves nothing that the same command could go on with.
        print(f"\n{stopped if args.command in RESUMABLE else stopped.by}", file=sys.stderr)
        return stopped.exit_code
    return 0
