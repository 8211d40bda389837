"""The campaign in one table."""

import csv
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from cooperative.exports import write_table
from cooperative.runs import build, random_soil
from cooperative.scene import parse
from cooperative.store import open_store, read_store, write_sample
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.store.test_store import sample

SCENE = TINY.replace("samples = 6", "samples = 20")
SOIL = random_soil(parse(SCENE))


def test_the_table_has_a_line_per_sample_and_grid(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for grid, number in (("rough", 0), ("rough", 1), ("refined", 1)):
            write_sample(store, grid, sample(number))
        with open(write_table(store), newline="") as file:
            lines = list(csv.DictReader(file))
    assert [(line["grid"], line["sample"]) for line in lines] == [("rough", "0"), ("rough", "1"), ("refined", "1")]
    assert float(lines[2]["displacement"]) == sample(1).row["displacement"]
    assert lines[0]["mode"] == "deep"


def test_a_full_disk_stops_an_export_in_one_line_and_leaves_what_was_there(tmp_path):
    model = build(parse(SCENE), "rough", SOIL, at_rest=False)
    made = replace(sample(0), coefficients=np.zeros(SOIL.modes))
    made = replace(made, fields={"displacement": np.zeros_like(model.scene.particles.position)})
    with open_store(tmp_path, SCENE) as store:
        for number in range(20):
            write_sample(store, "rough", replace(made, number=number))
    table = tmp_path / "table.csv"
    table.write_bytes(b"old")
    script = f"""if True:
        import resource, sys
        from cooperative.__main__ import main
        sys.dont_write_bytecode = True  # Python keeps what it could write of a module, which no process can then import
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, 512))
        sys.exit(main(["export", {str(tmp_path)!r}]))
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: ")
    assert f"cannot write {table} (File too large): make room" in done.stderr.splitlines()[-1]
    assert table.read_bytes() == b"old"
    assert list(tmp_path.rglob("*.part")) == []


def test_samples_that_the_scene_does_not_have_are_in_no_export(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for number in (3, 20):
            write_sample(store, "rough", sample(number))
    store = read_store(tmp_path)
    with open(write_table(store), newline="") as file:
        assert [line["sample"] for line in csv.DictReader(file)] == ["3"]


def test_a_table_that_cannot_be_written_is_named(tmp_path):
    with open_store(tmp_path, SCENE) as store, pytest.raises(OSError, match="nowhere"):
        write_table(store, tmp_path / "nowhere" / "table.csv")
