"""Pictures of states: particles where they are, in the colours of what is asked for."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import plot

SOIL = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3)


@pytest.fixture(scope="module")
def section():
    scene, state = mpm.section(mpm.Section([(0, 3), (4, 3)]), SOIL, mpm.Discretisation(1.0, (0.5, 0.5)), at_rest=False)
    moved = state.displacement.at[0].set(0.1 * scene.particles.position[1])
    return scene, replace(state, displacement=moved, history=state.history + 0.25)


def drawn(figure):
    (boxes,) = figure.axes[0].collections
    return boxes, figure.axes[1].get_ylabel()


LABELS = {
    "displacement": "displacement (m)",
    "speed": "speed (m/s)",
    "pressure": "mean stress in compression (kPa)",
    "shear_stress": "sqrt(J2) (kPa)",
    "plastic_strain": "plastic shear strain",
    "strength": "strength (Pa)",
}


@pytest.mark.parametrize("colour", LABELS)
def test_particles_are_drawn_where_they_are(section, colour):
    scene, state = section
    figure = plot.state(scene, state, colour)
    boxes, name = drawn(figure)
    assert name == LABELS[colour]
    assert figure.dpi == 144
    centres = np.array([path.vertices[:4].mean(axis=0) for path in boxes.get_paths()])
    np.testing.assert_allclose(centres.T, mpm.diagnostics.position(scene, state), atol=1e-6)
    area = np.prod(np.ptp(boxes.get_paths()[0].vertices[:4], axis=0))
    assert area == pytest.approx(float(scene.particles.volume[0]), rel=1e-5)
    assert boxes.get_array().shape == scene.particles.mass.shape


def test_a_field_of_ones_own_is_drawn_as_it_is(section):
    scene, state = section
    own = np.arange(scene.particles.mass.size)
    np.testing.assert_array_equal(drawn(plot.state(scene, state, own))[0].get_array(), own)


def test_a_body_in_3d_is_cut_once():
    scene, state = mpm.column(3.0, SOIL, mpm.Discretisation(1.0, (0.5, 0.5, 0.5)), at_rest=False)
    y = np.asarray(scene.particles.position[1])
    boxes, _ = drawn(plot.state(scene, state, np.arange(y.size), y=0.8))
    assert np.all(y[np.asarray(boxes.get_array(), int)] == 0.75)
    assert len(boxes.get_paths()) == np.count_nonzero(y == 0.75)


def test_an_animation_has_a_frame_for_each_snapshot_and_one_scale(section, tmp_path):
    scene, _ = section
    result = mpm.solve(scene, mpm.unstressed(scene), t_end=0.1, snapshots=(0.0, 0.05, 0.1))
    film = plot.animate(scene, result)
    film.save(tmp_path / "run.gif", dpi=40)
    assert (tmp_path / "run.gif").read_bytes()[:3] == b"GIF"
    axes = film._fig.axes[0]
    largest = max(float(mpm.diagnostics.largest_displacement(each)) for each in result.snapshots)
    assert axes.collections[0].get_clim() == (0.0, pytest.approx(largest))
    assert axes.get_title() == "0.1 s"


def test_what_has_no_picture_is_refused(section):
    scene, state = section
    with pytest.raises(ValueError, match=r"colour = 'cohesion': give one of .*'displacement'.*'strength'"):
        plot.state(scene, state, "cohesion")
    with pytest.raises(ValueError, match=r"colour has shape \(3,\): give \("):
        plot.state(scene, state, np.ones(3))
    with pytest.raises(ValueError, match="the state's displacement has shape"):
        plot.state(scene, mpm.run.repeat(state, 2))
    with pytest.raises(ValueError, match="the run has no snapshots"):
        plot.animate(scene, [])
    with pytest.raises(ValueError, match="a scene in 1D has no picture"):
        plot.state(*mpm.column(3.0, SOIL, mpm.Discretisation(1.0, (0.5,)), at_rest=False))
    with pytest.raises(ValueError, match="y = 1 m of a scene in 2D: leave it out"):
        plot.state(scene, state, y=1.0)


def test_an_element_test_has_its_figure():
    law = mpm.laws.J2(*(jnp.asarray(each) for each in (5e6, 2e6, 9e3)))
    test = mpm.laws.element_test(law, "oedometer", pressure=1e4, strain=0.02, steps=20)
    figure = test.figure()
    lines = [axes.lines[0].get_xydata() for axes in figure.axes]
    np.testing.assert_allclose(lines[0][:, 1] * 1e3, test.deviatoric, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(lines[2][:, 0] * 1e3, test.vertical_stress, rtol=1e-5)
    assert figure.axes[2].get_xscale() == "log"
