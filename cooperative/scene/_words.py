"""A campaign in words, as its folder stores one that was written in Python, and back again.

What the packages offer is found again by its name. A law, a soil or a ground of the user's own is its class and its
fields, which tell it from another. The script has to give it again, and a checksum of the script's file tells whether
that changed. Nothing is executed.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import inspect
import json
import linecache
import math
import sys
import zlib
from collections.abc import Iterator, Mapping
from functools import cache
from types import FunctionType
from typing import Any

import jax
import numpy as np

import jaxmpm
import kl
from cooperative import estimate, measure
from cooperative.estimate import Estimator
from cooperative.scene import tables
from cooperative.scene._campaign import Campaign
from cooperative.scene._files import as_text, from_text
from cooperative.scene._site import Site, SiteLayer
from cooperative.store import SCRIPTS, Source, table_of
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import short

PACKAGES = {"builtins", "numpy", "jax", "jaxlib", "jaxmpm", "kl", "cooperative"}
"""Packages whose classes and functions are no user's own."""
OFFER = (
    *(jaxmpm, jaxmpm.laws, jaxmpm.soil, jaxmpm.setup, jaxmpm.ground, jaxmpm.transfer, jaxmpm.run),
    *(kl, kl.axis, kl.field, kl.marginal, estimate, measure),
)
"""Modules whose names a campaign's words hold, each after its package alone: `jaxmpm.MohrCoulomb`."""


@cache
def _offered() -> dict[str, type | FunctionType]:
    """Classes and functions of the packages that a campaign may hold, by name."""
    offered = {
        f"{module.__name__.partition('.')[0]}.{name}": getattr(module, name)
        for module in OFFER
        for name in module.__all__
    }
    parts = (kind for kind in vars(tables).values() if isinstance(kind, type) and issubclass(kind, tables.Part))
    offered |= {f"cooperative.{kind.__name__}": kind for kind in (Site, SiteLayer, *parts)}
    return {name: value for name, value in offered.items() if isinstance(value, type) or _is_pure(value)}


def _is_pure(value: object) -> bool:
    """Whether this is a function that opens no file: a folder of somebody else chooses what is called."""
    return isinstance(value, FunctionType) and "path" not in inspect.signature(value).parameters


ADDED_BY_FOLDER = ("measured", "raised", "source")
"""Fields of a campaign that its folder adds."""


def source_of_value(campaign: Campaign) -> Source:
    """What a campaign that was written in Python is made from: its fields in words.

    Raises:
        ValueError: what has no words.
    """
    words = {name: in_words(getattr(campaign, name), name) for name in _fields_of_script(campaign)}
    scripts = _scripts_of(campaign)
    return Source(None, {"campaign": words, **({SCRIPTS: scripts} if scripts else {})})


def is_same(one: Campaign, other: Campaign) -> bool:
    """Whether two campaigns are the same, in the words of all that a script gives."""
    return source_of_value(one).beside == source_of_value(other).beside


def campaign_of_words(source: Source) -> Campaign:
    """The campaign that was written in Python, with `FromScript` for what its script has to give again.

    Raises:
        ValueError: words that are not of a campaign.
    """
    try:
        fields = {name: of_words(words, name) for name, words in table_of(source.beside, "campaign").items()}
        return Campaign(**fields)
    except (AttributeError, KeyError, TypeError, ValueError, zlib.error) as error:
        raise Invalid((), None, f"campaign.db holds no campaign ({error})", "put back what it began with") from error


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
            raise Invalid(
                (), None, f"the campaign's estimator is {there}, not {words}", "give that one, or another folder"
            )
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
        return [in_words(item, f"{where}[{number}]") for number, item in enumerate(value)]
    if isinstance(value, Mapping):
        return {str(name): in_words(item, f"{where}.{name}") for name, item in value.items()}
    names = {id(offered): name for name, offered in _offered().items()}
    if isinstance(value, type | FunctionType):
        return {"offered": names[id(value)]} if id(value) in names else {"own class": _name_of(value)}
    kind = names.get(id(type(value)))
    if isinstance(value, enum.Enum) and kind is not None:
        return {"class": kind, "member": value.name}
    if dataclasses.is_dataclass(value):
        attributes = {part.name: getattr(value, part.name) for part in dataclasses.fields(value) if part.init}
    elif kind is None and any(isinstance(method, FunctionType) for method in vars(type(value)).values()):
        attributes = vars(value)
    else:
        raise Invalid(
            (),
            where,
            f"is {short(repr(value), 200)}, which has no words",
            "a campaign's folder keeps numbers, texts, arrays, functions and dataclasses of these",
        )
    fields = {name: in_words(item, f"{where}.{name}") for name, item in attributes.items()}
    if kind is not None:
        return {"class": kind, **fields}
    return {"own class": _name_of(type(value)), "fields": fields}


