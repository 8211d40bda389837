"""A folder that went on under other versions says which samples are by which."""

from dataclasses import replace

import pytest

from cooperative import run
from cooperative.__main__ import main
from cooperative.store import Rows, _samples, mixed_versions, open_store, read_rows, read_store, write_sample
from cooperative.store._samples import package_versions
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.store.test_store import SCENE, sample


def test_rows_know_the_versions_of_their_samples(tmp_path):
    other = {**package_versions(), "jax": "0.9.9"}
    with open_store(tmp_path, SCENE) as store:
        for number in range(4):
            write_sample(store, "rough", replace(sample(number), versions=other if number in (1, 2) else {}))
    assert read_rows(read_store(tmp_path), "rough").versions == {
        0: package_versions(),
        1: other,
        2: other,
        3: package_versions(),
    }


def test_the_note_names_what_differs_alone():
    old, new = ({"jax": jax, "numpy": "2.1", "h5py": h5py} for jax, h5py in (("0.9", "3.1"), ("0.10", "3.2")))
    rough = Rows({}, (), {0: old, 1: old, 2: new, 4: new})
    assert mixed_versions({"rough": Rows({}, (), {0: old, 1: {**old, "h5py": "3.3"}}), "refined": Rows({}, ())}) == ""
    note = mixed_versions({"rough": rough, "refined": Rows({}, (), {2: new})})
    assert "differs: rough 0 to 1 by jax 0.9; rough 2, 4 and refined 2 by jax 0.10. Each is whole" in note


@pytest.mark.usefixtures("unrendered")
def test_a_campaign_that_goes_on_under_another_version_says_so(tmp_path, monkeypatch, capsys):
    text = (
        TINY.replace("t_end = 4.0", "t_end = 0.2").replace("samples = 6", "samples = 3").replace("k_t = 2", "k_t = 1")
    )

    class Killed(Exception):
        pass

    def killed(phase):
        if phase == "audit":
            raise Killed

    with pytest.raises(Killed):
        run(text, tmp_path, on_phase=killed)
    monkeypatch.setattr(_samples, "package_versions", lambda: {**package_versions(), "numpy": "9.9"})
    summary = run(text, tmp_path)
    here = package_versions()["numpy"]
    (note,) = [note for note in summary.notes if "several versions" in note]
    assert f"rough 0 to 2 by numpy {here}; refined" in note
    assert note.count("by numpy 9.9") == 1
    for command in ("status", "report"):
        assert main([command, str(tmp_path)]) == 0
        assert f"  note: {note}" in capsys.readouterr().out
