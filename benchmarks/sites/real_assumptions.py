"""What another assumption does to the real slides where data are missing: the mean soil on the rough grid.

The spread of Sainte-Monique stands with its mean soil, so that its strength is multiplied by 0.7 in all its rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from benchmarks.accuracy.runout_convergence import measures
from benchmarks.measure import ROOT
from cooperative.scene import Campaign, built, parse, read_scene, to_toml
from jaxmpm import Settle, solve

SCENES = ROOT / "benchmarks" / "scenes" / "real"
Tables = dict[str, Any]


def as_given(tables: Tables) -> None:
    """The scene as it stands."""


def of_height(height: float) -> Callable[[Tables], None]:
    """The spread's slope of another height (m), with the same angle, valley and half as high a bank."""

    def change(tables: Tables) -> None:
        toe = 148.0 + height / math.tan(math.radians(24.0))
        run = height / 2 / math.tan(math.radians(26.0))
        bank = [[toe + 10.0, 0.0], [toe + 10.0 + run, height / 2], [300.0, height / 2]]
        tables["ground"] |= {"surface": [[0.0, height], [148.0, height], [toe, 0.0], *bank], "toe": toe}
        tables["layer"][0]["bottom"] = [[0.0, 0.0], *bank]
        tables["layer"][0]["strength"]["trend_from"] = height

    return change


def level_valley(tables: Tables) -> None:
    """No bank across the valley."""
    tables["ground"]["surface"] = [[0.0, 16.0], [148.0, 16.0], [184.0, 0.0], [300.0, 0.0]]
    tables["layer"] = tables["layer"][:1]
    tables["layer"][0].pop("bottom")


def lifts_reversed(tables: Tables) -> None:
    """The dam's blow counts from the top down in place of from the base up."""
    lifts = [layer for layer in tables["layer"] if layer["name"].startswith("upstream lift")]
    ratios = [layer["strength_ratio"] for layer in lifts]
    for layer, ratio in zip(lifts, reversed(ratios), strict=True):
        layer["strength_ratio"] = ratio


def dikes_liquefied(tables: Tables) -> None:
    """The upstream dikes as strong as the lowest lift."""
    dike = next(layer for layer in tables["layer"] if layer["name"] == "upstream dikes")
    lift = next(layer for layer in tables["layer"] if layer["name"] == "upstream lift 1")
    dike.pop("friction")
    dike |= {key: lift[key] for key in ("young", "strength_minimum", "strength_ratio")}


OTHERS: Mapping[str, Mapping[str, Callable[[Tables], None]]] = {
    "lower_san_fernando_1971": {
        "as assumed": as_given,
        "blow counts from the top down": lifts_reversed,
        "dikes liquefied too": dikes_liquefied,
    },
    "sainte_monique_1994": {
        "as assumed: 16 m high": as_given,
        "12 m high": of_height(12.0),
        "20 m high": of_height(20.0),
        "no bank across the valley": level_valley,
    },
}
FACTOR = {"lower_san_fernando_1971": 1.0, "sainte_monique_1994": 0.7}
"""On the strength of the mean soil."""


def scene_of(name: str, assumption: str) -> Campaign:
    """The scene of a slide under an assumption, with the strength of its mean soil."""
    tables: Tables = deepcopy(read_scene(SCENES / f"{name}.toml").tables)
    OTHERS[name][assumption](tables)
    tables["run"]["strength_factor"] = FACTOR[name]
    return parse(to_toml(tables))


def other(name: str, assumption: str) -> dict[str, str | float]:
    """The slide of the mean soil under an assumption."""
    campaign = scene_of(name, assumption)
    scene, state = built(campaign, "rough")
    ended = solve(scene, state, t_end=campaign.run.t_end, settle=Settle()).raise_if_failed()
    arrays = (scene.particles.position, ended.state.displacement, scene.particles.volume)
    position, displacement, volume = (np.asarray(each, float) for each in arrays)
    face = campaign.site.shape.face
    assert face is not None
    half, slid = campaign.grids["rough"].spacing[0] / 2, campaign.run.failure_displacement
    sliding = np.linalg.norm(displacement, axis=0) >= slid
    answer: dict[str, str | float] = {"slide": name, "assumption": assumption}
    if not sliding.any():
        return answer | {"runout_m": 0.0, "runout_95_m": 0.0, "travel_m": 0.0, "slid_m2": 0.0}
    row = measures(position, displacement, volume, origin=face.toe_x, half=half, slid=slid)
    travel = float(face.toe_x - position[0, sliding].min() + half + row["front_m"])
    values = {"runout_m": row["front_m"], "runout_95_m": row["front_95_m"], "travel_m": travel, "slid_m2": row["slid"]}
    return answer | {key: round(float(value), 1) for key, value in values.items()}
