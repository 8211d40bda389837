"""The commands and their arguments. Nothing here loads JAX, so that help and mistakes of typing answer at once."""

from __future__ import annotations

import argparse
from pathlib import Path

from cooperative.example_scenes import examples, starters
from cooperative.names import DRAWN_SLIDES, EXPORTS, GRIDS, USUAL_EXPORTS
from jaxmpm import __version__

COMMANDS = {
    "site": (
        "Estimate layers and random soil of soundings and laboratory values, and write them for a scene.",
        "cpt-1.gef cpt-2.gef --n-kt 14 2 --out site", "layers and random soil of soundings, for a scene",
    ),
    "example": (
        "Write an example scene to start from, and the schema for editors beside it.",
        "demo", "write demo.toml",
    ),
    "new": (
        "Write a commented scene of your own to fill in, and the schema for editors beside it.",
        "--kind section", "write section.toml, a scene of your own to fill in",
    ),
    "check": (
        "Read a scene and name all that is wrong with it, or say how large it is; with --measure how long it takes.",
        "section.toml", "is it right, and how large?",
    ),
    "draw": (
        "Draw a scene: ground, layers, water, walls, exposed places, and one random field on both grids.",
        "section.toml", "see it, as section.png; in 3D with plotly also as a page that turns",
    ),
    "slide": (
        "Run one soil of a scene: does it stand, how far does it go, and when; with pictures and an animation.",
        "section.toml --divide 1.3", "one slide of its median soil, with its strength divided by 1.3",
    ),
    "fos": (
        "Compute a slope's factor of safety, by limit equilibrium in seconds and by the solver's limit load.",
        "section.toml --quick", "its factor of safety by limit equilibrium, in seconds",
    ),
    "seepage": (
        "Let the rain or the drawdown of a scene move its water: pressure and factor of safety by slices against time.",
        "storm.toml", "pore pressure and factor of safety against time, in seconds",
    ),
    "run": (
        "Run a campaign of a scene, or go on where it was.",
        "demo.toml --out out/demo", "run it, or go on where it was",
    ),
    "status": (
        "Say how far a campaign is; it may be running.",
        "out/demo --watch", "how far it is, from another terminal, until it ends",
    ),
    "resume": (
        "Go on with a campaign from its folder, which holds its scene.",
        "out/demo --refined-runs 40", "go on, and allow more refined runs than its scene",
    ),
    "report": (
        "Write report.html with all figures of a campaign, and print its summary.",
        "out/demo", "write report.html again",
    ),
    "export": (
        "Write what a campaign holds for other programs: tables, series for ParaView, hazard maps, netCDF.",
        "out/demo", "write what it holds for other programs",
    ),
    "sweep": (
        "Run a campaign for each value of each parameter in the scene's [sweep], or go on where it was.",
        "sweep.toml --out out/sweep", "a campaign for each value in the scene's [sweep]",
    ),
    "doctor": (
        "Say what this installation is, and check in seconds that it computes what it should.",
        "", "is all well here?",
    ),
    "completion": (
        "Print a script that has a shell complete commands, options and files; needs the extra completion.",
        "bash", "print what has this shell complete commands",
    ),
}  # fmt: skip
"""Of each command: what it does, arguments of an example, and what the example does."""

EXIT_CODES = """
exit codes: 0 done; 2 a scene, folder or argument that cannot be used, named in one line, or wrong answers in doctor's
self-check; 130 stopped by Ctrl-C, 143 by SIGTERM. Then the same run, resume or sweep goes on from what is finished.
"""