def _name_of(value: type | FunctionType) -> str:
    """The name of a class or a function of the user's own."""
    return f"{value.__module__}.{value.__qualname__}"


def _own_in(value: object) -> Iterator[type | FunctionType]:
    """Classes and functions of the user's own in a value of a campaign."""
    if isinstance(value, type | FunctionType):
        if value.__module__.partition(".")[0] not in PACKAGES:
            yield value
    elif isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _own_in(part)
    elif hasattr(value, "__dict__"):
        yield from _own_in(type(value))
        yield from _own_in(vars(value))


def _scripts_of(campaign: Campaign) -> dict[str, str]:
    """SHA-256 of what defines classes and functions of the user's own, by their names."""
    every = _own_in({name: getattr(campaign, name) for name in _fields_of_script(campaign)})
    return {_name_of(value): hashlib.sha256(_script_of(value).encode()).hexdigest() for value in every}


def _script_of(value: type | FunctionType) -> str:
    """Text of the file, or of a notebook's cell, that defines a class or a function."""
    parts = [value] if isinstance(value, FunctionType) else vars(value).values()
    names = {part.__code__.co_filename for part in parts if isinstance(part, FunctionType)}
    names.add(getattr(sys.modules.get(value.__module__), "__file__", None) or "")
    linecache.checkcache()
    return "".join(line for name in sorted(names) for line in linecache.getlines(name))


def _fields_of_script(campaign: Campaign) -> list[str]:
    return [part.name for part in dataclasses.fields(campaign) if part.name not in ADDED_BY_FOLDER]


def of_words(words: object, what: str) -> Any:
    """The value that stands in such words; `FromScript` for an object of the user's own.

    Args:
        words: as `in_words` gives them.
        what: field of the campaign, in messages.

    Raises:
        ValueError: words that `in_words` does not give, or that name what the packages do not offer.
    """
    if isinstance(words, list):
        return tuple(of_words(item, what) for item in words)
    if not isinstance(words, dict):
        return words
    if "own class" in words and "class" not in words:
        fields = ", ".join(f"{name}={short(json.dumps(item), 60)}" for name, item in words.get("fields", {}).items())
        return tables.FromScript(what, f"{words['own class']}({fields})" if "fields" in words else words["own class"])
    if words.keys() == {"number"}:
        return float(words["number"])
    if words.keys() == {"array", "dtype", "shape"}:
        return from_text(words["array"], words["dtype"], tuple(words["shape"]))
    named = words.get("class", words.get("offered"))
    if named is None:
        return {name: of_words(item, what) for name, item in words.items()}
    offered = _offered().get(named)
    if offered is None:
        raise Invalid((), what, f"holds {short(str(named), 200)}, which this version does not have", "")
    if "class" not in words:
        return offered
    if isinstance(offered, type) and issubclass(offered, enum.Enum):
        return offered[words["member"]]
    if not dataclasses.is_dataclass(offered):
        raise Invalid((), what, f"holds {short(str(named), 200)}, which holds nothing", "")
    return offered(**{name: of_words(item, what) for name, item in words.items() if name != "class"})
