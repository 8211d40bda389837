"""How far a slide may run by its energy, and the ground that there is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cooperative.example_scenes import example
from cooperative.runs import reach_of
from cooperative.runs._reach import run_out
from cooperative.scene import parse
from tests.scenes import tables

DEMO = example("demo")


def ends_of(height: float, length: float, run: float) -> tuple[float, float]:
    """Height and way that the centre of a block loses and goes until it has the profile of its end."""
    whole = length + run
    return height / 2 - 9 / 16 * height * length / whole, 0.4 * whole - length / 2


@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_the_centre_of_soil_with_friction_follows_the_energy_line(friction):
    run = run_out(np.full(100, 2.0), 5.0, 0.0, friction)
    down, along = ends_of(2.0, 5.0, run)
    assert down / along == pytest.approx(friction, rel=0.02)


def test_soil_with_cohesion_loses_what_its_base_takes():
    run = run_out(np.full(100, 12.0), 40.0, 1.0, 0.0)
    down, along = ends_of(12.0, 40.0, run)
    assert down * 12.0 * 40.0 == pytest.approx(1.0 * (40.0 + run / 2) * along, rel=0.02)


def test_strong_soil_stays_and_weaker_soil_goes_farther():
    height = np.minimum(np.linspace(24.0, 0.0, 100), 12.0)
    runs = [run_out(height, 40.0, cohesion, 0.0) for cohesion in (1000.0, 2.0, 1.0, 0.5)]
    assert runs[0] < 0.5
    assert all(weaker > stronger for stronger, weaker in pairwise(runs))
    assert run_out(np.zeros(100), 40.0, 1.0, 0.0) == 0.0


def test_the_ground_of_a_scene_is_held_against_the_run_out_of_its_residual_strength():
    campaign = parse(DEMO)
    reach = reach_of(campaign)
    assert reach is not None
    assert reach.ground == campaign.site.shape.extent[0] - campaign.site.shape.face.toe_x
    weaker = reach_of(replace(campaign, run=replace(campaign.run, strength_factor=0.5)))
    assert weaker is not None
    assert weaker.slide > reach.slide > 0
    assert weaker.short


WEDGE = """
[ground]
surface = [[0, 10], [20, 10], [40, 0], [80, 0]]
base = -2.0
toe = 40.0
%s
[soil]
unit_weight = 20e3
young = 5e7
poisson = 0.3
cohesion = 2e3
friction = { mean = 30.0, cov = 0.1, length = [20.0, 2.0] }
"""


def test_a_weak_contact_lets_a_slide_go_farther_and_farther_once_it_softens():
    def slide(contact=None):
        given = "" if contact is None else f"interface = {{ {contact} }}"
        return reach_of(parse(WEDGE % given + tables(1.0))).slide

    softened = slide("friction = 12.0, residual_ratio = 0.5, slip_length = 0.2")
    assert slide() == slide("friction = 40.0") < slide("friction = 12.0") < softened
    half = math.degrees(math.atan(math.tan(math.radians(12.0)) / 2))
    assert softened == pytest.approx(slide(f"friction = {half}"))


OF_20_DEGREES = math.sqrt(3) * math.tan(math.radians(20.0))
LAWS = {
    "static_friction = 20.0\ndynamic_friction = 30.0\ngrain_size = 0.01": ("mu(I)", "cohesion = 0.0\nfriction = 20.0"),
    f"compression = 0.1\nswelling = 0.02\ncritical_state = {OF_20_DEGREES}": (
        "modified cam clay",
        "cohesion = 0.0\nfriction = 20.0",
    ),
    "active_strength = 4e4\nsimple_strength = 3e4\npassive_strength = 2e4": ("anisotropic undrained", "strength = 3e4"),
}


@pytest.mark.parametrize("numbers", LAWS)
def test_a_law_reaches_as_far_as_soil_of_its_strength_in_simple_shear(numbers):
    law, as_far_as = LAWS[numbers]

    def slide(numbers):
        text = WEDGE % "" + tables(1.0)
        varying = "unit_weight = { mean = 20e3, cov = 0.05, length = [20.0, 2.0] }\n"
        young = "" if "compression" in numbers else "young = 5e7\n"
        given = f"[soil]\n{varying}{young}poisson = 0.3\n{numbers}\n"
        return reach_of(parse(text.replace(text[text.index("[soil]") : text.index("[rough]")], given))).slide

    assert slide(f'law = "{law}"\n{numbers}') == pytest.approx(slide(as_far_as), rel=1e-6)