FILES = {"scene": "scene in TOML", "folder": "folder of the campaign"}
"""Files and folders that commands take, in words."""


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments."""
    lines = "\n".join(f"  {_typed(name):<45} {what}" for name, (_, _, what) in COMMANDS.items())
    whole = argparse.ArgumentParser(
        prog="jaxmpm",
        description="Campaigns of random slopes.",
        epilog=f"examples:\n{lines}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"jaxmpm {__version__}")
    commands = whole.add_subparsers(required=True, metavar="COMMAND", dest="command")
    added = {}
    for name, (does, *_) in COMMANDS.items():
        added[name] = commands.add_parser(name, help=does, description=does, epilog=f"example: {_typed(name)}")
    for name in ("check", "draw", "slide", "fos", "seepage", "run", "sweep"):
        added[name].add_argument("scene", type=Path, help=FILES["scene"])
        outside = "let the scene name files outside its folder"
        added[name].add_argument("--allow-outside", action="store_true", help=outside)
    for name in ("status", "resume", "report", "export"):
        added[name].add_argument("folder", type=Path, help=FILES["folder"])
    for name in ("run", "sweep"):
        added[name].add_argument("--out", type=Path, required=True, help="folder to write to")
    for name in ("run", "resume", "sweep"):
        added[name].add_argument("--workers", type=int, help="samples to run at a time (one on each core)")
    for name in ("run", "resume"):
        _add_run_options(added[name])
    _add_site_options(added["site"])
    _add_scene_options(added)
    _add_result_options(added)
    return whole


def _typed(name: str) -> str:
    """The example of a command as one types it."""
    return f"jaxmpm {name} {COMMANDS[name][1]}".rstrip()


def _add_run_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--dask", metavar="ADDRESS", help="run them on the Dask cluster of this scheduler")
    command.add_argument(
        "--refined-runs", type=int, metavar="RUNS", help="allow more than the scene does; the folder keeps it"
    )
    command.add_argument(
        "--slides-t-end", type=float, metavar="SECONDS",
        help="let slides that had not come to rest go on until then; the folder keeps it",
    )  # fmt: skip
    command.add_argument(
        "--verify", action="store_true",
        help="compare the fields of all finished samples with their checksums, and solve for the stress at rest",
    )  # fmt: skip


def _add_scene_options(added: dict[str, argparse.ArgumentParser]) -> None:
    """Arguments of the commands that write a scene or look at one."""
    added["example"].add_argument("name", choices=tuple(examples()), metavar="NAME", help=", ".join(examples()))
    added["example"].add_argument("--out", type=Path, help="file to write (NAME.toml)")
    added["new"].add_argument(
        "--kind", choices=tuple(starters()), default="slope", help="of ground: %(choices)s (%(default)s)"
    )
    added["new"].add_argument("--out", type=Path, help="file to write (KIND.toml)")
    added["check"].add_argument(
        "--measure", type=float, nargs="?", const=10.0, metavar="SECONDS",
        help="try a run of each grid for so many seconds (10), for the campaign's time on this machine",
    )  # fmt: skip
    added["draw"].add_argument("--out", type=Path, help="PNG, PDF, SVG or in 3D HTML to write (beside the scene)")
    added["draw"].add_argument("--sample", type=int, help="whose field is drawn (0)")
    slide = added["slide"]
    soil = slide.add_mutually_exclusive_group()
    soil.add_argument("--sample", type=int, help="a sample's soil instead of the median")
    soil.add_argument("--mean", action="store_true", help="the means of all that is random instead of the median")
    slide.add_argument("--divide", type=float, default=1.0, metavar="R", help="divide strength by this number")
    slide.add_argument("--grid", choices=GRIDS, default="refined", help="to run on (%(default)s)")
    slide.add_argument("--frames", type=int, default=40, help="pictures of the animation, at most (%(default)s)")
    slide.add_argument(
        "--animate", type=Path, metavar="FILE",
        help="MP4 or GIF of the animation (slide.mp4 in the folder where ffmpeg is installed, else slide.gif)",
    )  # fmt: skip
    slide.add_argument("--vtk", action="store_true", help="write a series for ParaView too")
    slide.add_argument("--out", type=Path, help="folder for its files (SCENE-slide)")
    for name in ("slide", "fos"):
        added[name].add_argument("--time", metavar="TIME", help='of rain or drawdown, such as "12 h" (the scene\'s at)')
    moving = added["seepage"]
    moving.add_argument("--sample", type=int, help="a sample's soil instead of the median, for the factor of safety")
    moving.add_argument("--flow", action="store_true", help="the flow alone, without factors of safety")
    moving.add_argument("--animate", type=Path, metavar="FILE", help="MP4 or GIF of pressure and saturation")
    moving.add_argument("--frames", type=int, default=40, help="pictures of the animation (%(default)s)")
    moving.add_argument(
        "--probability",
        action="store_true",
        help="run the scene's samples too: the probability of failure by each time",
    )
    moving.add_argument(
        "--chart", action="store_true",
        help="run them on the scene's chart too: P_f against intensity and duration of rain, or the rate of a drawdown",
    )  # fmt: skip
    moving.add_argument(
        "--refined-runs",
        type=int,
        metavar="SAMPLES",
        help="samples that run refined too (a fifth of them, at least 20; 0 for none)",
    )
    moving.add_argument("--workers", type=int, help="samples to run at a time (one on each core)")
    moving.add_argument("--out", type=Path, help="folder for its files (SCENE-seepage)")
    fos = added["fos"]
    fos.add_argument("--k-h", type=float, help="horizontal acceleration over gravity, towards the toe (the scene's)")
    fos.add_argument("--water", type=float, default=0.0, metavar="METRES", help="raise the water level by so much")
    fos.add_argument("--sample", type=int, help="a sample's soil instead of the median")
    fos.add_argument("--grid", choices=GRIDS, default="refined", help="grid of the solver (%(default)s)")
    fos.add_argument("--quick", action="store_true", help="limit equilibrium alone")
    fos.add_argument("--out", type=Path, help="folder for fos.png and fos.json (SCENE-fos)")


def _add_result_options(added: dict[str, argparse.ArgumentParser]) -> None:
    """Arguments of the commands that look at a campaign's folder, and of completion."""
    added["status"].add_argument(
        "--watch", type=float, nargs="?", const=5.0, metavar="SECONDS",
        help="say it again every so many seconds (5) until the campaign ends",
    )  # fmt: skip
    report = added["report"]
    report.add_argument("--slides", type=int, default=DRAWN_SLIDES, help="slides drawn at several times (%(default)s)")
    report.add_argument("--again", action="store_true", help="run these samples again and draw more moments")
    export = added["export"]
    export.add_argument(
        "--as", dest="kinds", nargs="+", choices=EXPORTS, metavar="KIND",
        help=f"{', '.join(EXPORTS)} (the first {len(USUAL_EXPORTS)})",
    )  # fmt: skip
    export.add_argument("--sample", type=int, help="write this sample's series alone")
    export.add_argument("--grid", choices=GRIDS, default="refined", help="grid of that sample (%(default)s)")
    export.add_argument("--frames", type=int, help="run the sample again and write so many moments")
    added["completion"].add_argument("shell", choices=("bash", "zsh", "tcsh"), help="of %(choices)s", metavar="SHELL")


