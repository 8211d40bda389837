"""A campaign as bytes for its workers, by cloudpickle: classes of a script or a notebook's cell go with it.

Only what the controller of a campaign has sent is unpickled, never what a folder holds.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from dataclasses import dataclass
from typing import Any

import cloudpickle

from cooperative.scene import Campaign
from foundation.pytrees import PYTREES, pytree


@dataclass(frozen=True)
class Packed:
    """A campaign in a task. key: checksum of its bytes, by which a worker knows it. content: these bytes, None where
    the worker is to know it already."""

    key: str
    content: bytes | None = None


class _Pickler(cloudpickle.Pickler):
    """Collects the pytrees whose classes go along: where these are made again, they have to be registered again."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.pytrees: list[type] = []

    def reducer_override(self, obj: Any) -> Any:
        reduced = super().reducer_override(obj)
        if reduced is not NotImplemented and isinstance(obj, type) and obj in PYTREES:
            self.pytrees.append(obj)
        return reduced


def packed(campaign: Campaign) -> Packed:
    """A campaign for its workers. Raises ValueError for one that holds what cannot be sent to another process."""
    file = io.BytesIO()
    pickler = _Pickler(file)
    try:
        # The list is pickled last, when it is complete.
        pickler.dump((campaign, pickler.pytrees))
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError, ValueError) as error:
        raise ValueError(
            f"the campaign cannot be sent to a worker ({error}): let its ground, soil and estimator hold numbers, "
            "texts, arrays and dataclasses of these, no open file, lock or generator"
        ) from error
    content = file.getvalue()
    return Packed(hashlib.sha256(content).hexdigest(), content)


def unpacked(content: bytes) -> Campaign:
    """The campaign that a controller has sent."""
    campaign, pytrees = pickle.loads(content)
    for each in pytrees:
        if each not in PYTREES:
            pytree(each)
    return campaign
