"""A campaign in words, as its folder stores one that was written in Python, and back again.

What the packages offer is found again by its name. A law, a soil or a ground of the user's own is stored as its class,
its fields and a checksum of its source, which tell it from another; the script has to give it again. Nothing is
executed.
"""

from __future__ import annotations

import dataclasses
import dis
import enum
import hashlib
import inspect
import json
import math
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from types import CodeType, FunctionType
from typing import Any

import jax
import numpy as np

import jaxmpm
import kl
from cooperative import estimate, measure
from cooperative.estimate import Estimator
from cooperative.scene._campaign import Campaign, Given
from cooperative.scene._files import as_text, from_text
from cooperative.scene._site import Site, SiteLayer
from cooperative.scene.tables import (
    Bedding,
    CrossCorrelation,
    Exposed,
    Grid,
    Hazard,
    Motion,
    Plan,
    RandomField,
    RandomLevel,
    Run,
)
from cooperative.store import Source, table_of
from jaxmpm.support.text import short

PACKAGES = {"foundation", "jaxmpm", "kl", "cooperative"}
OFFER = (
    *(jaxmpm, jaxmpm.laws, jaxmpm.soil, jaxmpm.setup, jaxmpm.ground, jaxmpm.transfer, jaxmpm.run),
    *(kl, kl.axis, kl.field, kl.marginal, estimate, measure),
)
"""Modules whose names a campaign's words hold, each after its package alone: `jaxmpm.MohrCoulomb`."""


_ADDRESS = re.compile(" at 0x[0-9a-f]+")


@cache
def _offered() -> dict[str, type | FunctionType]:
    """Classes and functions of the packages that a campaign may hold, by name."""
    offered = {
        f"{module.__name__.partition('.')[0]}.{name}": getattr(module, name)
        for module in OFFER
        for name in module.__all__
    }
    own = (
        Bedding,
        CrossCorrelation,
        Exposed,
        Grid,
        Hazard,
        Motion,
        Plan,
        RandomField,
        RandomLevel,
        Run,
        Site,
        SiteLayer,
    )
    offered |= {f"cooperative.{each.__name__}": each for each in own}
    return {name: each for name, each in offered.items() if isinstance(each, type) or _is_pure(each)}


def _is_pure(each: object) -> bool:
    """Whether this is a function that opens no file: a folder of somebody else chooses what is called."""
    return isinstance(each, FunctionType) and "path" not in inspect.signature(each).parameters


OF_THE_FOLDER = ("measured", "raised", "source")
"""Fields of a campaign that its folder adds."""


def source_of_value(campaign: Campaign) -> Source:
    """What a campaign that was written in Python is made from: its fields in words.

    Raises:
        ValueError: what has no words.
    """
    names = [each.name for each in dataclasses.fields(campaign) if each.name not in OF_THE_FOLDER]
    return Source(None, {"campaign": {name: in_words(getattr(campaign, name), name) for name in names}})


def is_same(one: Campaign, other: Campaign) -> bool:
    """Whether two campaigns are the same, in the words of all that a script gives."""
    return source_of_value(one).beside == source_of_value(other).beside


def campaign_of_words(source: Source) -> Campaign:
    """The campaign that was written in Python, with `Given` for what its script has to give again.

    Raises:
        ValueError: words that are not of a campaign.
    """
    try:
        fields = {name: of_words(words, name) for name, words in table_of(source.beside, "campaign").items()}
        return Campaign(**fields)
    except (AttributeError, KeyError, TypeError, ValueError, zlib.error) as error:
        raise ValueError(f"campaign.db holds no campaign ({error}): put back what it began with") from error


