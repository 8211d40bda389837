"""The surveyed change of heights along a run-out line, against sums worked out by hand."""

import numpy as np
import pytest

from benchmarks.csv_rows import read_rows
from benchmarks.sites.real_profile import EDGES, draw, in_stations, misplaced, stations, surveyed
from benchmarks.sites.real_slides import SCENES, Slid, profile
from benchmarks.sites.real_surveys import KNOWN
from cooperative.measure import Track
from cooperative.scene import parse, read_scene

LINE = Track(((0.0, 0.0), (1000.0, 0.0)))


def test_volume_stands_in_the_station_of_the_nearest_point_of_the_line():
    x = np.array([-80.0, 10.0, 49.0, 51.0, 1200.0])
    volume = in_stations(LINE, np.array([x, 30 * np.ones(5)]), np.array([1.0, 2.0, 4.0, 8.0, 16.0]))
    assert volume[[0, 1, -1]].tolist() == [7.0, 8.0, 16.0]
    assert volume.sum() == 31.0


def test_the_survey_loses_what_the_published_raster_loses():
    track = parse(read_scene(SCENES / "s1000_2021.toml")).site.track
    survey = surveyed(track, SCENES / KNOWN["s1000_2021"].change)
    # Sums of DEM_of_Difference.asc: 26,407 m3 lost and 22,543 m3 gained, of 224 squares that changed.
    changed = read_rows(SCENES / "s1000_change.csv", dict.fromkeys(("x", "y", "change"), float), ("x", "y"))
    assert len(changed) == 224
    assert survey.sum() == pytest.approx(-3864, abs=1)
    assert survey[0] == pytest.approx(-20848, abs=1)
    assert survey.size == EDGES.size - 1


def test_a_file_with_a_square_twice_is_refused(tmp_path):
    path = tmp_path / "change.csv"
    path.write_text("x,y,change\n5,5,1.0\n5,5,2.0\n")
    with pytest.raises(ValueError, match="twice"):
        surveyed(LINE, path)


def test_misplaced_is_a_share_of_the_surveyed_loss():
    survey = np.array([-10.0, 4.0, 6.0])
    slides = np.array([[-10.0, 4.0, 6.0], [-10.0, 10.0, 0.0], [0.0, 0.0, 0.0]])
    assert misplaced(survey, slides).tolist() == [0.0, 0.6, 1.0]


def test_a_station_within_the_interval_of_the_slides(tmp_path):
    survey = np.zeros(EDGES.size - 1)
    survey[:2] = -100.0, 100.0
    slid = Slid({"change": np.stack([0.5 * survey, 0.9 * survey])}, np.array([0.5, 0.5]))
    rows = stations("a", survey, slid.quantiles("change"))
    assert [row["within"] for row in rows[:3]] == [False, False, True]
    assert (rows[1]["low_m3"], rows[1]["median_m3"], rows[1]["high_m3"]) == (50, 50, 90)
    draw(rows, tmp_path)
    assert (tmp_path / "real_slides_profile.png").stat().st_size > 5000


def test_stations_of_the_slide_whose_change_was_surveyed_alone():
    change = np.zeros((2, EDGES.size - 1))
    slid = {"refined": Slid({"change": change}, np.ones(2))}
    rows, figures = profile("s1000_2021", KNOWN["s1000_2021"], slid)
    assert len(rows) == change.shape[1]
    assert figures["profile_width"] == 0.0
    assert figures["profile_within"] == pytest.approx(np.mean([row["surveyed_m3"] == 0 for row in rows]), abs=1e-3)
    assert profile("sainte_monique_1994", KNOWN["sainte_monique_1994"], slid) == ([], {})
    assert profile("s1000_2021", KNOWN["s1000_2021"], {"refined": Slid({}, np.zeros(0))}) == ([], {})
