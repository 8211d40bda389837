"""A report of a folder that lacks something or holds what it should not, and what a report takes from the folder."""

import errno
import os
import re
import shutil
import sys
from dataclasses import is_dataclass, replace

import h5py
import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.statistics.hazard_populations import SOLID
from cooperative import folder as folders
from cooperative import runs
from cooperative.__main__ import main
from cooperative.exports._export import export, export_sample
from cooperative.folder import models_of, read_results
from cooperative.hazard import hazard_maps
from cooperative.reporting import _plots as plots
from cooperative.reporting import report
from cooperative.scene import parse
from cooperative.store import open_store, read_rows, read_sample, read_store, stored_text, write_sample
from tests.cooperative.reporting.test_report import SCENE, Page, copied
from tests.databases import by_sql, delete, keep, spoil


def test_the_report_and_the_export_solve_nothing(tmp_path, done, monkeypatch):
    folder = copied(done, tmp_path / "c")
    shutil.rmtree(folder / "figures")
    solvers = {"solve", "solve_each", "advance", "advance_lanes", "elastic_equilibrium"}
    functions = [
        (module, name)
        for label, module in list(sys.modules.items())
        for name in solvers & vars(module).keys()
        if label.split(".")[0] in ("jaxmpm", "cooperative")
    ]
    assert {name for _, name in functions} == solvers

    def refused(*_, **__):
        raise AssertionError("the solver was asked")

    for module, name in functions:
        monkeypatch.setattr(module, name, refused)
    monkeypatch.setattr(plots, "save", lambda figure, path: path.write_bytes(b""))
    (folder / "report.html").unlink()
    report(folder)
    assert (folder / "report.html").read_bytes() == (done[0] / "report.html").read_bytes()
    assert {path.name for path in (folder / "figures").iterdir()} == {
        path.name for path in (done[0] / "figures").iterdir()
    }
    assert list(export(folder))
    with pytest.raises(AssertionError, match="the solver was asked"):
        report(folder, again=True)


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("what", ["deleted", "damaged", pytest.param("surplus", marks=pytest.mark.slow)])
def test_a_rough_run_that_lacks_or_is_too_many_does_not_stop_the_report(tmp_path, done, what, capsys):
    folder = copied(done, tmp_path / "c")
    store = read_store(folder)
    number = read_rows(store, "refined").numbers[0]
    if what == "deleted":
        delete(folder, "rough", number)
    elif what == "damaged":
        spoil(folder, "rough", number)
    else:
        sample = replace(read_sample(store, "rough", number), number=14)
        with open_store(folder, SCENE) as held:
            write_sample(held, "rough", sample)
    assert main(["report", str(folder), "--slides", "0"]) == 0
    printed = capsys.readouterr().out
    assert f"{14 - (what != 'surplus')} samples" in printed
    text = " ".join(Page((folder / "report.html").read_text()).text)
    assert ("sample 14 of the rough grid is of a sample that the scene, with 14, does not have" in text) == (
        what == "surplus"
    )


@pytest.mark.usefixtures("unrendered")
def test_a_run_of_another_field_is_left_out_and_named(tmp_path, done, capsys):
    folder = copied(done, tmp_path / "c")
    store = read_store(folder)
    columns = read_rows(store, "refined").columns
    number = int(columns["sample"][np.argmax(columns["displacement"])])
    sample = read_sample(store, "refined", number)
    for grid in ("refined", "slides"):
        delete(folder, grid, number)
    with open_store(folder, SCENE) as held:
        write_sample(held, "refined", replace(sample, coefficients=sample.coefficients[:3]))
    assert main(["report", str(folder), "--slides", "1"]) == 0
    capsys.readouterr()
    text = " ".join(Page((folder / "report.html").read_text()).text)
    assert re.search(rf"sample {number} of the refined grid holds 3 coefficients of a field that has \d+", text)
    assert main(["export", str(folder), "--sample", str(number)]) == 2
    assert f"sample {number} is not finished on the refined grid" in capsys.readouterr().err


@pytest.mark.usefixtures("unrendered")
def test_the_report_reads_the_summary_and_makes_it_anew_only_from_other_rows(tmp_path, done, monkeypatch):
    folder = copied(done, tmp_path / "c")
    asked = []
    made = folders.summarise
    monkeypatch.setattr(folders, "summarise", lambda *given: asked.append(given) or made(*given))
    printed = report(folder, slides=0)
    assert asked == []
    wrong = stored_text(folder, "summary").replace('"failures_refined": ', '"failures_refined": 9')
    by_sql(folder, "update campaign set value = ? where name = 'summary'", wrong)
    assert report(folder, slides=0) == printed
    assert len(asked) == 1
    for content in (wrong.replace('"made_from": "', '"made_from": "0'), "[" * 100_000, "{}"):
        keep(folder, "summary", content)
        assert report(folder, slides=0) == printed
    keep(folder, "budget", {"refined_runs": 99, "scene": 1})
    report(folder, slides=0)
    assert len(asked) == 5
    # The file is for other programs.
    (folder / "summary.json").write_text("nothing")