def _add_site_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("files", type=Path, nargs="+", help="soundings and laboratory values: GEF, BRO XML, AGS4, CSV")
    command.add_argument("--out", type=Path, required=True, help="folder to write to")
    command.add_argument(
        "--n-kt", type=float, nargs="+", metavar="N", help="cone factor of undrained strength, and its deviation"
    )
    command.add_argument(
        "--layers", type=float, nargs="*", metavar="Z", help="elevations between layers, from the top down (proposed)"
    )
    command.add_argument("--unit-weight", type=float, default=18e3, metavar="N/M3", help="of the soil (%(default)g)")
    command.add_argument(
        "--area-ratio", type=float, metavar="A", help="net, of cones whose file has u_2 and none, such as 0.8"
    )
    command.add_argument("--water", type=float, default=1.0, metavar="M", help="depth of the water table (%(default)g)")
    command.add_argument("--line", type=float, nargs=4, metavar=("X0", "Y0", "X1", "Y1"), help="of a section")
    command.add_argument(
        "--origin",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="to subtract in 3D (with --surface in a national grid a round corner of it, else 0 0)",
    )
    command.add_argument(
        "--surface", type=Path, metavar="RASTER", help="heights of the ground, for a whole scene: ASCII grid or GeoTIFF"
    )
    command.add_argument(
        "--section", type=Path, metavar="TOML", help="scene with [ground] and without soil, for a whole scene"
    )
    command.add_argument(
        "--base", type=float, metavar="Z", help="elevation of the scene's base: none below conditions it"
    )
    command.add_argument("--marginal", choices=("lognormal", "normal"), default="lognormal", help="(%(default)s)")
    command.add_argument("--correlation", default="exponential", metavar="FAMILY", help="(%(default)s)")
    command.add_argument(
        "--units", nargs="+", default=(), metavar="COLUMN=UNIT", help="of CSV columns whose header has none"
    )
