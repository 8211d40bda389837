"""The walks of docs/walks.md, and every command that a page names: they are what this package takes and does."""

import re
import shlex
import socket
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.project import docs
from cooperative._arguments import parser
from cooperative.scene import parse
from tests.databases import finished
from tests.scenes import write_gef

PAGES = [*docs.pages(), "CONTRIBUTING.md"]
WALKS = "docs/walks.md"


def commands(page: str) -> list[list[str]]:
    """Arguments of each command of this package in the blocks of a page."""
    text = "".join(block for language in ("sh", "text", "bash") for block in docs.blocks(page, language))
    lines = re.findall(r"^(?:\$ )?(?:jaxmpm|\S*python -m cooperative) (.*)$", text, re.M)
    return [shlex.split(line, comments=True) for line in lines]


NAMED = sorted({(page, *each) for page in PAGES for each in commands(page)})


def test_pages_have_commands():
    assert len(NAMED) > 15


@pytest.mark.parametrize("named", NAMED, ids=lambda named: " ".join(named))
def test_commands_of_the_pages_are_taken(named):
    """A word that the parser does not know ends it by SystemExit."""
    assert vars(parser().parse_args(list(named[1:])))


def test_scene_of_the_walk_is_sound():
    (text,) = docs.blocks(WALKS, "toml")
    campaign = parse(text)
    assert [layer.name for layer in campaign.site.layers] == ["crust", "clay", "rock"]
    assert [element.name for element in campaign.elements_at_risk] == ["road"]


@pytest.fixture
def walked(tmp_path, monkeypatch):
    """A folder with the walk's scene, made small, and this package on its path."""
    (text,) = docs.blocks(WALKS, "toml")
    small = text.replace("samples = 40", "samples = 10\nrefined_runs = 10")
    small = small.replace("[rough]", "[run]\nt_end = 2.0\n[rough]")
    small = small.replace("cell = 2.0\nspacing = [1.0, 1.0]", "cell = 4.0\nspacing = [2.0, 2.0]")
    small = small.replace("cell = 1.0\nspacing = [0.5, 0.5]", "cell = 2.0\nspacing = [1.0, 1.0]")
    (tmp_path / "bank.toml").write_text(small)
    monkeypatch.setenv("PYTHONPATH", str(docs.ROOT))
    return tmp_path


def write_hill(folder):
    """Two soundings in soft clay as GEF, and a GeoTIFF of the slope between them."""
    import rasterio
    from rasterio.transform import from_origin

    random = np.random.default_rng(0)
    for name, x, top in (("cpt-1", 1008.0, 8.0), ("cpt-2", 1020.0, 7.0)):
        cone = 0.12 + 0.002 * np.arange(60) + 0.03 * np.abs(np.cumsum(random.standard_normal(60))) ** 0.5
        write_gef(folder / f"{name}.gef", x, cone.round(3).tolist(), y=2008.0, top=top)
    heights = np.tile(np.clip(12 - 0.5 * np.arange(0, 34, 2), 2, 8), (9, 1)).astype("float32")
    shape = {"height": 9, "width": 17, "count": 1, "dtype": "float32"}
    transform = from_origin(999, 2017, 2, 2)
    with rasterio.open(
        folder / "hill.tif", "w", driver="GTiff", crs="EPSG:28992", transform=transform, **shape
    ) as file:
        file.write(heights, 1)


HERE = f"""
jaxmpm() {{ {sys.executable} -m cooperative "$@"; }}
dask() {{ exec {sys.executable} -m dask "$@"; }}
"""
"""Commands as those of an installed package."""


def free_port() -> int:
    """A port that nothing listens on just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.slow
def test_engineer_comes_to_a_report_and_a_table(walked):
    lines = [
        line
        for block in docs.blocks(WALKS, "sh")
        for line in block.splitlines()
        if "bank" in line and "tail" not in line
    ]
    lines = [line for line in lines if "--refined-runs" not in line]
    result = subprocess.run(
        ["bash", "-ec", "\n".join([HERE, *lines])], cwd=walked, capture_output=True, text=True, check=True
    )
    assert "probability of failure" in result.stdout
    assert "road" in (walked / "out" / "bank" / "report.html").read_text()
    assert (walked / "out" / "bank" / "table.csv").exists()


@pytest.mark.slow
def test_two_soundings_and_a_terrain_model_come_to_maps(tmp_path, monkeypatch):
    """The commands as they stand, on a hill of 32 m whose samples run for a second."""
    pytest.importorskip("rasterio")
    write_hill(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(docs.ROOT))
    (block,) = [block for block in docs.blocks(WALKS, "sh") if "jaxmpm site" in block]
    lines = [line for line in block.splitlines() if line.startswith("jaxmpm")]
    assert len(block.splitlines()) <= 8
    shorter = "s/t_end = 20.0/t_end = 1.0/; s/samples = 40/samples = 10/; s/refined_runs = 16/refined_runs = 10/"
    lines.insert(1, f"sed -i '{shorter}; s/displacement = 1.0/displacement = 0.01/' site/scene.toml")
    result = subprocess.run(
        ["bash", "-ec", "\n".join([HERE, *lines])], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "probability of failure" in result.stdout
    assert (tmp_path / "site" / "scene.png").exists()
    assert list((tmp_path / "out" / "hill" / "maps").glob("*.tif"))


@pytest.mark.slow
def test_job_of_the_cluster_runs_the_campaign_and_leaves_its_log(walked):
    pytest.importorskip("distributed")
    (script,) = docs.blocks(WALKS, "bash")
    # One machine has no srun; what runs in the background ends with the job.
    begin = HERE + "srun() { \"$@\"; }\nhostname() { echo 127.0.0.1; }\ntrap 'kill $(jobs -p)' EXIT\n"
    script = begin + script.replace("8786", str(free_port())).replace("--workers 8", "--workers 1")
    result = subprocess.run(["bash", "-c", script], cwd=walked, capture_output=True, text=True, timeout=500)
    assert "probability of failure" in result.stdout, result.stderr
    folder = walked / "out" / "bank"
    assert len(finished(folder, "rough")) == 10
    assert (folder / "progress.log").read_text().endswith("done\n")
