"""Campaigns whose runs are made up in milliseconds: the controller and its folder are real, only the solver is not."""

import sys
import time
from types import SimpleNamespace

import numpy as np

from cooperative import runs
from cooperative.store import Sample
from tests.test_campaign import TINY

SCENE = TINY.replace("samples = 6", "samples = 50").replace('estimator = "published"', "refined_runs = 15")
LONG = SCENE.replace("samples = 50", "samples = 300").replace("refined_runs = 15", "refined_runs = 40")
STEPS = 77
"""Of each made-up run: tells that it was made up."""


def expansion_of(config):
    return SimpleNamespace(modes=20)


def coefficients_of(config, expansion):
    return np.random.default_rng(config.plan.seed).standard_normal((config.plan.samples, expansion.modes))


def build(config, grid, expansion):
    return SimpleNamespace(grid=grid, config=config)


def run_samples(model, coefficients, numbers, *, seconds=0.0, **_):
    """Displacements that both grids see alike, with some scatter of their own."""
    for number in numbers:
        time.sleep(seconds)
        xi = np.asarray(coefficients[number])
        own = xi[1] if model.grid == "rough" else xi[2]
        displacement = float(np.exp(2.0 * (0.95 * xi[0] + 0.3 * own) - 1.0))
        row = {"displacement": displacement, "broke_off": False}
        row |= dict.fromkeys(("depth", "runout", "volume", "area"), displacement)
        fields = {"displacement": np.full((3, 4000), displacement)}
        yield Sample(number, "SETTLED", STEPS, seconds, xi, row, fields)


def invent(seconds=0.0, replace=setattr):
    """Put made-up runs of so many seconds in place of the solver's, wherever a module has a name for it."""
    made_up = {function.__name__: function for function in (expansion_of, coefficients_of, build)}
    made_up["run_samples"] = lambda *a, **k: run_samples(*a, **k, seconds=seconds)
    real = {name: getattr(runs, name) for name in made_up}
    for module in [module for name, module in sys.modules.items() if name.split(".")[0] == "cooperative"]:
        for name, function in real.items():
            if vars(module).get(name) is function:
                replace(module, name, made_up[name])
