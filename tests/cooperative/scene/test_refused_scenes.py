"""Scenes that no campaign can be made of: each is refused in one line, before anything is built or written."""

import re
import tomllib
from pathlib import Path

import pytest

from benchmarks.robustness.invented import LAYERED, TINY
from cooperative import run, runs
from cooperative.example_scenes import example
from cooperative.tools import sweep
from tests.cooperative.effects.test_exposed import HAZARD
from tests.cooperative.scene.test_mixed_scenes import MIXED
from tests.cooperative.scene.test_random_level import SCENE as RANDOM_LEVEL
from tests.cooperative.scene.test_random_soil import CORRELATED, CRACKED, SAND, SOFT
from tests.cooperative.scene.test_scene_sections import WET
from tests.cooperative.tools.test_sweep import SWEEP
from tests.jaxmpm.laws.test_strength_ratio import CONSTANT
from tests.jaxmpm.laws.test_trend import SCENE as TREND

DEMO = example("demo")
BASES = {
    "tiny": TINY,
    "sand": SAND,
    "soft": SOFT,
    "cracked": CRACKED,
    "correlated": SAND + CORRELATED,
    "layered": LAYERED,
    "wet": WET,
    "mixed": MIXED,
    "exposed": TINY + HAZARD,
    "random level": RANDOM_LEVEL,
    "trend": TREND,
    "ratio": CONSTANT,
    "demo": DEMO,
    "embankment": example("embankment"),
    "in millimetres": re.sub(
        r"\[slope\].*?(?=\n\[soil\])",
        "[ground]\nsurface = [[0, 12e3], [20, 12e3], [36, 4e3], [60, 4e3]]",
        DEMO,
        flags=re.DOTALL,
    ),
    "sweep": SWEEP,
    "sweep of paths": LAYERED,
}
TABLE = tomllib.loads(Path(__file__).with_name("refused.toml").read_text())
CASES = [(base, *case) for base, cases in TABLE.items() for case in cases] + [
    ("tiny", "samples = 6", f"samples = 0x{'f' * 5000}", "samples is a whole number beyond 64 bits"),
    ("tiny", 'name = "tiny"', f"a = {'[' * 5000}{']' * 5000}", "nests tables or lists without end"),
    ("tiny", "cov = 0.4", f"cov{'.a' * 50} = 1", r"cov = \{'a'.*\} is a table: give a number"),
    ("tiny", "cov = 0.4", f"cov{'.a' * 1500} = 1", "nests tables or lists 65 deep, the limit is 64: write it flat"),
]


@pytest.fixture
def nothing_built(monkeypatch):
    """Neither a grid nor a field may be built."""

    def built(*_):
        pytest.fail("something was built")

    for name in ("build", "random_soil", "coefficients_of"):
        monkeypatch.setattr(runs, name, built)


@pytest.mark.usefixtures("nothing_built")
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}: {case[-2][:40]}")
def test_a_scene_is_refused_in_one_line_before_anything_is_built_or_written(case, tmp_path):
    base, *replacements, message = case
    text = BASES[base]
    for old, new in zip(replacements[::2], replacements[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    begin = sweep.run if base.startswith("sweep") else run
    with pytest.raises(ValueError, match=message) as refused:
        begin(text, tmp_path / "out")
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out").exists()
