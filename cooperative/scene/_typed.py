"""A campaign's scene: its tables in, checked once, typed values out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from cooperative.estimate import SETTINGS, Estimator
from cooperative.scene import tables
from cooperative.scene._campaign import Campaign, check_grids
from cooperative.scene._contact import fields_of, interface_of, on_ground
from cooperative.scene._files import Files
from cooperative.scene._plausible import ON_PURPOSE, ask_of_ground, ask_of_record
from cooperative.scene._region import ask_for_origin, ask_for_origin_of_section, between_cells, track_of
from cooperative.scene._site import Site
from cooperative.scene._soil import soils_of
from cooperative.scene._varied import variants_of
from cooperative.store import Source, table_of
from jaxmpm import (
    Raster,
    Scene,
    Section,
    Slope,
    State,
    Terrain,
)
from jaxmpm.support.check import Gathered
from jaxmpm.support.table import decoded
from jaxmpm.support.text import short, shown

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""
Points = tuple[tuple[float, float], ...]
DEEPEST_POOL = 10.0
"""Depth of water on the ground up to which it is plausible, over the height of the ground above its base."""


def parse(asked: Source | str | Path, estimator: Estimator | None = None) -> Campaign:
    """Read and check a scene.

    What depends on the geometry is checked when the grids are built.

    Args:
        asked: the scene's text, its file, or both with what a folder keeps beside it.
        estimator: takes the place of the one that the scene names. The campaign's source has it in words, so that a
            folder knows which estimator it belongs to.

    Raises:
        ValueError: TOML that does not parse, unknown keys (naming the nearest one), missing keys, wrong types and
            values out of range.
    """
    source = source_of(asked)
    scene = tables.read(tables.Scene, source.tables, files=Files.of(source.tables.get("files")))
    if scene.sweep is not None or scene.scenario is not None:
        table = "[[scenario]]" if scene.sweep is None else "[sweep]"
        raise ValueError(f"the scene has a table {table}, so it is many campaigns: run it by `jaxmpm sweep`")
    given = _given(scene, table_of(source.tables, "campaign"), estimator)
    if given is not None and scene.estimator is None:
        source = replace(source, beside={**source.beside, "estimator": {"given": given}})
    ground, gathered = _site(scene), Gathered()
    if not scene.unusual:
        where = next(name for name in tables.SITES if getattr(scene, name) is not None)
        with gathered.of():
            ask_of_ground(where, ground.shape, scene.run.failure_displacement)
        with gathered.of():
            _ask_of_water(ground)
    with gathered.of():
        check_limit_load(scene.run, table_of(source.tables, "run"), scene.limit_load)
    if "modes" in table_of(source.tables, "campaign"):
        with gathered.of():
            check_modes(scene.campaign, has_toe=ground.shape.face is not None)
    if scene.motion is not None and not scene.unusual:
        with gathered.of():
            ask_of_record(scene.motion)
    downhill = getattr(ground.shape, "downhill", 1)
    with gathered.of():
        whole, through, layers = soils_of(scene, height=ground.height, span=ground.span, downhill=downhill)
    gathered.raise_all()
    site = replace(ground, layers=layers)
    soil, drawn = site.representative(whole), scene.ground or scene.terrain
    contact = None if drawn is None else interface_of(drawn)
    of_contact = fields_of(
        "terrain" if scene.ground is None else "ground", contact, downhill, ground.span, unusual=scene.unusual
    )
    random = site.all_random({**through, **of_contact})
    site = on_ground(site, contact, soil)
    campaign = Campaign(
        name=scene.name,
        ground=site,
        soil=soil,
        random=random,
        cross_correlation=scene.cross_correlation,
        coarse=scene.coarse,
        rough=scene.rough,
        refined=scene.refined,
        run=scene.run,
        motion=scene.motion,
        rain=scene.rain,
        drawdown=scene.drawdown,
        plan=scene.campaign.plan,
        estimator=estimator
        or (cast(Estimator, tables.FromScript("estimator", given)) if given else scene.campaign.chosen),
        hazard=scene.hazard,
        exposed=tuple(scene.exposed or ()),
        measured=tables.Measured(calibration=scene.calibration, limit_load=scene.limit_load),
        source=source,
    )
    check_grids(campaign)
    return campaign


def source_of(scene: Source | str | Path) -> Source:
    """What a scene is made from: its text and, of a file, the points and heights of the files that it names.

    Args:
        scene: the text, or the path of a file; a string of one line that ends in ".toml" is a path, since no scene
            has one line.

    Raises:
        ValueError: naming the file, where one is missing or no text.
    """
    if isinstance(scene, Source):
        return scene
    if isinstance(scene, str) and ("\n" in scene or not scene.endswith(".toml")):
        return Source(scene)
    return read_scene(Path(scene))


def read_scene(path: Path, *, outside: bool = False) -> Source:
    """A scene's file, with the points and heights of the files that it names.

    Args:
        path: of the scene.
        outside: whether it may name files outside its folder. Whoever sends a scene chooses what it reads.

    Raises:
        ValueError: a file is missing or no text, the message names it; or the file holds what no scene has.
    """
    if not path.exists():
        raise ValueError(f"there is no scene {path}: give the path of a scene in TOML")
    if not path.is_file():
        raise ValueError(f"scene {path} is no file: give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}: is it a scene?")
    try:
        return with_files(_text_of(path), path.parent, outside=outside)
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read ({error.strerror}): give a file that you may read") from error


def with_files(text: str, folder: Path, *, outside: bool) -> Source:
    """A scene's text with the points and heights of the files that it names.

    Args:
        text: of the scene.
        folder: in which it stands.
        outside: as for `read_scene`.

    Raises:
        ValueError: as for `read_scene`.
        OSError: a file cannot be read.
    """
    source = Source(text)
    if "files" in source.tables:
        return source
    files = Files({}, folder, _origin(source.tables), outside)
    scene = tables.read(tables.Scene, source.tables, files=files)
    for variant in variants_of(source.tables):
        tables.read(tables.Scene, variant.tables, files=files)  # it may name files of its own
    return Source(text, {"files": files.table(scene.terrain)} if files.known else {})


def _text_of(path: Path) -> str:
    """The text of a scene, in UTF-8 as TOML is, or in an encoding that its first bytes state."""
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return decoded(path, data)
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"scene {path} is no text in UTF-8 (byte {error.start}, in line {line}): give a scene in TOML, saved with "
            "the encoding UTF-8"
        ) from error


def _origin(scene: Mapping[str, object]) -> tuple[float, ...]:
    """Of a terrain or a section, as the scene has it; 0 where it has none that will do, which reading reports."""
    x = table_of(scene, "ground").get("origin")
    if isinstance(x, int | float):
        return (float(x),)
    given = table_of(scene, "terrain").get("origin")
    known = isinstance(given, list) and len(given) == 2 and all(isinstance(each, int | float) for each in given)
    return (float(given[0]), float(given[1])) if known and isinstance(given, list) else (0.0, 0.0)


def built(campaign: Campaign, grid: str, *, at_rest: bool = True) -> tuple[Scene, State]:
    """Scene and initial state of one grid, free of stress if not `at_rest`.

    Args:
        campaign: the campaign.
        grid: "rough" or "refined".
        at_rest: whether the stress at rest is solved for.

    Raises:
        ValueError: slope, soil and grid do not fit together.
    """
    campaign.require()
    campaign = rested(campaign)
    return campaign.site.built(campaign.soil, campaign.grids[grid], at_rest=at_rest, **campaign.loads)


def rested(campaign: Campaign, time: float | None = None) -> Campaign:
    """A campaign whose ground rests under the pore pressure of a time; itself where its water does not move.

    Args:
        campaign: the campaign.
        time: s, None for that at which its table has samples rest.

    Raises:
        ValueError: ground and water do not go together, or the flow does not converge.
    """
    if campaign.seepage is None:
        return campaign
    from cooperative.scene._flow import at_time  # which nobody pays for whose water does not move

    return at_time(campaign, time)


def _site(scene: tables.Scene) -> Site:
    """The ground of a scene, without its layers; ValueError for values and lines that will not do."""
    if scene.slope is not None:
        values = dict(scene.slope)
        ends = values.pop("y_ends")
        return Site(Slope(**values), ends)
    if scene.ground is not None:
        return _section(scene, scene.ground)
    assert scene.terrain is not None  # a scene has one ground
    return _terrain(scene, scene.terrain)


def _section(scene: tables.Scene, table: tables.Ground) -> Site:
    values = dict(table)
    ends, origin = values.pop("ends"), values.pop("origin")
    ask_for_origin_of_section(table.surface)
    shape = Section(**{**values, "interface": None})
    try:
        shape.check()
    except ValueError as error:
        raise ValueError(f"[ground] {error}") from error
    return Site(shape, ends, (), scene.water, origin=(origin or 0.0, 0.0))


def _terrain(scene: tables.Scene, table: tables.Terrain) -> Site:
    if table.cut == "free" and table.polygon is None:
        raise ValueError("[terrain] cut = 'free' has no effect without polygon: depth is always fixed, so leave it out")
    surface = cast(Raster, table.surface)
    cells = tuple(grid.cell for grid in (scene.coarse, scene.rough, scene.refined) if grid is not None)
    if table.origin is None:
        ask_for_origin(surface)
    x, y = (given or between_cells(ends, cells) for given, ends in zip((table.x, table.y), surface.ends, strict=True))
    shape = Terrain(
        surface, table.base, x, y, polygon=cast(Points | None, table.polygon), depth=table.depth, cut=table.cut,
        bedrock=cast(Raster | None, table.bedrock),
    )  # fmt: skip
    shape.check()
    track = track_of(cast(Points, table.run_out_line or ()), shape)
    return Site(shape, table.ends, (), scene.water, track, table.origin or (0.0, 0.0))


def _ask_of_water(site: Site) -> None:
    """Raise ValueError for water that stands wildly above the ground, or below its base everywhere."""
    if (water := site.water_table) is None:
        return
    where = next(f"[water] {key.name}" for key in fields(tables.Water) if getattr(site.water, key.name) is not None)
    heights = water.heights if isinstance(water, Raster) else np.atleast_2d(water)[:, -1]
    heights, (base, top) = heights[np.isfinite(heights)], site.span
    if not heights.size:
        return
    low, high, height = float(heights.min()), float(heights.max()), top - base
    remedy = ON_PURPOSE.format("[soil]")
    if low - top > DEEPEST_POOL * height:
        raise ValueError(
            f"{where} stands {low - top:g} m above the ground's highest point at {top:g} m, more than {DEEPEST_POOL:g} "
            f"times its height of {height:g} m: were cm or mm meant, or heights from another zero? {remedy}"
        )
    if high < base:
        raise ValueError(
            f"{where} lies below the base at {base:g} m everywhere, at {high:g} m and lower, and wets nothing: leave "
            f"[water] out, or give heights from the same zero as those of the ground. {remedy}"
        )


def check_limit_load(run: tables.Run, keys: Mapping[str, object], given: tables.LimitLoad | None) -> None:
    """Check a limit load, asked for or given.

    Args:
        run: of the scene.
        keys: of its table, as they stand in the scene.
        given: by the scene, None where not.

    Raises:
        ValueError: it does not go with the table [run].
    """
    asked = run.failure == "limit load"
    if asked and "failure_displacement" in keys:
        raise ValueError(
            "[run] failure_displacement has no effect beside failure = 'limit load', which finds it: leave it out"
        )
    if asked and run.least_volume == 0:
        raise ValueError(
            "[run] least_volume = 0 beside failure = 'limit load': any particle moves below the limit load, give more "
            "or leave it out"
        )
    if given is None:
        return
    if not asked:
        raise ValueError("the scene has a table [limit_load] without [run] failure = 'limit load': leave it out")
    if run.least_volume not in (None, given.volume):
        raise ValueError(
            f"[run] least_volume = {run.least_volume:g} and [limit_load] volume = {shown(given.volume)} differ: the "
            "displacement belongs to one volume, give that one in both"
        )


def check_modes(table: tables.PlanAndEstimator, *, has_toe: bool) -> None:
    """Check modes that a scene asks for: slides have them where they come to their end, on a slope with a toe.

    Args:
        table: of the scene.
        has_toe: whether its ground has one.

    Raises:
        ValueError: no slide has a mode.
    """
    modes = f"modes = {'both' if 'rough' in table.modes else 'refined'!r}"
    if table.slides == 0:
        raise ValueError(
            f"[campaign] slides = 0 ends every refined run once its class is decided, and {modes} asks for modes of "
            "its failures, which only their end shows: leave out modes, or give slides = 'all' or a number"
        )
    if not has_toe:
        raise ValueError(
            f"[campaign] {modes} asks for modes, which only a slope with its toe has: leave it out, or give [ground] "
            "its toe"
        )


def _given(scene: tables.Scene, keys: Mapping[str, object], estimator: Estimator | None) -> str | None:
    """How an estimator describes itself that the scene does not name; None where the scene names its own."""
    stored = None if scene.estimator is None else scene.estimator.given
    if estimator is None:
        return stored
    if not is_dataclass(estimator) or isinstance(estimator, type):
        raise ValueError(f"estimator = {estimator!r}: give an object of a frozen dataclass, whose fields tell it apart")
    if stored is not None and stored != repr(estimator):
        raise ValueError(
            f"the campaign's estimator is {short(stored, 400)}, not {estimator!r}: give that one, or another folder"
        )
    named = [key for key in ("estimator", *SETTINGS) if key in keys]
    if named:
        raise ValueError(
            f"[campaign] {named[0]} has no effect beside estimator = {estimator!r}: leave it out of the scene"
        )
    return repr(estimator)
