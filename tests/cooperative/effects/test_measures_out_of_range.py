"""No number of a row keeps a summary from being written, and none that is no measure enters one unseen."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cooperative.measure import OpenGround, consequences
from cooperative.scene import parse
from cooperative.summary import Summary, summarise
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.effects.test_exposed import HAZARD
from tests.cooperative.effects.test_summary import rows

CAMPAIGN = parse(TINY.replace("k_t = 2\n", "").replace('"published"', '"monte carlo"') + HAZARD)
COUNT = 6
AT = [f"{what}_at_{key}" for what in ("thickness", "speed", "arrival") for key in ("road", "house")]
ORDINARY = {"depth": 3.0, "runout": 2.0, "volume": 20.0, "area": 2.0, "area_columns": 2.0} | dict.fromkeys(AT, 1.5)
NUMBERS = st.floats(width=32) | st.sampled_from([-0.1398601531982422, -np.inf, np.inf, np.nan, -0.0, 0.0])


def refined_rows(**columns):
    values = {name: np.full(COUNT, value) for name, value in ORDINARY.items()} | columns
    modes = np.array(["deep", "shallow"] * (COUNT // 2))
    return rows(np.arange(COUNT), np.linspace(2.0, 3.0, COUNT), mode=modes, **values)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.sampled_from([*ORDINARY]), st.lists(NUMBERS, min_size=COUNT, max_size=COUNT), max_size=4))
def test_a_summary_is_written_whatever_numbers_its_rows_hold(drawn):
    columns = {name: np.array(values) for name, values in drawn.items()}
    refined = refined_rows(**columns)
    summary = summarise(CAMPAIGN, rows(np.arange(COUNT), np.linspace(2.0, 3.0, COUNT)), refined)
    assert Summary.from_json(json.dumps(summary.as_json())) == summary
    assert summary.probability.value == 1.0
    for name, spread in summary.consequences.means.items():
        usable = refined.columns[name][np.isfinite(refined.columns[name]) & (refined.columns[name] >= 0)]
        assert (spread is None) == (usable.size == 0)
        if spread is not None:
            assert (spread.smallest, spread.largest) == (usable.min(), usable.max())
    bad = [name for name, values in columns.items() if (np.isinf(values) | (values < 0)).any()]
    notes = [note for note in summary.notes if "counts as unknown" in note]
    assert len(notes) == bool(bad)
    assert not bad or any(note.startswith(f"{name} = ") for name in bad for note in notes)


def test_the_depth_of_a_particle_above_the_surface_is_none():
    position = np.array([[1.0, 2.0, 3.0], [4.0, 4.0, 4.39]])
    moved = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -1.0]])
    above = OpenGround(surface=np.array([4.5, 4.5, 4.0]))
    found = consequences(position, moved, np.full(3, 0.047), above, half_size=np.array([0.25, 0.25]))
    assert found.depth == 0.0
    assert found.volume == pytest.approx(0.047)


def test_the_number_of_the_report_of_a_hillside_is_unknown_and_named():
    depth = np.full(COUNT, 2.0)
    depth[3] = -0.1398601531982422
    summary = summarise(CAMPAIGN, rows(np.arange(COUNT), np.full(COUNT, 2.0)), refined_rows(depth=depth))
    assert summary.consequences.means["depth"].smallest == 2.0
    assert any(note.startswith("depth = -0.14 of sample 3: no measure is below 0") for note in summary.notes)
