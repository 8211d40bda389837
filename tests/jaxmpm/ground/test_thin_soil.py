"""Soil that thins out to nothing on bedrock, as every scar does: it rests, and what cannot rest is named."""

import math
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.equations import gap_of
from jaxmpm.setup._stable import highest_frequency

SAND = mpm.FrictionalSoil(5e5, 30.0, young=1e8, unusual=True)
CLAY = mpm.Soil(strength=5e5, young=1e8, unusual=True)


def scar(dimension, angle, thick, power, *, centre=20.0, half=8.0, cell=1.0):
    """Ground 40 m long whose bedrock falls at an angle under a lens of soil; 10 m wide in 3D."""
    slope = math.tan(math.radians(angle))
    x = np.linspace(0, 40, 41 if dimension == 3 else 161)

    def lens(r):
        return np.maximum(thick * (1 - np.abs(r) ** power), 0)

    if dimension == 2:
        bed = (40 - x) * slope
        surface = bed + lens((x - centre) / half)
        lines = [list(zip(x.tolist(), z.tolist(), strict=True)) for z in (surface, bed)]
        return {"surface": lines[0], "base": -2 * cell, "bedrock": lines[1]}
    along, across = np.meshgrid(x, np.arange(11.0), indexing="ij")
    bed = (40 - along) * slope
    heights = bed + lens(np.hypot((along - centre) / half, (across - 5) / 4))
    rasters = [mpm.Raster(z, (0.0, 0.0), 1.0) for z in (heights, bed)]
    return {"surface": rasters[0], "base": -2 * cell, "bedrock": rasters[1]}


def settled(dimension, angle, thick, power, soil, sticking, cell=1.0, cfl=0.9, **shape):
    """A scar of strong soil, and how far (cells) its soil moves in a fifth of a second."""
    ground = scar(dimension, angle, thick, power, cell=cell, **shape)
    interface = None if sticking else mpm.Interface(20.0, cohesion=5e5)
    kind, build = (mpm.Section, mpm.section) if dimension == 2 else (mpm.Terrain, mpm.terrain)
    numerics = mpm.Discretisation(cell, (cell / 2,) * dimension, cfl=cfl)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene, state = build(kind(**ground, interface=interface), soil, numerics)
    ended = mpm.solve(scene, state, t_end=0.2).raise_if_failed()
    moved = float(jnp.max(jnp.abs(ended.state.displacement))) / cell
    return scene, moved if np.isfinite(np.asarray(state.stress)).all() else np.nan


def test_clay_on_a_bed_that_it_can_slide_on_rests_where_it_thins_out():
    _, moved = settled(2, 33.0, 3.93, 1, CLAY, sticking=False, centre=16.2, half=11.0)
    assert moved < 0.02


def test_a_chain_of_single_particles_gets_a_time_step_that_it_is_stable_with():
    scene, moved = settled(2, 59.0, 2.97, 1, SAND, sticking=False, centre=17.8, half=12.0)
    assert moved < 0.02
    alone, _ = settled(2, 59.0, 2.97, 1, SAND, sticking=False, centre=17.8, half=12.0, cfl=0.5)
    assert float(scene.numerics.time_step) == pytest.approx(float(alone.numerics.time_step))
    assert float(scene.numerics.time_step) * float(highest_frequency(scene)) < 1.9


def test_a_lens_of_one_cell_keeps_a_stable_step_as_it_moves():
    _, moved = settled(2, 62.0, 1.0, 1, SAND, sticking=False, centre=15.0, half=7.0)
    assert moved < 0.02


def test_cohesion_holds_soil_on_rock_so_steep_that_it_hangs_over_the_steps_of_the_nodes():
    """Without the nodes below, which press, it would move 0.0135 cells in these 0.2 s, and 0.2 in 1.6 s."""
    _, moved = settled(2, 64.0, 3.0, 2, SAND, sticking=False, centre=17.0, half=10.0)
    assert moved < 0.002


@pytest.mark.slow  # each example compiles programs of its own
@settings(max_examples=16, deadline=None)
@given(
    dimension=st.sampled_from([2, 3]),
    angle=st.floats(2.0, 65.0),
    thick=st.floats(1.0, 4.0),
    power=st.sampled_from([1, 2, 4]),
    soil=st.sampled_from([SAND, CLAY]),
    sticking=st.booleans(),
    centre=st.floats(15.0, 25.0),
    half=st.floats(6.0, 14.0),
)
def test_soil_that_thins_out_rests_on_steep_and_gentle_bedrock(dimension, angle, thick, power, soil, sticking, **shape):
    _, moved = settled(dimension, angle, thick, power, soil, sticking, **shape)
    assert moved < 0.02


def test_what_cannot_rest_is_named_with_its_place():
    ground = mpm.Section(**scar(2, 59.0, 2.97, 1, centre=17.8, half=12.0), interface=mpm.Interface(20.0, cohesion=5e5))
    with pytest.warns(UserWarning, match=r"thins out starts without equilibrium, .* of all at \d+ nodes, .* at \("):
        mpm.section(ground, CLAY, mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.5))


def test_a_body_that_nothing_holds_is_not_blamed_on_its_moduli():
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    scene, _ = mpm.block((2.0, 2.0), CLAY, numerics, domain=(8.0, 8.0), corner=(3.0, 3.0), gravity=(0.0, -9.81))
    with pytest.raises(ValueError, match=r"nothing holds 1 of the soil against its load, most of it at \(4, 4\) m"):
        mpm.at_rest(scene)


def test_averaged_clay_on_a_bed_that_it_can_slide_on_has_an_initial_stress():
    ground = mpm.Section(**scar(2, 20.0, 4.0, 2), interface=mpm.Interface(20.0, cohesion=5e5))
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), cell_average=True)
    _, state = mpm.section(ground, CLAY, numerics)
    assert 5e4 < -float(jnp.min(state.stress[2])) < 1.5e5


@given(st.floats(2.0**-100, 2.0**100, width=32), st.floats(0.0, 2.0**100, width=32))
def test_a_gap_is_a_share_of_a_cell_whatever_the_masses(first, second):
    gap = float(gap_of(jnp.float32(first), jnp.float32(second)))
    assert 0 <= gap < 1
    if first >= second / 2:
        assert gap == 0
