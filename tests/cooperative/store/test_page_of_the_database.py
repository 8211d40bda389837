"""docs/campaign-db.md says what the database has, and what it shows works."""

import re
import shutil
import subprocess
from contextlib import closing

import pandas
import pytest

from cooperative.store._database import ABOUT, COMMON, DATABASE, TEXTS, columns_of, connect
from tests import ROOT

PAGE = (ROOT / "docs" / "campaign-db.md").read_text(encoding="utf-8")


def test_the_page_has_every_column_with_its_type_and_every_text(tiny_campaign):
    with closing(connect(tiny_campaign[0] / DATABASE)) as database:
        columns = columns_of(database)
    assert (ABOUT | COMMON).items() <= columns.items()
    of_some_campaigns = dict.fromkeys(("water_level", "area_columns"), "REAL")
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", PAGE, flags=re.M)
    assert dict(rows) == columns | of_some_campaigns
    assert tuple(re.findall(r"^\| `(\w+)` \| (?!TEXT|REAL|INTEGER|BLOB|BOOLEAN)", PAGE, flags=re.M)) == TEXTS


def test_its_examples_ask_a_campaign(tiny_campaign, tmp_path, monkeypatch, capsys):
    (tmp_path / "out").mkdir()
    shutil.copytree(tiny_campaign[0], tmp_path / "out" / "demo")
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)
    exec(code, shown := {})
    assert isinstance(shown["runs"], pandas.DataFrame)
    assert len(shown["runs"]) == tiny_campaign[1].cost.refined_runs
    assert "displacement" in capsys.readouterr().out
    shown["database"].close()
    if shutil.which("sqlite3") is None:
        pytest.skip("the program sqlite3 is not installed")
    (command,) = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.S)
    said = subprocess.run(command, shell=True, capture_output=True, text=True, check=True).stdout
    assert len(said.splitlines()) == tiny_campaign[1].cost.refined_runs
