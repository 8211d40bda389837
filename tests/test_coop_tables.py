"""The campaign in one table and in one file."""

import csv
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest

from cooperative.reporting import consolidate, write_table
from cooperative.store import Sample, open_store, read_sample, sample_path, write_sample

SCENE = "[soil]\nSu_cov = 0.3\n"


def sample(number: int, size: int = 50) -> Sample:
    generator = np.random.default_rng(number)
    return Sample(
        number=number,
        status="SETTLED",
        steps=10,
        seconds=1.5,
        coefficients=generator.standard_normal(20),
        row={"displacement": generator.random(), "mode": "deep", "broke_off": False}
        | {"depth": 2.0, "runout": 3.5, "volume": 40.0, "area": 5.0},
        fields={"displacement": generator.random((3, size))},
    )


def test_the_table_has_a_line_per_sample_and_grid(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        for grid, number in (("rough", 0), ("rough", 1), ("refined", 1)):
            write_sample(store, grid, sample(number))
        with open(write_table(store), newline="") as file:
            lines = list(csv.DictReader(file))
    assert [(line["grid"], line["sample"]) for line in lines] == [("rough", "0"), ("rough", "1"), ("refined", "1")]
    assert float(lines[2]["displacement"]) == sample(1).row["displacement"]
    assert lines[0]["mode"] == "deep"


def test_the_one_file_holds_what_the_many_hold(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(4))
        write_sample(store, "rough", sample(2))
        sample_path(store, "rough", 9).write_bytes(b"broken")
        with pytest.warns(UserWarning, match=r"000009\.h5 is not a cooperative sample file"):
            path = consolidate(store)
        with h5py.File(path) as file:
            assert file.attrs["scene"] == SCENE
            assert sorted(file["rough"]) == ["000002", "000004"]
            np.testing.assert_array_equal(file["tables/rough/sample"], [2, 4])
            assert file["tables/rough/mode"].asstr()[0] == "deep"
            np.testing.assert_array_equal(file["rough/000004/fields/displacement"], sample(4).fields["displacement"])
        np.testing.assert_array_equal(read_sample(store, "rough", 4).coefficients, sample(4).coefficients)
        consolidate(store)


def test_a_full_disk_leaves_the_old_file(tmp_path):
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "rough", sample(0, size=40_000))
        consolidate(store).write_bytes(b"old")
    script = f"""if True:
        import resource
        from cooperative.store import read_store
        from cooperative.reporting import consolidate
        resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
        consolidate(read_store({str(tmp_path)!r}))
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert "campaign.h5" in done.stderr.splitlines()[-1]
    assert "start the same command again" in done.stderr
    assert (tmp_path / "campaign.h5").read_bytes() == b"old"
    assert not [name for name in os.listdir(tmp_path) if name.endswith(".part")]


def test_a_table_that_cannot_be_written_is_named(tmp_path):
    with open_store(tmp_path, SCENE) as store, pytest.raises(OSError, match="nowhere"):
        write_table(store, tmp_path / "nowhere" / "table.csv")
