"""Collapse of a column of dry sand in the plane: statics, similarity, and the run-out found in experiments."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics

WEIGHT, GRAVITY = 16e3, 9.81
# Sand that flows carries 0.6 of the normal stress as shear, its angle being some 31 degrees. In plane flow without
# dilation a slip plane carries the sine of the friction angle, not its tangent (Davis 1968).
SLIDING = 0.6
FRICTION = np.arcsin(SLIDING)
# Run-out over the initial width of columns of aspect ratio a, of sand (Lube et al. 2005, 10.1103/PhysRevE.72.041301)
# and of glass beads (Lajeunesse et al. 2005, 10.1063/1.2087592); both after Lagree et al. (2011),
# 10.1017/jfm.2011.335, section 3. What grains differ by is the scatter that a law for all of them has.
LOW = (1.2, 1.8)  # times a, below a = 1.8
TALL = (1.9, 2.3)  # times a^(2/3), above a = 2.8


def collapsed(aspect, cells):
    """Run-out over the initial width of a column `aspect` times as high as wide, and the speed left over sqrt(g H).

    The width is 1 m in `cells` cells, the wall behind smooth, the base as rough as the sand. APIC, since it loses
    little to the grid and has no share of PIC to choose.
    """
    cell, height = 1 / cells, float(aspect)
    soil = mpm.FrictionalSoil(
        cohesion=0.0,
        friction=float(np.degrees(FRICTION)),
        unit_weight=WEIGHT,
        young=50 * WEIGHT * height,
        tension_cutoff=0.0,
    )
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2, kernel=mpm.QuadraticBSpline, apic=True, flip=0.0)
    scene, state = mpm.block(
        (1.0, height),
        soil,
        numerics,
        domain=(np.ceil((1 + 2 * height) * cells) / cells, height + 2 * cell),
        corner=(0.0, 0.0),
        gravity=(0.0, -GRAVITY),
        walls="roller",
        speed=float(np.sqrt(2 * GRAVITY * height)),
    )
    walls = tuple(replace(w, hold="friction") if (w.axis, w.side) == (1, "low") else w for w in scene.walls)
    vertical = -WEIGHT * (height - scene.particles.position[1])
    lateral = 0.3 / 0.7 * vertical
    stress = state.stress.at[0].set(lateral).at[1].set(lateral).at[2].set(vertical)
    scene = replace(scene, walls=walls, wall_friction=jnp.asarray(SLIDING, stress.dtype))
    t_end = 5 * float(np.sqrt(height / GRAVITY))
    final = mpm.solve(scene, replace(state, stress=stress), t_end=t_end).raise_if_failed().state
    front = float(diagnostics.position(scene, final)[0].max()) + cell / 4
    return front - 1, float(diagnostics.speed(scene, final)) / np.sqrt(GRAVITY * height)


def test_low_columns_run_out_by_their_height_alone_and_rest_below_the_angle_of_friction():
    # A collapse that does not reach the wall behind has no length but the height: the linear law. Both are 4 cells
    # high.
    runs = [collapsed(aspect, cells) for aspect, cells in ((0.5, 8), (1.0, 4))]
    by_height = np.array([runs[0][0] / 0.5, runs[1][0] / 1.0])
    assert abs(by_height[1] / by_height[0] - 1) < 0.01
    # The sand that left the column lies at less than the angle of friction: a triangle as long as this, at least.
    assert np.all(by_height > 1 / (2 * np.tan(FRICTION)))
    assert max(speed for _, speed in runs) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("aspect", "law"), [(1.0, LOW), (3.0, np.array(TALL) * 3 ** (2 / 3))])
def test_run_out_lies_between_that_of_sand_and_of_glass_beads(aspect, law):
    # In experiments the front ends at single grains, here at single cells, and is the farther the smaller they are:
    # a = 1 gives 1.02, 1.27 and 1.44 with 8, 16 and 32 cells a width. At 16 a cell is a few grains of the experiments.
    runout, speed = collapsed(aspect, 16)
    assert law[0] < runout < law[1]
    assert speed < 0.01


@pytest.mark.slow
def test_run_out_of_tall_columns_grows_with_an_exponent_as_measured():
    # 0.65 +- 0.05 in narrow slots and 0.9 +- 0.1 in wide channels (Balmforth and Kerswell 2005,
    # 10.1017/S0022112005005537), whose walls hold back less; in plane strain there are none.
    aspects = np.array([3.0, 5.0, 8.0])
    measured = np.array([collapsed(aspect, 8)[0] for aspect in aspects])
    assert 0.65 - 0.05 < np.polyfit(np.log(aspects), np.log(measured), 1)[0] < 0.9 + 0.1
