"""The README and the pages of docs/: they are short, their blocks run, their links and figures are there."""

import re

import pytest

import cooperative
import jaxmpm as mpm
import kl
from benchmarks.measure import ROOT
from benchmarks.project import docs
from cooperative import runs
from cooperative.scene import parse

README = docs.page("README.md")
DEMO = ROOT / "benchmarks" / "scenes" / "demo.toml"
BLOCKS = [(path, n, block) for path in docs.pages() for n, block in enumerate(docs.blocks(path, "python"))]


def test_readme_opens_with_its_two_commands():
    assert README.index("make demo") < README.index("make test") < 400


def test_readme_is_short():
    assert docs.words("README.md") <= 700
    assert len(README.splitlines()) <= 110


@pytest.mark.parametrize("package", [mpm, kl, cooperative], ids=lambda package: package.__name__)
def test_a_line_says_what_would_be_missed_without_each_public_name(package):
    _, _, section = docs.page("docs/api/names.md").partition(f"## {package.__name__}\n")
    lines = re.findall(r"^\| `(\w+)` \| (\S.+) \|$", section.partition("\n## ")[0], re.MULTILINE)
    assert [name for name, _ in lines] == sorted(package.__all__)


@pytest.mark.parametrize("path", docs.pages())
def test_links_lead_somewhere(path):
    assert not docs.broken_links(path)


def test_a_broken_link_is_seen(tmp_path, monkeypatch):
    (tmp_path / "a.md").write_text("# One\n[gone](nowhere.md) [here](a.md#one) ![there](b.png) [lost](a.md#two)\n")
    monkeypatch.setattr(docs, "ROOT", tmp_path)
    assert docs.broken_links("a.md") == ["nowhere.md", "b.png", "a.md#two"]


def test_a_key_counts_as_explained_in_its_own_section_alone(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    page = docs.page("docs/scenes.md")
    assert docs.undocumented_keys() == []
    before, sweep = page.split("## `[sweep]`")
    for row in ("| `depth` | Depth of the water table", "| `cell` | Edge"):
        assert row in before
        before = before.replace(row, row[1:])
    (tmp_path / "docs" / "scenes.md").write_text(f"{before}## `[sweep]`{sweep.replace('| `cov` |', '| cov |')}")
    monkeypatch.setattr(docs, "ROOT", tmp_path)
    assert docs.undocumented_keys() == [
        "[water] depth",
        "[rain] cell",
        "[drawdown] cell",
        "[rough] cell",
        "[refined] cell",
        "[coarse] cell",
        "[sweep] cov",
    ]


def test_scene_in_the_readme_is_the_demos(tmp_path):
    (scene,) = docs.blocks("README.md", "toml")
    (tmp_path / "demo.toml").write_text(scene)
    assert parse(tmp_path / "demo.toml") == parse(DEMO)


def test_example_of_the_keys_is_sound():
    (scene,) = docs.blocks("docs/scenes.md", "toml")
    campaign = parse(scene)
    assert [layer.name for layer in campaign.site.layers] == ["sand", "clay"]
    assert campaign.seepage.moment == 48 * 3600


def test_gradient_in_the_readme_is_of_the_demos_slope():
    (block,) = docs.blocks("README.md", "python")
    names = {}
    exec(block[: block.index("steps = ")], names)
    demo = parse(DEMO)
    there = runs.build(demo, "rough", runs.random_soil(demo))
    weaker, _ = mpm.with_soil(there.scene, there.state, strength=30e3)
    assert names["scene"] == weaker
    assert names["state"] == there.state
    assert "toe=60 + 24" in block
    assert demo.ground.shape.face.toe_x == 60 + 24


# Those of pages that notebooks and other tests cover run with the slow tests.
SELDOM = (
    "README.md",
    "docs/gradients.md",
    "docs/own-loop.md",
    "docs/random-fields.md",
    "docs/seepage.md",
    "docs/walks.md",
)
OPTIONAL = ("equinox",)
CAMPAIGN = "docs/campaign-db.md"
"""Asks a campaign that has run, which `test_page_of_the_database.py` has."""
EACH = [pytest.param(p, b, id=f"{p}-{n}", marks=pytest.mark.slow if p in SELDOM else ())
        for p, n, b in BLOCKS if p != CAMPAIGN]  # fmt: skip


@pytest.mark.parametrize(("path", "block"), EACH)
def test_python_block_runs(path, block, capsys):
    for package in OPTIONAL:
        if f"import {package}" in block:
            pytest.importorskip(package)
    exec(compile(block, path, "exec"), {})
    assert capsys.readouterr().out.strip()