def in_python(scene: Campaign | Source, estimator: Estimator | None) -> Campaign:
    """A campaign that was written in Python, of a script or of a folder, made from its words.

    Args:
        scene: a campaign, or what a folder stores of one.
        estimator: that of the script, where one gave it.

    Raises:
        ValueError: one that is not the campaign's.
    """
    if isinstance(scene, Campaign):
        campaign, source = scene, source_of_value(scene)
    else:
        campaign, source = campaign_of_words(scene), scene
    if estimator is not None:
        words, there = in_words(estimator), table_of(source.beside, "campaign").get("estimator")
        if words != there:
            raise ValueError(f"the campaign's estimator is {there}, not {words}: give that one, or another folder")
        campaign = dataclasses.replace(campaign, estimator=estimator)
    return dataclasses.replace(campaign, source=source)


def in_words(value: object, where: str = "campaign") -> object:
    """A value of a campaign as JSON has it.

    Args:
        value: of the campaign.
        where: name of the value, in messages.

    Raises:
        ValueError: the value holds what has no words, an open file for one.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": repr(value)}
    if isinstance(value, np.ndarray | jax.Array) and not np.asarray(value).dtype.hasobject:
        array = np.asarray(value)
        return {"array": as_text(array), "dtype": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, list | tuple):
        return [in_words(each, f"{where}[{number}]") for number, each in enumerate(value)]
    if isinstance(value, Mapping):
        return {str(name): in_words(each, f"{where}.{name}") for name, each in value.items()}
    names = {id(offered): name for name, offered in _offered().items()}
    if isinstance(value, type | FunctionType):
        own = {"own class": f"{value.__module__}.{value.__qualname__}", "source": source_checksum(value)}
        return {"offered": names[id(value)]} if id(value) in names else own
    kind = names.get(id(type(value)))
    if isinstance(value, enum.Enum) and kind is not None:
        return {"class": kind, "member": value.name}
    if dataclasses.is_dataclass(value):
        held = {each.name: getattr(value, each.name) for each in dataclasses.fields(value) if each.init}
    elif kind is None and next(_functions(type(value)), None) is not None and hasattr(value, "__dict__"):
        held = vars(value)
    else:
        raise ValueError(
            f"{where} is {short(repr(value), 200)}, which has no words: a campaign's folder keeps numbers, texts, "
            "arrays, functions and dataclasses of these"
        )
    fields = {name: in_words(each, f"{where}.{name}") for name, each in held.items()}
    if kind is not None:
        return {"class": kind, **fields}
    return {"own class": f"{type(value).__module__}.{type(value).__qualname__}", "fields": fields,
            f"source of {type(value).__name__}": source_checksum(type(value))}  # fmt: skip


def of_words(words: object, what: str) -> Any:
    """The value that stands in such words; `Given` for an object of the user's own.

    Args:
        words: as `in_words` gives them.
        what: field of the campaign, in messages.

    Raises:
        ValueError: words that `in_words` does not give, or that name what the packages do not offer.
    """
    if isinstance(words, list):
        return tuple(of_words(each, what) for each in words)
    if not isinstance(words, dict):
        return words
    if "own class" in words and "class" not in words:
        fields = ", ".join(f"{name}={short(json.dumps(each), 60)}" for name, each in words.get("fields", {}).items())
        return Given(what, f"{words['own class']}({fields})" if "fields" in words else words["own class"])
    if words.keys() == {"number"}:
        return float(words["number"])
    if words.keys() == {"array", "dtype", "shape"}:
        return from_text(words["array"], words["dtype"], tuple(words["shape"]))
    named = words.get("class", words.get("offered"))
    if named is None:
        return {name: of_words(each, what) for name, each in words.items()}
    offered = _offered().get(named)
    if offered is None:
        raise ValueError(f"{what} holds {short(str(named), 200)}, which this version does not have")
    if "class" not in words:
        return offered
    if isinstance(offered, type) and issubclass(offered, enum.Enum):
        return offered[words["member"]]
    if not dataclasses.is_dataclass(offered):
        raise ValueError(f"{what} holds {short(str(named), 200)}, which holds nothing")
    return offered(**{name: of_words(each, what) for name, each in words.items() if name != "class"})


def source_checksum(own: type | FunctionType) -> str:
    """Of the source of a class or a function of the user's own and of those that it uses, of the same modules.

    The values outside a function that it names count too, where they are numbers, texts, arrays or lists of these.
    What was defined where there is no source, by `exec` for one, has the checksum of its compiled code.
    """
    digest, values = hashlib.sha256(), set[str]()
    for each in _used_by(own, {}):
        digest.update(_source(each).encode())
        values.update(_values(each))
    digest.update("".join(sorted(values)).encode())
    return digest.hexdigest()[:16]


def _used_by(own: object, seen: dict[int, object]) -> Iterator[type | FunctionType]:
    """A class or function, and those of the user's own that it names."""
    own = inspect.unwrap(own) if callable(own) else own
    if id(own) in seen or not isinstance(own, type | FunctionType) or own.__module__.split(".")[0] in PACKAGES:
        return
    seen[id(own)] = own
    yield own
    for base in own.__mro__[1:] if isinstance(own, type) else ():
        yield from (each for each in _used_by(base, seen) if base.__module__ == own.__module__)
    for _, named in _named(own):
        if getattr(named, "__module__", None) == own.__module__:
            yield from _used_by(named, seen)


