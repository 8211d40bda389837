"""Campaigns whose runs are made up in milliseconds: the controller and its folder are real, only the solver is not."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from cooperative import runs
from cooperative.measure import ColumnPlan
from cooperative.scene import Calibration, Campaign, factors_of_safety, to_toml
from cooperative.scene._files import packed
from cooperative.store import FinishedRun
from jaxmpm import Raster

TINY = """
name = "tiny"
[slope]
crest = 8.0
height = 8.0
run_per_rise = 1.0
toe = 16.0
foundation = 2.0
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
softening_modulus = 85e3
residual_ratio = 0.5
tension_cutoff = 0.0
[strength]
mean = 30e3
cov = 0.4
length = [20.0, 4.0]
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 4.0
[campaign]
samples = 6
seed = 3
k_t = 2
estimator = "published"
fields = "both"
"""

LAYERED = TINY.replace(
    TINY[TINY.index("[slope]") : TINY.index("[soil]")],
    """[ground]
surface = [[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]
[[layer]]
name = "fill"
depth = 1.0
strength = { mean = 40e3, cov = 0.1 }
[[layer]]
name = "clay"
bottom = [[0.0, 1.0], [32.0, 1.0]]
[[layer]]
name = "rock"
rock = true
""",
)
"""The same slope, drawn as a section of three layers; with the same particles it runs the same programs."""

_HILL = Raster(np.linspace(10.0, 6.0, 5)[:, None] * np.ones(3), (0.0, 0.0), 4.0)
TERRAIN = LAYERED.replace(
    LAYERED[LAYERED.index("[ground]") : LAYERED.index("[soil]")],
    '[terrain]\nsurface = "hill"\nbase = 0.0\nx = [0.0, 16.0]\ny = [0.0, 8.0]\n',
)
TERRAIN = TERRAIN.replace("[20.0, 4.0]", "[20.0, 20.0, 4.0]").replace("[1.0, 1.0]", "[1.0, 1.0, 1.0]")
TERRAIN = TERRAIN.replace("[0.5, 0.5]", "[0.5, 0.5, 0.5]") + to_toml({"files": {"hill": packed("hill", _HILL)}})
"""A tilted plane under a terrain model, which the text holds itself."""

SCENE = TINY.replace("samples = 6", "samples = 50").replace('estimator = "published"', "refined_runs = 15")
LONG = SCENE.replace("samples = 50", "samples = 300").replace("refined_runs = 15", "refined_runs = 40")
SUBSET = SCENE.replace("samples = 50", 'samples = 40\nreplicates = 2\nlevels = 2\nestimator = "subset"').replace(
    "k_t = 2\n", ""
)
CALIBRATED = SCENE.replace("k_t = 2", "k_t = 2\ncalibrate = true")
SWEEP = SCENE.replace("samples = 50", "samples = 20\ncalibrate = true") + "[sweep]\ncov = [0.2, 0.4]\nk_t = [2, 3]\n"

STEPS = 77
"""Of each made-up run: marks it as made up."""

MODES, PARTICLES = 20, 6000
"""Of made-up grids: enough for a sample's file to take a while to write."""


def random_soil(campaign: Campaign) -> Any:
    """As much of a random soil as made-up runs need."""
    return SimpleNamespace(modes=MODES, counts=(MODES,))


TORN = "JAXMPM_TORN"
"""Environment variable with a folder: for each file in it one worker is killed halfway through sending a sample."""
VERIFIED = "JAXMPM_VERIFIED"
"""Environment variable with a file, which gets a byte for each file of fields that a controller verifies."""

REAL_COEFFICIENTS = runs.coefficients_of


def coefficients_of(campaign: Campaign, soil: Any) -> np.ndarray:
    """Independent ones, made without a compiled program."""

    def normal(_: Any, samples: int, modes: int) -> np.ndarray:
        return np.random.default_rng(campaign.plan.seed).standard_normal((samples, modes))

    return REAL_COEFFICIENTS(replace(campaign, plan=replace(campaign.plan, coefficients=normal)), soil)


def build(campaign: Campaign, grid: str, soil: Any, **_: Any) -> Any:
    """As much of a grid's model as made-up runs need."""
    absent: Any = None
    particles, nodes = SimpleNamespace(position=np.zeros((2, PARTICLES))), SimpleNamespace(shape=(2, 2))
    smooth = SimpleNamespace(friction=None)
    scene: Any = SimpleNamespace(particles=particles, grid=nodes, boundary=smooth, material=None)
    return runs.GridModel(grid, campaign, scene, absent, soil)


def ground_of(models: dict[str, Any]) -> runs.StoredGround:
    """As much of the ground as made-up runs are read by."""
    columns = ColumnPlan((0.0,), 1.0, (1,), ((0.0, 1.0),))
    grids = {
        grid: runs.StoredGrid(model.scene.particles.position, np.ones(2), columns, "made up")
        for grid, model in models.items()
    }
    samples = runs.samples_of(models["rough"].campaign)
    outline = (0.0, 0.0), (1.0, 1.0), np.zeros((2, 2)), None
    return runs.StoredGround(*outline, False, (), ("strength",), MODES, samples, grids, None, (0.0, 0.0), None, 1.0)


def keep_nothing(*_: Any) -> None:
    """Made-up grids have neither stress nor ground to be stored."""


def soil_of(*_: Any) -> runs.SampleSoil:
    """No random soil."""
    return runs.SampleSoil({}, 1.0)


def run_samples(
    model: Any,
    coefficients: Any,
    numbers: Any,
    *,
    seconds: float = 0.0,
    stop: Callable[[], bool] | None = None,
    **_: Any,
) -> Iterator[FinishedRun]:
    """Displacements that both grids see alike, with some scatter of their own; calibration scales the rough ones."""
    calibration = model.campaign.measured.calibration
    factor = 1.0 if calibration is None or model.grid == "refined" else calibration.factor
    for number in numbers:
        if stop is not None and stop():
            raise runs.Stopped
        time.sleep(seconds)
        xi = np.asarray(coefficients[number])
        noise = xi[1] if model.grid == "rough" else xi[2]
        displacement = float(np.exp(2.0 * (0.95 * xi[0] + 0.3 * noise) - 1.0)) / factor
        row: dict[str, Any] = {"displacement": displacement, "broke_off": False}
        row |= dict.fromkeys(("depth", "runout", "volume", "area"), displacement)
        fields = {"displacement": np.full((2, PARTICLES), displacement)}
        yield FinishedRun(number, "SETTLED", STEPS, seconds, xi, row, fields)


def invent(seconds: float = 0.0, put: Callable[[ModuleType, str, Any], None] = setattr) -> None:
    """Put made-up runs of so many seconds, and made-up factors of safety, in place of the solver's, wherever a module
    has a name for them."""

    def measure(*_: Any, **__: Any) -> Any:
        time.sleep(seconds)
        return Calibration(rough=1.25, refined=1.125)

    def timed(*arguments: Any, **choices: Any) -> Iterator[FinishedRun]:
        return run_samples(*arguments, **choices, seconds=seconds)

    made_up = {
        runs.random_soil: random_soil, REAL_COEFFICIENTS: coefficients_of, runs.build: build,
        runs.run_samples: timed, runs.keep_initial: keep_nothing, runs.keep_ground: keep_nothing,
        runs.keep_drawn: keep_nothing, runs.verify_initial: keep_nothing,
         runs.ground_of: ground_of, runs.soil_of: soil_of, factors_of_safety: measure,
    }  # fmt: skip
    for module in [module for name, module in sys.modules.items() if name.split(".")[0] == "cooperative"]:
        for real, substitute in made_up.items():
            if vars(module).get(real.__name__) is real:
                put(module, real.__name__, substitute)
