"""The gallery shows every scene that comes along, with a picture, a cost and a result."""

import re

import pytest
from matplotlib import image

from benchmarks.project import gallery

PAGE = gallery.PAGE.read_text()


def test_every_scene_has_a_row():
    assert sorted(gallery.RESULTS) == gallery.names()
    assert PAGE.startswith(gallery.HEAD)
    assert len(re.findall(r"^\| \[`", PAGE, re.M)) == len(gallery.RESULTS)


@pytest.mark.parametrize("name", gallery.RESULTS)
def test_a_scene_is_shown_with_its_cost_and_its_result(name):
    mark = "THE COST"
    before, after = map(re.escape, gallery.row(name, mark).split(mark))
    (text,) = re.findall(f"^{before}(.*){after}$", PAGE, re.M)
    duration = r"([\d,.]+ (minutes|hours)|a minute)"
    cost = rf"[\d,]+ rough and at most [\d,]+ refined runs of [\d,]+ and [\d,]+ particles: {duration}"
    assert re.fullmatch(cost, text)
    shown = image.imread(gallery.FIGURES / f"{name.replace('/', '-')}.png")
    assert shown.shape[1] == 384
    assert shown[..., :3].std() > 0.1


def test_a_scene_tells_itself_what_it_is():
    assert gallery.about("sites/acads_1c").startswith("Three layers: ACADS, Example 1(c), Giam and Donald (1989)")


@pytest.mark.slow
def test_a_picture_and_a_cost_are_made_of_a_scene_that_needs_a_file():
    parts = gallery.campaigns("new/terrain")
    assert len(gallery.picture(parts[0]).axes) == 2
    assert re.search(r"particles: ([\d,.]+ (minutes|hours)|a minute)$", gallery.cost(parts, 0.2))
