"""States on disk: restart points that go on bit for bit, and series of particles that VTK reads back."""

from dataclasses import replace

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.hostile_files import lay_baits, no_files, replacements_of, resealed
from jaxmpm.support.files import DamagedFile

SLOPE = mpm.Slope(crest=6.0, height=4.0, run_per_rise=1.0, toe=6.0, foundation=2.0)
COARSE = {2: mpm.Discretisation(cell=2.0, spacing=(1.0, 1.0)), 3: mpm.Discretisation(cell=2.0, spacing=(1.0, 1.0, 1.0))}
SOIL = mpm.Soil(strength=12e3, softening_modulus=85e3, residual_ratio=0.5, tension_cutoff=0.0)


def scene_of(dimension=2):
    shape = replace(SLOPE, width=4.0) if dimension == 3 else SLOPE
    return mpm.slope(shape, SOIL, COARSE[dimension])


def assert_same_bits(first, second):
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert np.asarray(a).dtype == np.asarray(b).dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_a_run_goes_on_from_its_restart_point_bit_for_bit(tmp_path):
    scene, start = scene_of()
    half = mpm.advance(scene, start, 60)
    mpm.save_state(tmp_path / "restart.h5", half, about={"watch": np.array([0.25, 1.5]), "number": 7, "grid": "rough"})
    again, about = mpm.load_state(tmp_path / "restart.h5", start)
    assert_same_bits(again, half)
    assert jax.tree.structure(again) == jax.tree.structure(start)
    assert_same_bits(mpm.advance(scene, again, 60), mpm.advance(scene, half, 60))
    assert about["watch"].tolist() == [0.25, 1.5]
    assert (about["number"], about["grid"]) == (7, "rough")


def test_values_that_are_not_finite_and_histories_of_several_leaves_are_stored(tmp_path):
    _, start = scene_of()
    history = {"strain": start.history + jnp.nan, "rate": start.history}
    odd = replace(start, history=history, affine=jnp.full((2, 2, start.velocity.shape[1]), -0.0))
    mpm.save_state(tmp_path / "odd.h5", odd)
    assert_same_bits(mpm.load_state(tmp_path / "odd.h5", odd)[0], odd)


def test_a_state_of_another_scene_is_refused(tmp_path):
    scene, start = mpm.slope(SLOPE, SOIL, replace(COARSE[2], internal_length=2.0))
    half = mpm.advance(scene, start, 60)
    mpm.save_state(tmp_path / "half.h5", half)
    assert_same_bits(mpm.load_state(tmp_path / "half.h5", start)[0], half)
    with pytest.raises(ValueError, match="give its own scene"):
        mpm.load_state(tmp_path / "half.h5", replace(start, unaveraged=None))


def test_float64_stays_float64(tmp_path, x64):
    _, start = mpm.slope(SLOPE, SOIL, replace(COARSE[2], dtype="float64"), at_rest=False)
    mpm.save_state(tmp_path / "double.h5", start)
    assert mpm.load_state(tmp_path / "double.h5", start)[0].stress.dtype == jnp.float64


@pytest.mark.parametrize("name", ["state/displacement", "state/history", "about/watch"])
def test_a_restart_point_that_lies_is_refused_in_one_line_and_reads_nothing_elsewhere(name, tmp_path):
    _, start = scene_of()
    path = tmp_path / "campaign" / "restart.h5"
    path.parent.mkdir()
    mpm.save_state(path, start, about={"watch": np.zeros(3)})
    whole, baits = path.read_bytes(), lay_baits(tmp_path / "outside")
    for how, change in replacements_of(name, baits).items():
        # What a caller adds may be a text, or be missing: that is for the caller to judge.
        if how in ("about/watch: text", "about/watch: missing"):
            continue
        path.write_bytes(resealed(whole, change))
        assert_refused(path, start, how)
    for how, make in no_files(baits).items():
        path.unlink()
        make(path)
        assert_refused(path, start, how)
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
        path.write_bytes(whole)
    assert baits.untouched()
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def assert_refused(path, start, how):
    with pytest.raises(ValueError, match=r"restart\.h5") as refused:
        mpm.load_state(path, start)
    assert str(refused.value).isprintable(), how
    assert len(str(refused.value)) < 500 + len(str(path)), how


def test_restart_points_of_another_scene_are_refused_by_name(tmp_path):
    _, start = scene_of()
    mpm.save_state(tmp_path / "restart.h5", start)
    with pytest.raises(ValueError, match="holds displacement as"):
        mpm.load_state(tmp_path / "restart.h5", scene_of(3)[1])
    with pytest.raises(ValueError, match="history"):
        mpm.load_state(tmp_path / "restart.h5", replace(start, history=None))


def test_damaged_restart_points_are_refused_by_name(tmp_path):
    _, start = scene_of()
    path = tmp_path / "restart.h5"
    mpm.save_state(path, start)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0x08
    for content in (whole[:-50], bytes(flipped), b"", b"a photograph", whole[512:]):
        path.write_bytes(content)
        with pytest.raises(DamagedFile, match=r"restart\.h5"):
            mpm.load_state(path, start)


