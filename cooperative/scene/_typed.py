"""A campaign's scene: its tables in, checked once, typed values out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from cooperative.estimate import SETTINGS, Estimator
from cooperative.scene import tables
from cooperative.scene._campaign import Campaign, check_grids
from cooperative.scene._contact import on_ground
from cooperative.scene._files import Files
from cooperative.scene._plausible import ask_of_ground, ask_of_record, fields_of
from cooperative.scene._region import ask_for_origin, ask_for_origin_of_section, between_cells, track_of
from cooperative.scene._site import Site
from cooperative.scene._soil import soils_of
from cooperative.scene._varied import variants_of
from cooperative.store import Source, table_of, tables_of
from jaxmpm import Raster, Scene, Section, Slope, State, Terrain
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Gathered, Invalid, at
from jaxmpm.support.table import decoded
from jaxmpm.support.text import short, shown

if TYPE_CHECKING:
    from jaxmpm.seepage import PressureInTime

Moving = TypeVar("Moving", tables.Rain, tables.Drawdown)

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""
Points = tuple[tuple[float, float], ...]


def parse(origin: Source | str | Path, estimator: Estimator | None = None) -> Campaign:
    """Read and check a scene.

    What depends on the geometry is checked when the grids are built.

    Args:
        origin: the scene's text, its file, or both with what a folder keeps beside it.
        estimator: takes the place of the one that the scene names. The campaign's source has it in words, so that a
            folder knows which estimator it belongs to.

    Raises:
        ValueError: TOML that does not parse, unknown keys (naming the nearest one), missing keys, wrong types and
            values out of range.
    """
    source = source_of(origin)
    scene = tables.read(tables.SceneTable, source.tables, files=Files.of(source.tables.get("files")))
    with tables.naming_keys(tables.SceneTable, source.tables):
        if scene.sweep is not None or scene.scenario is not None:
            table = "[[scenario]]" if scene.sweep is None else "[sweep]"
            raise Invalid((), None, f"has a table {table}, so it is many campaigns", "run it by `jaxmpm sweep`")
        return _campaign(scene, source, estimator)


def _campaign(scene: tables.SceneTable, source: Source, estimator: Estimator | None) -> Campaign:
    """The campaign of a scene, whose estimator that of a script replaces."""
    words = _given(scene, table_of(source.tables, "campaign"), estimator)
    if words is not None and scene.estimator is None:
        source = replace(source, beside={**source.beside, "estimator": {"given": words}})
    where, table = next((name, table) for name in tables.SITES if (table := getattr(scene, name)) is not None)
    with at(where):
        ground = _site(scene, table)
    gathered, rain, drawdown = Gathered(), scene.rain, scene.drawdown
    with gathered.of():
        _check_keys(scene, source, where, ground)
    with gathered.of():
        whole, random, layers = soils_of(scene, tables_of(source.tables, "layer"), ground)
    with gathered.of():
        rain = None if rain is None else _with_strata(rain, "rain", ground, unusual=scene.unusual)
        drawdown = None if drawdown is None else _with_strata(drawdown, "drawdown", ground, unusual=scene.unusual)
    gathered.raise_all()
    site = replace(ground, layers=layers)
    soil = site.representative(whole)
    site, of_contact = _with_contact(scene, where, site, soil)
    campaign = tables.made(
        Campaign, scene, ground=site, soil=soil, random=site.all_random({**random, **of_contact}),
        plan=scene.campaign.plan, rain=rain, drawdown=drawdown, exposed=tuple(scene.exposed or ()),
        estimator=estimator or (tables.FromScript("estimator", words) if words else scene.campaign.chosen),
        measured=tables.made(tables.Measured, scene), source=source,
    )  # fmt: skip
    check_grids(campaign)
    return campaign


def _check_keys(scene: tables.SceneTable, source: Source, where: str, ground: Site) -> None:
    """Check keys against the ground, and which keys stand beside each other."""
    gathered = Gathered()
    if not scene.unusual:
        with gathered.of():
            ask_of_ground(where, ground, scene.run.failure_displacement)
    with gathered.of():
        check_limit_load(scene.run, table_of(source.tables, "run"), scene.limit_load)
    if "modes" in table_of(source.tables, "campaign"):
        with gathered.of():
            check_modes(scene.campaign, has_toe=ground.shape.face is not None)
    if scene.motion is not None and not scene.unusual:
        with gathered.of():
            ask_of_record(scene.motion)
    gathered.raise_all()


def _with_contact(
    scene: tables.SceneTable, where: str, site: Site, soil: AnySoil
) -> tuple[Site, Mapping[str, tables.RandomField]]:
    """The ground with the interface of its table, and what varies of that by parameter."""
    if (contact := getattr(getattr(scene, where), "contact", None)) is None:
        return site, {}
    random = fields_of(
        vars(contact), lambda name: (where, "interface", name), span=site.span,
        downhill=getattr(site.shape, "downhill", 1), home="[soil]", unusual=scene.unusual,
    )  # fmt: skip
    with at(where, "interface"):
        return on_ground(site, contact, soil), {f"interface_{name}": field for name, field in random.items()}


def _with_strata(table: Moving, name: str, ground: Site, *, unusual: bool) -> Moving:
    """A table of water whose conductivities, where they vary, are checked and dip as the ground falls."""

    def read(field: tables.RandomConductivity, path: tuple[str | int, ...]) -> tables.RandomConductivity:
        (dipping,) = fields_of(
            {tables.CONDUCTIVITY: field}, lambda _: (name, *path), span=ground.span,
            downhill=getattr(ground.shape, "downhill", 1), home="[soil]", unusual=unusual,
        ).values()  # fmt: skip
        return cast(tables.RandomConductivity, dipping)

    return table.with_conductivities(read)


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


def read_scene(path: str | Path, *, outside: bool = False) -> Source:
    """A scene's file, with the points and heights of the files that it names.

    Args:
        path: of the scene.
        outside: whether it may name files outside its folder. Whoever sends a scene chooses what it reads.

    Raises:
        ValueError: a file is missing or no text, the message names it; or the file holds what no scene has.
    """
    path = Path(path)
    if not path.exists():
        raise Invalid((), None, f"there is no scene {path}", "give the path of a scene in TOML")
    if not path.is_file():
        raise Invalid((), None, f"scene {path} is no file", "give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        rule = f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}"
        raise Invalid((), None, rule, "is it a scene?")
    try:
        return with_files(text_of(path), path.parent, outside=outside)
    except OSError as error:
        rule = f"scene {path} cannot be read ({error.strerror})"
        raise Invalid((), None, rule, "give a file that you may read") from error


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
    scene = tables.read(tables.SceneTable, source.tables, files=files)
    with tables.naming_keys(tables.SceneTable, source.tables):
        for variant in variants_of(source.tables):
            tables.read(tables.SceneTable, variant.tables, files=files)  # it may name files of its own
    return Source(text, {"files": files.table(scene.terrain)} if files.contents else {})


def text_of(path: Path) -> str:
    """The text of a scene, in UTF-8 as TOML is, or in an encoding that its first bytes state."""
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return decoded(path, data)
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        rule = f"scene {path} is no text in UTF-8 (byte {error.start}, in line {line})"
        raise Invalid((), None, rule, "give a scene in TOML, saved with the encoding UTF-8") from error


def _origin(scene: Mapping[str, object]) -> tuple[float, ...]:
    """Of a terrain or a section, as the scene has it; 0 where it has none that will do, which reading reports."""
    x = table_of(scene, "ground").get("origin")
    if isinstance(x, int | float):
        return (float(x),)
    origin = table_of(scene, "terrain").get("origin")
    if isinstance(origin, list) and len(origin) == 2 and all(isinstance(part, int | float) for part in origin):
        return float(origin[0]), float(origin[1])
    return 0.0, 0.0


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


def rested(campaign: Campaign, time: float | None = None, flow: PressureInTime | None = None) -> Campaign:
    """A campaign whose ground rests under the pore pressure of a time; itself where its water does not move.

    Args:
        campaign: the campaign.
        time: s, None for that at which its table has samples rest.
        flow: of a sample whose conductivity is its own, None for that of the campaign, which has the median.

    Raises:
        ValueError: ground and water do not go together, or the flow does not converge.
    """
    if campaign.seepage is None:
        return campaign
    from cooperative.scene._flow import at_time  # which nobody pays for whose water does not move

    return at_time(campaign, time, flow)


def _site(scene: tables.SceneTable, table: tables.SlopeTable | tables.GroundTable | tables.TerrainTable) -> Site:
    """The ground of a scene, without its layers and its interface; ValueError for lines that will not do."""
    if isinstance(table, tables.SlopeTable):
        return Site(tables.made(Slope, table), table.y_ends)
    if isinstance(table, tables.GroundTable):
        ask_for_origin_of_section(table.surface)
        section = tables.made(Section, table, interface=None)
        section.check()
        return Site(section, table.ends, water=scene.water, origin=(table.origin or 0.0, 0.0))
    surface = cast(Raster, table.surface)
    cells = tuple(
        grid.cell for grid in (scene.coarse, scene.rough, scene.refined) if isinstance(grid, tables.CampaignGrid)
    )
    if table.origin is None:
        ask_for_origin(surface)
    x, y = (walls or between_cells(ends, cells) for walls, ends in zip((table.x, table.y), surface.ends, strict=True))
    terrain = tables.made(Terrain, table, x=x, y=y, interface=None)
    terrain.check()
    track = track_of(cast(Points, table.run_out_line or ()), terrain)
    return Site(terrain, table.ends, water=scene.water, track=track, origin=table.origin or (0.0, 0.0))


def check_limit_load(run: tables.Run, keys: Mapping[str, object], measured: tables.LimitLoad | None) -> None:
    """Check a limit load, asked for or given.

    Args:
        run: of the scene.
        keys: of its table, as they stand in the scene.
        measured: that the scene gives, None where it gives none.

    Raises:
        ValueError: it does not go with the table [run].
    """
    by_load = run.failure == "limit load"
    if by_load and "failure_displacement" in keys:
        raise Invalid(
            ("run", "failure_displacement"), None, "has no effect beside failure = 'limit load', which finds it",
            "leave it out",
        )  # fmt: skip
    if by_load and run.least_volume == 0:
        raise Invalid(
            ("run", "least_volume"), "0", "beside failure = 'limit load'",
            "any particle moves below the limit load, give more or leave it out",
        )  # fmt: skip
    if measured is None:
        return
    if not by_load:
        raise Invalid(("limit_load",), None, "is there without [run] failure = 'limit load'", "leave it out")
    if run.least_volume not in (None, measured.volume):
        raise Invalid(
            ("run", "least_volume"), f"{run.least_volume:g}",
            f"and [limit_load] volume = {shown(measured.volume)} differ",
            "the displacement belongs to one volume, give that one in both",
        )  # fmt: skip


def check_modes(table: tables.PlanAndEstimator, *, has_toe: bool) -> None:
    """Check modes that a scene asks for: slides have them where they come to their end, on a slope with a toe.

    Args:
        table: of the scene.
        has_toe: whether its ground has one.

    Raises:
        ValueError: no slide has a mode.
    """
    path, value = ("campaign", "modes"), repr("both" if "rough" in table.modes else "refined")
    if table.slides == 0:
        raise Invalid(
            path, value, "beside slides = 0, which ends every refined run before its mode shows",
            "leave out modes, or give slides = 'all' or a number",
        )  # fmt: skip
    if not has_toe:
        remedy = "leave it out, or give [ground] its toe"
        raise Invalid(path, value, "asks for modes, which only a slope with its toe has", remedy)


def _given(scene: tables.SceneTable, keys: Mapping[str, object], estimator: Estimator | None) -> str | None:
    """How an estimator describes itself that the scene does not name; None where the scene names its own."""
    stored = None if scene.estimator is None else scene.estimator.given
    if estimator is None:
        return stored
    if not is_dataclass(estimator) or isinstance(estimator, type):
        remedy = "give an object of a frozen dataclass, whose fields tell it apart"
        raise Invalid(("campaign", "estimator"), repr(estimator), "", remedy)
    if stored is not None and stored != repr(estimator):
        rule = f"is {short(stored, 400)}, not {estimator!r}"
        raise Invalid(("campaign", "estimator"), None, rule, "give that one, or another folder")
    named = [key for key in ("estimator", *SETTINGS) if key in keys]
    if named:
        raise Invalid(
            ("campaign", named[0]), None, f"has no effect beside estimator = {estimator!r}", "leave it out of the scene"
        )
    return repr(estimator)
