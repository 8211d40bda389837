"""The initial stress of a grid is solved once per campaign; workers, resumed campaigns and exports read it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, make_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import jaxmpm
from benchmarks.robustness.invented import TINY
from cooperative import campaign
from cooperative.exports._export import export_sample
from cooperative.runs import _executors, build, keep_initial, random_soil, verify_initial
from cooperative.runs._built import initial_path
from cooperative.scene import parse
from cooperative.store import read_rows, read_store
from jaxmpm.support.files import set_aside
from jaxmpm.support.pytrees import pytree
from tests.databases import delete

SCENE = TINY.replace("samples = 6", "samples = 3").replace("t_end = 4.0", "t_end = 0.5")
ASKED = parse(SCENE)
GRIDS = ("rough", "refined")


@pytest.fixture
def solved(monkeypatch):
    """Scenes whose stress was solved for, as it happens."""
    seen, solve = [], jaxmpm.at_rest

    def at_rest(scene, **choices):
        seen.append(scene.grid.cell)
        return solve(scene, **choices)

    monkeypatch.setattr(jaxmpm, "at_rest", at_rest)
    _executors._prepared.cache_clear()
    return seen


def built(grid, folder):
    return build(ASKED, grid, random_soil(ASKED), folder=folder)


@pytest.fixture
def stored(tmp_path):
    """A folder that has the stress of both grids."""
    for grid in GRIDS:
        model = built(grid, None)
        keep_initial(tmp_path, grid, model.scene, model.state)
    return tmp_path


def test_two_workers_a_resumed_campaign_and_an_export_solve_it_once(tmp_path, solved):
    campaign.run(SCENE, tmp_path, workers=2, executor=lambda: ThreadPoolExecutor(2))
    assert sorted(solved) == [1.0, 2.0]
    number = read_rows(read_store(tmp_path), "refined").numbers[0]
    delete(tmp_path, "refined", number)
    campaign.run(SCENE, tmp_path)
    export_sample(tmp_path, number, "refined", frames=2)
    assert len(solved) == 2


def test_calibration_takes_the_grids_that_are_there(tmp_path, solved, monkeypatch):
    def stable(scene, state, **_):
        assert np.ptp(np.asarray(state.stress)) > 0
        return SimpleNamespace(stable=1.0 + 0.1 * scene.grid.cell)

    monkeypatch.setattr("cooperative.scene._measured.factor_of_safety", stable)
    summary = campaign.run(SCENE + "calibrate = true\n", tmp_path)
    assert summary.probability.calibration.factor == pytest.approx(1.1 / 1.2)
    assert len(solved) == 2


def test_what_is_stored_is_what_was_solved(stored, solved):
    for grid in GRIDS:
        read, fresh = built(grid, stored), built(grid, None)
        assert np.asarray(read.state.stress).tobytes() == np.asarray(fresh.state.stress).tobytes()
    assert len(solved) == 2


def flipped(path):
    data = bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)


def of_another_grid(path):
    other = path.with_name("rough.h5" if path.name == "refined.h5" else "refined.h5")
    path.write_bytes(other.read_bytes())


def of_other_gravity(path):
    other = parse(SCENE.replace("[run]", "[run]\ngravity = 5.0"))
    model = build(other, path.stem, random_soil(other))
    path.unlink()
    keep_initial(path.parent.parent, path.stem, model.scene, model.state)


def not_finite(path):
    model = built(path.stem, None)
    path.unlink()
    stress = model.state.stress.at[0, 0].set(np.nan)
    keep_initial(path.parent.parent, path.stem, model.scene, replace(model.state, stress=stress))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (flipped, "rough.h5"),
        (of_another_grid, "another grid"),
        (of_other_gravity, "another grid"),
        (not_finite, "not finite"),
        (lambda path: path.write_text("stress"), "rough.h5"),
        (lambda path: (path.unlink(), path.symlink_to("/dev/zero")), "rough.h5"),
    ],
)
def test_what_cannot_be_trusted_is_named_set_aside_and_solved_again(stored, solved, spoil, message):
    path = initial_path(stored, "rough")
    good = path.read_bytes()
    spoil(path)
    solved.clear()
    with pytest.warns(UserWarning, match=f"{message}.*solved again"):
        model = built("rough", stored)
    assert solved == [2.0]
    keep_initial(stored, "rough", model.scene, model.state)
    assert path.read_bytes() == good
    assert path.with_name("rough.h5.damaged").is_symlink() or path.with_name("rough.h5.damaged").exists()


@pytest.mark.parametrize("factor", [1.0, 1.05])
def test_verify_finds_a_stress_that_was_made_for_another_answer(stored, factor):
    path, model = initial_path(stored, "rough"), built("rough", None)
    path.unlink()
    keep_initial(stored, "rough", model.scene, replace(model.state, stress=factor * model.state.stress))
    there = built("rough", stored)  # its checksum is right
    if factor == 1:
        verify_initial(stored, there)
        return
    with pytest.raises(ValueError, match=r"rough.h5 differs from the stress at rest of its scene by 0\.05 of the larg"):
        verify_initial(stored, there)
    with pytest.raises(ValueError, match="changed the answer, so begin the scene in another folder"):
        campaign.run(SCENE, stored, verify=True)
    assert not (stored / "samples").exists()


def test_a_folder_that_leads_elsewhere_is_not_followed(stored, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "initial"
    set_aside(stored / "initial").rename(elsewhere)
    (stored / "initial").symlink_to(elsewhere)
    with pytest.warns(UserWarning, match="leads out of the campaign's folder"):
        model = built("rough", stored)
    (elsewhere / "rough.h5").unlink()
    with pytest.warns(UserWarning, match="initial is a link or a file, not a folder: set aside as"):
        keep_initial(stored, "rough", model.scene, model.state)
    assert not (elsewhere / "rough.h5").exists()
    assert not (stored / "initial").is_symlink()


@pytest.mark.parametrize(("value", "same"), [(None, True), (1.0, False)])
def test_a_new_part_of_scenes_changes_nothing_where_it_is_absent(stored, value, same):
    model, path = built("rough", None), initial_path(stored, "rough")
    newer = make_dataclass("Scene", [("newer", object, None)], bases=(jaxmpm.Scene,), frozen=True)
    newer.__module__ = jaxmpm.Scene.__module__
    parts = {part.name: getattr(model.scene, part.name) for part in fields(jaxmpm.Scene)}
    before = path.stat().st_mtime_ns
    keep_initial(stored, "rough", pytree(newer)(**parts, newer=value), model.state)
    assert (path.stat().st_mtime_ns == before) is same
    assert path.with_name("rough.h5.damaged").exists() is not same