def vtk_steps(path):
    """Times of a VTKHDF file, and at each one points and fields, as VTK reads them."""
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    key = reader.GetExecutive().TIME_STEPS()
    times = reader.GetOutputInformation(0).Get(key)
    steps = []
    for time in times:
        reader.UpdateTimeStep(time)
        grid = reader.GetOutputDataObject(0)
        data = grid.GetPointData()
        assert grid.GetNumberOfCells() == grid.GetNumberOfPoints()
        assert {grid.GetCellType(cell) for cell in range(grid.GetNumberOfCells())} == {1}
        fields = {data.GetArrayName(i): vtk_to_numpy(data.GetArray(i)).copy() for i in range(data.GetNumberOfArrays())}
        steps.append((vtk_to_numpy(grid.GetPoints().GetData()).copy(), fields))
    return list(times), steps


@pytest.mark.parametrize("dimension", [2, 3])
def test_vtk_reads_a_run_back(dimension, tmp_path):
    scene, start = scene_of(dimension)
    strength = jnp.linspace(4e3, 6e3, scene.particles.mass.size, dtype=jnp.float32)
    scene = mpm.with_soil(scene, start, strength=strength)[0]
    result = mpm.solve(scene, start, t_end=1.5, snapshots=(0.5, 1.0, 1.5))
    mpm.write_vtkhdf(tmp_path / "run.vtkhdf", scene, result.snapshots, result.times)

    times, steps = vtk_steps(tmp_path / "run.vtkhdf")
    np.testing.assert_allclose(times, result.times)
    axes = [0, 2] if dimension == 2 else [0, 1, 2]
    components = [0, 1, 2, 5] if dimension == 2 else range(6)
    position = np.asarray(scene.particles.position)
    for state, (points, fields) in zip(result.snapshots, steps, strict=True):
        np.testing.assert_array_equal(points[:, axes].T, position + state.displacement)
        np.testing.assert_array_equal(fields["displacement"][:, axes].T, state.displacement)
        of_grid = mpm.diagnostics.grid_velocity(scene, jax.tree.map(jnp.asarray, state))
        np.testing.assert_allclose(fields["velocity"][:, axes].T, of_grid, rtol=1e-5, atol=1e-7)
        np.testing.assert_array_equal(fields["stress"][:, components].T, state.stress)
        np.testing.assert_array_equal(fields["plastic_strain"], state.history)
        np.testing.assert_array_equal(fields["strength"], strength)
        if dimension == 2:
            assert not points[:, 1].any()
            assert not fields["stress"][:, [3, 4]].any()
    assert np.abs(steps[-1][1]["displacement"]).max() > np.abs(steps[0][1]["displacement"]).max() > 0


def test_velocities_that_cancel_at_the_nodes_are_not_written(tmp_path):
    # Particles of a block that stand half a cell apart, with velocities that alternate from one to the next.
    scene, start = mpm.block((4, 4), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)), domain=(8, 8), corner=(2, 2))
    index = np.floor(np.asarray(scene.particles.position) / 0.5).astype(int)
    ringing = jnp.asarray((-1.0) ** index.sum(axis=0), start.velocity.dtype)
    moving = replace(start, velocity=jnp.stack([0.3 + ringing, ringing]))
    mpm.write_vtkhdf(tmp_path / "block.vtkhdf", scene, [moving], [0.0])
    with h5py.File(tmp_path / "block.vtkhdf") as file:
        velocity = file["VTKHDF/PointData/velocity"][:]
    assert np.abs(moving.velocity[1]).min() == 1.0
    assert np.abs(velocity[:, 2]).max() < 0.35
    assert np.abs(velocity[:, 0] - 0.3).max() < 0.35
    inside = ((index > index.min() + 1) & (index < index.max() - 1)).all(axis=0)
    assert np.abs(velocity[inside] - [0.3, 0, 0]).max() < 1e-5


def test_elastic_bars_without_history_or_strength_are_written_too(tmp_path):
    elastic = mpm.Soil(strength=None, unit_weight=1e4, young=1e6, poisson=0.0)
    scene, start = mpm.bar(2.0, elastic, mpm.Discretisation(cell=0.5, spacing=(0.25,)), velocity=0.1)
    mpm.write_vtkhdf(tmp_path / "bar.vtkhdf", scene, [start], [0.0])
    with h5py.File(tmp_path / "bar.vtkhdf") as file:
        assert set(file["VTKHDF/PointData"]) == {"displacement", "velocity", "stress", "volume_ratio"}
        assert file["VTKHDF/PointData/stress"].shape == (scene.particles.mass.size, 6)


def test_what_does_not_fit_is_refused_and_leaves_no_file(tmp_path):
    scene, start = scene_of()
    path = tmp_path / "run.vtkhdf"
    for states, times, message in (
        ([start], [0.0, 1.0], "1 states for 2 times"),
        ([start] * 3, [0.0, 1.0], "more states for 2 times"),
        ([start, start], [1.0, 1.0], "ascending"),
        ([start, replace(start, history=None)], [0.0, 1.0], "plastic_strain"),
        ([mpm.run.repeat(start, 2)], [0.0], "has shape"),
    ):
        with pytest.raises(ValueError, match=message):
            mpm.write_vtkhdf(path, scene, states, times)
        assert list(tmp_path.iterdir()) == []