def _values(own: type | FunctionType) -> Iterator[str]:
    """Values that the functions of a class, or a function, name and do not hold."""
    for name, value in _named(own):
        if isinstance(value, bool | int | float | str | list | tuple | Mapping | np.ndarray | np.generic | jax.Array):
            with suppress(ValueError):  # what has no words is no number
                yield f"{name} = {json.dumps(in_words(value, name))}\n"


def _named(own: type | FunctionType) -> Iterator[tuple[str, object]]:
    """Names of what lies outside a function, or the functions of a class, and what they stand for."""
    functions = [own] if isinstance(own, FunctionType) else [each for _, each in _functions(own)]
    for function in functions:
        code = getattr(inspect.unwrap(function), "__code__", function.__code__)
        if code.co_filename == "<string>" and function is not own:
            continue  # made by `dataclass`, which wraps it
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        known = dict(function.__globals__)
        with suppress(ValueError):  # a cell that is empty still
            known |= {name: cell.cell_contents for name, cell in cells.items()}
        yield from ((name, known[name]) for name in _loaded(function.__code__) if name in known)


def _loaded(code: CodeType) -> Iterator[str]:
    """Names that compiled code, and functions in it, take from outside."""
    outside = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF")
    yield from dict.fromkeys(each.argval for each in dis.get_instructions(code) if each.opname in outside)
    for each in code.co_consts:
        if inspect.iscode(each):
            yield from _loaded(each)


def _functions(own: type) -> Iterator[tuple[str, FunctionType]]:
    """The methods that a class defines itself, not those that `dataclass` makes."""
    for name, each in vars(own).items():
        function = getattr(each, "fget", None) or getattr(each, "func", None) or getattr(each, "__func__", each)
        if isinstance(function, FunctionType) and function.__code__.co_filename != "<string>":
            yield name, function


def _source(own: type | FunctionType) -> str:
    """Source of a function; of a class its name, its plain attributes and the source of its methods.

    Python finds the source of a whole class by its module's file, which a notebook does not have; that of a function in
    the cell.
    """
    if isinstance(own, type):
        functions = dict(_functions(own))
        plain = (f"{name} = {each!r}" for name, each in vars(own).items() if name[:2] != "__" and name not in functions)
        parts = [*(_ADDRESS.sub("", each) for each in plain), *map(_source, functions.values())]
        return "\n".join([own.__qualname__, *parts])
    try:
        return inspect.getsource(own)
    except OSError:  # of no file at all
        code = own.__code__
        return repr((code.co_code.hex(), code.co_names, [each for each in code.co_consts if not inspect.iscode(each)]))
