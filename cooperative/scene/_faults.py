"""All that is wrong with a scene's file, in one reading.

What depends on a value that will not do cannot be checked. The rest of the scene can, with an example in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from cooperative.scene import tables
from cooperative.scene._campaign import Campaign
from cooperative.scene._files import to_toml
from cooperative.scene._plausible import Unusual
from cooperative.scene._typed import read_scene, text_of, with_files
from cooperative.scene._variants import campaigns_of
from cooperative.store import Source
from jaxmpm.support.check import Faults, faults_of

ROUNDS = 4
"""Times that a scene is read again with examples in place of what will not do."""
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
Way = tuple[str, ...]
"""Names of tables and the key in the last of them."""


def check_scene(path: Path, then: Callable[[Campaign], None], *, outside: bool = False) -> list[Campaign]:
    """The campaigns of a scene's file, once all that can be wrong with it has been looked for.

    Args:
        path: of the scene.
        then: checks a campaign further.
        outside: whether the scene may name files outside its folder.

    Returns:
        The campaign, of a sweep all.

    Raises:
        Faults: all that is wrong. Faults that may come of an example are left out: those of its key or its table, and
            those whose rule compares a value with its own.
    """

    def checked(source: Source, *, further: bool = True) -> list[Campaign]:
        campaigns = campaigns_of(source)
        for campaign in campaigns if further else ():
            then(campaign)
        return campaigns

    try:
        return checked(read_scene(path, outside=outside))
    except Faults as error:
        faults = list(error.errors)
    scene, replaced, unusual = _tables(path), set[Way](), False
    for _ in range(ROUNDS):
        if scene is None or not (ways := _with_examples(scene)):
            if scene is None or not (ways := _on_purpose(scene, faults)):
                break
            unusual = True  # the size of a campaign then follows from a number that is not meant
        replaced |= ways
        try:
            checked(with_files(to_toml(scene), path.parent, outside=outside), further=not unusual)
        except (ValueError, OSError) as error:
            more = faults_of(error) if isinstance(error, ValueError) else ()
            messages = {str(fault) for fault in faults}
            faults += [fault for fault in more if str(fault) not in messages and not _may_come_of(replaced, fault)]
    raise Faults(faults)


def _tables(path: Path) -> dict[str, object] | None:
    """The tables of a scene's file, to be changed; None where it keeps its files itself."""
    read = deepcopy(dict(Source(text_of(path)).tables))
    return None if "files" in read else read


def _may_come_of(replaced: set[Way], fault: ValueError) -> bool:
    """Whether a fault is of a replaced value or of a table with one, or compares a value with one, or is not known."""
    path, beside = _names(getattr(fault, "path", ())), getattr(fault, "beside", ())
    keys = {way[-1] for way in replaced}
    return any(way[: len(path)] == path for way in replaced) or not keys.isdisjoint((*path, *beside))


def _names(path: Sequence[str | int]) -> Way:
    return tuple(part for part in path if isinstance(part, str))


def _on_purpose(scene: dict[str, object], faults: Sequence[ValueError]) -> set[Way]:
    """Let the soil of a scene be unusual, where a number of it is.

    scene: its tables, which change. Returns the ways to these numbers; none where nothing changes.
    """
    soil = scene.get("soil")
    unusual = [fault for fault in faults if isinstance(fault, Unusual)]
    if not unusual or not isinstance(soil, dict) or soil.get("unusual"):
        return set()
    soil["unusual"] = True
    return {way for fault in unusual if (way := _names(fault.path))}


def _with_examples(scene: dict[str, object]) -> set[Way]:
    """Put an example in the place of each value that its key cannot have, and leave out keys that are not known.

    scene: its tables, which change.

    Returns:
        The ways to these keys; none where no value is at fault, or one is that no example can replace.
    """
    try:
        TypeAdapter(tables.SceneTable).validate_python(scene)
    except ValidationError as error:
        found = [_replaced(scene, fault) for fault in error.errors(include_url=False)]
        return set() if None in found else {way for way in found if way is not None}
    return set()


def _replaced(scene: dict[str, object], fault: ErrorDetails) -> Way | None:
    """Mend one fault of a scene's tables.

    Returns:
        The way to the key at fault; None where there is no example for it.
    """
    kind: type[tables.Part] | None = tables.SceneTable
    at: object = scene
    way: Way = ()
    for part, following in _steps(fault["loc"]):
        if isinstance(at, Sequence) and not isinstance(at, str) and isinstance(part, int):
            at = at[part]
            continue
        if not isinstance(at, dict) or kind is None or not isinstance(part, str):
            continue
        field = tables.keys(kind).get(part)
        if field is None:
            if fault["type"] in UNKNOWN and not following:
                at.pop(part, None)
                return (*way, part)
            continue  # determines which of the types of a union it is
        way = (*way, part)
        inner = tables.table_in(field)
        if inner is not None and isinstance(at.get(part), Mapping | list) and following:
            at, kind = at[part], inner
            continue
        if not field.is_required():
            at.pop(part, None)
        elif (example := _example(field.examples)) is not None:
            at[part] = example
        else:
            return None
        return way
    return None


def _steps(location: tuple[int | str, ...]) -> list[tuple[int | str, bool]]:
    """Parts of where a fault lies, each with whether others follow it."""
    return [(part, number + 1 < len(location)) for number, part in enumerate(location)]


def _example(examples: Sequence[object] | None) -> object:
    """A value of a key that stands for no shape: a number, a text, or one number for each axis."""
    example = examples[0] if examples else None
    return None if isinstance(example, list) and any(isinstance(part, list) for part in example) else example