def alike(one, other):
    """Whether two stored values hold the same numbers."""
    if is_dataclass(one):
        return type(one) is type(other) and alike(vars(one), vars(other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    return np.array_equal(one, other, equal_nan=True) if isinstance(one, np.ndarray) else one == other


@pytest.mark.usefixtures("unrendered")
def test_a_whole_folder_is_reported_without_its_scene_and_its_grids(tmp_path, done, monkeypatch):
    folder = copied(done, tmp_path / "c")
    words = report(folder)
    page = (folder / "report.html").read_text()

    def refused(*_, **__):
        raise AssertionError("the scene was read, or a grid built")

    monkeypatch.setattr(folders, "campaign_of", refused)
    monkeypatch.setattr("cooperative.reporting._composition.campaign_of", refused)
    monkeypatch.setattr(runs, "build", refused)
    assert report(folder) == words
    assert (folder / "report.html").read_text() == page
    assert hazard_maps(folder).slides > 0
    # What is not stored comes from the scene.
    (folder / "ground.h5").unlink()
    with pytest.raises(AssertionError, match="the scene was read"):
        report(folder)


def arrays(path):
    """All arrays of an HDF5 file by name."""
    result = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, each: result.update({name: each[()]}) if isinstance(each, h5py.Dataset) else None)
    return result


def test_a_whole_folder_is_exported_without_its_scene_and_its_grids(tmp_path, done, monkeypatch):
    folder = copied(done, tmp_path / "c")
    drawn = [(grid, number) for grid, number in read_results(folder).soils() if grid == "refined"]
    kinds = ["table", "maps"]
    whole = {path: path.read_bytes() for path in export(folder, kinds)}
    series = {number: arrays(export_sample(folder, number)) for _, number in drawn}

    def refused(*_, **__):
        raise AssertionError("the scene was read, or a grid built")

    for module in ("folder", "exports._export", "exports._tables"):
        monkeypatch.setattr(f"cooperative.{module}.campaign_of", refused)
    monkeypatch.setattr(runs, "build", refused)
    assert {path: path.read_bytes() for path in export(folder, kinds)} == whole
    assert "weight" in (folder / "table.csv").read_text().splitlines()[0].split(",")
    # The random soil of a sample that a report draws is in the folder, too.
    assert all(alike(arrays(export_sample(folder, number)), series[number]) for _, number in drawn)
    (other,) = [number for number in read_results(folder).refined.numbers if ("refined", number) not in drawn][:1]
    with pytest.raises(AssertionError, match="the scene was read"):
        export_sample(folder, other)


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize(("name", "how"), [("ground.h5", "damaged"), ("drawn.h5", "deleted")])
@pytest.mark.filterwarnings("ignore:.*ground.h5.*the ground is built again")
def test_without_what_a_folder_keeps_of_its_ground_the_report_is_the_same(tmp_path, done, name, how):
    folder = copied(done, tmp_path / "c")
    words = report(folder)
    page = (folder / "report.html").read_text()
    if how == "deleted":
        (folder / name).unlink()
    else:
        (folder / name).write_bytes((folder / name).read_bytes()[:-1])
    assert report(folder) == words
    assert (folder / "report.html").read_text() == page


@pytest.mark.parametrize("solid", [False, True])
def test_the_ground_that_a_folder_keeps_is_that_of_the_grids(tmp_path, solid):
    text = SOLID if solid else SCENE
    models = models_of(parse(text))
    runs.keep_ground(tmp_path, models)
    stored = runs.read_ground(tmp_path)
    assert alike(stored, runs.ground_of(models))
    rough = stored.grids["rough"]
    assert np.array_equal(rough.position, models["rough"].scene.particles.position)
    heights = parse(text).site.shape.heights(*stored.surface[:-1].reshape(stored.dimension - 1, -1))
    assert np.array_equal(stored.surface[-1].ravel(), heights)
    # Written once, and again where it is damaged.
    stamp = (tmp_path / "ground.h5").stat().st_mtime_ns
    runs.keep_ground(tmp_path, models)
    assert (tmp_path / "ground.h5").stat().st_mtime_ns == stamp
    (tmp_path / "ground.h5").write_bytes(b"cooperative ground")
    runs.keep_ground(tmp_path, models)
    assert alike(runs.read_ground(tmp_path), stored)
    assert (tmp_path / "ground.h5.damaged").exists()


def test_the_section_goes_through_the_middle_of_the_soil():
    """Not of the ground, where a scar under rock that crops out may have none."""
    stored = runs.ground_of(models_of(parse(SOLID)))
    fine = stored.grids["refined"]
    assert stored.middle == stored.corner[1] + stored.extent[1] / 2
    behind = fine.position[1] < stored.corner[1] + stored.extent[1] / 4
    scar = replace(fine, position=fine.position[:, behind])
    part = replace(stored, grids={"refined": scar})
    assert plots.plane_at(scar, part.middle).sum() > 20
    assert not plots.plane_at(fine, part.middle)[~behind].any()


def test_a_figure_that_cannot_be_written_is_named_and_leaves_the_old_one(tmp_path, done, monkeypatch):
    folder = copied(done, tmp_path / "c")
    before = (folder / "figures" / "ranked.png").read_bytes()

    def full(self, path, **_):
        with open(path, "wb") as file:
            file.write(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(OSError, match=r"ranked\.png \(No space left on device\): make room"):
        plots.save(Figure(), folder / "figures" / "ranked.png")
    assert (folder / "figures" / "ranked.png").read_bytes() == before
    assert not list((folder / "figures").glob(".*"))


def test_figures_are_not_written_through_a_link(tmp_path, done):
    folder = copied(done, tmp_path / "c")
    shutil.rmtree(folder / "figures")
    (tmp_path / "elsewhere").mkdir()
    (folder / "figures").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="figures is a link or a file, not a folder"):
        report(folder, slides=0)
    assert not list((tmp_path / "elsewhere").iterdir())
