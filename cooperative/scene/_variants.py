"""The campaigns of a sweep: one for each value of a parameter, and one for each scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import kl
from cooperative.estimate import Sampling
from cooperative.scene import tables as declared
from cooperative.scene._campaign import Campaign
from cooperative.scene._files import to_toml
from cooperative.scene._in_folder import stored_measured
from cooperative.scene._typed import parse, source_of
from cooperative.scene._varied import SCENARIO, Varied, base_of, path_of, variants_of
from cooperative.store import GRIDS, Source, table_of
from jaxmpm.support.check import Gathered, Invalid
from jaxmpm.support.values import by_value

LENGTHS = ("lx", "ly", "lz")
BASE, RANKED = "base", "ranked"
BESIDE = ("files",)
"""Tables that stand beside the text of a scene."""


@by_value
@dataclass(frozen=True)
class Variant:
    """One campaign of a sweep.

    Args:
        name: its folder.
        source: its scene.
        points: the (parameter, value) it answers for.
        changes: tables of the scene in which it differs by paths.
    """

    name: str
    source: Source
    points: tuple[tuple[str, float | str], ...]
    changes: tuple[str, ...] = ()


def variants(scene: Source | str | Path) -> list[Variant]:
    """The campaigns of a sweep.

    Args:
        scene: with a table `[sweep]` or tables `[[scenario]]`: TOML text, or its file.

    Raises:
        ValueError: these are missing or hold what cannot be swept.
    """
    source = source_of(scene)
    with declared.naming_keys(declared.SceneTable, source.tables):
        return _variants(source)


def _variants(source: Source) -> list[Variant]:
    sweep, base_scene = _sweep(source.tables), base_of(source.tables)

    def variant(name: str, *points: tuple[str, float | str], **changed: object) -> Variant:
        return Variant(name, _source({**base_scene, **changed}, source), points)

    campaign = parse(variant(BASE).source)
    if campaign.plan.coefficients is not kl.latin_hypercube:
        rule = "do not suit [sweep], which shares them between fields of other lengths"
        raise Invalid(("campaign", "coefficients"), None, rule, "take 'latin hypercube'")
    if campaign.coarse is not None:
        rule = "draws other samples in each campaign, and [sweep] compares them sample by sample"
        raise Invalid(("coarse",), None, rule, "leave it out")
    estimator, first = campaign.estimator, Sampling(campaign.plan.samples, campaign.run.failure_displacement)
    if estimator.rough_runs(first) != campaign.plan.samples:
        rule = "makes samples one by one, and [sweep] shares them"
        raise Invalid(("campaign", "estimator"), repr(estimator.name), rule, "take another estimator")
    dimension, strength = campaign.dimension, campaign.random.get("strength")
    base: dict[str, float] = {}
    if strength is not None and "strength" in base_scene:
        base = {"cov": strength.cov, **dict(zip(_axes(dimension), strength.length, strict=True))}
    elif sweep.of_strength:
        raise Invalid(("sweep",), None, "varies the field of undrained strength", "give the scene a table [strength]")
    if unknown := [name for name in sweep.of_strength if name not in base]:
        rule = "cannot be swept in this scene"
        raise Invalid(("sweep", unknown[0]), None, rule, f"give {', '.join((*base, 'k_t'))}")
    points = [(name, value) for name, values in sweep.of_strength.items() for value in values]
    by_path = list(variants_of(source.tables))
    same = [
        (point.parameter, point.value) for point in by_path if point.tables == base_scene or _is_default(point, source)
    ]
    campaigns = [variant(BASE, *(point for point in points if point[1] == base[point[0]]), *same)]
    for parameter, value in points:
        if value != base[parameter]:
            changed = {**base, parameter: value}
            length = [changed[axis] for axis in _axes(dimension)]
            table = {**table_of(base_scene, "strength"), "cov": changed["cov"], "length": length}
            campaigns.append(variant(f"{parameter}-{value:g}", (parameter, value), strength=table))
    gathered = Gathered()
    for point in by_path:
        if (point.parameter, point.value) not in same:
            with gathered.of(f"{point.parameter} = {point.value}"):
                campaigns.append(_by_path(point, source))
    gathered.raise_all()
    if sweep.k_t is not None:
        # All values of k_t follow from the runs that the largest asks for.
        plan = {k: v for k, v in table_of(base_scene, "campaign").items() if k not in ("refined_runs", "target_cov")}
        plan |= {"estimator": "published", "k_t": max(sweep.k_t)}
        campaigns.append(variant(RANKED, *(("k_t", value) for value in sweep.k_t), campaign=plan))
    _refuse_alike(campaigns)
    return campaigns


def campaigns_of(scene: Source | str | Path) -> list[Campaign]:
    """The campaign of a scene, or all campaigns of a sweep, its base first.

    Args:
        scene: TOML text, or its file.

    Raises:
        ValueError: as `parse` and `variants`.
    """
    source = source_of(scene)
    if "sweep" in source.tables or SCENARIO in source.tables:
        return [parse(variant.source) for variant in variants(source)]
    return [parse(source)]


def _is_default(point: Varied, source: Source) -> bool:
    """Whether a variant gives a key what the scene leaves at its default."""
    ((path, value), *more) = point.changes.items()
    return not more and path_of(source.tables, path).value(source.tables) == value


def _by_path(point: Varied, source: Source) -> Variant:
    """The campaign of a variant; ValueError where its scene refuses the value."""
    varied = _source(point.tables, source)
    parse(varied)
    first = tuple(path.partition(".")[0] for path in point.changes)
    return Variant(point.folder, varied, ((point.parameter, point.value),), first)


def _source(tables: Mapping[str, object], of: Source) -> Source:
    """A scene of these tables, with the files that it names beside its text."""
    text = to_toml({name: table for name, table in tables.items() if name not in BESIDE})
    return Source(text, {name: tables[name] for name in BESIDE if name in tables})


def _refuse_alike(campaigns: list[Variant]) -> None:
    names = [part.name.lower() for part in campaigns]
    for part in campaigns:
        if names.count(part.name.lower()) > 1:
            raise Invalid(
                ("sweep",), None, f"has two campaigns that would share the folder {part.name}", "name one otherwise"
            )


def _axes(dimension: int) -> tuple[str, ...]:
    return LENGTHS if dimension == 3 else ("lx", "lz")


def _sweep(tables: Mapping[str, object]) -> declared.Sweep:
    """The table `[sweep]`, checked as far as it can be without the scene; Invalid without it or a scenario."""
    table = tables.get("sweep", {})
    if not isinstance(table, dict) or not (table or SCENARIO in tables):
        raise Invalid((), None, "has no table [sweep]", "give one, for example with lx = [10, 30, 60, 120]")
    return declared.read(declared.Sweep, table, "sweep")


def with_measured_of_base(part: Variant, folder: Path) -> Source:
    """The variant's scene with what the base campaign measured.

    Its factors of safety, unless grids or ground are others. By one limit load failures of all variants are the same.

    Args:
        part: of the sweep.
        folder: of the sweep.
    """
    campaign = parse(part.source)
    if part.name == BASE:
        return part.source
    there = stored_measured(folder / "campaigns" / BASE)
    stored: dict[str, object] = {}
    if (
        campaign.plan.calibrate
        and campaign.measured.calibration is None
        and not set(part.changes) & {*GRIDS, *declared.SITES}
    ):
        assert there.calibration is not None
        stored["calibration"] = asdict(there.calibration)
    if part.changes and campaign.run.failure == "limit load" and campaign.measured.limit_load is None:
        assert there.limit_load is not None
        stored["limit_load"] = asdict(there.limit_load)
    return _source({**part.source.tables, **stored}, part.source) if stored else part.source
