"""Pictures that turn: the skin of a body, and a page that holds all it needs."""

import base64
import json
import re
import shutil
import zlib
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import Normalize

import jaxmpm as mpm
from benchmarks.invented import TERRAIN
from cooperative.__main__ import main
from cooperative.reporting import _ground as ground
from cooperative.reporting import _turn as turn

GRID = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in (4, 3, 2)), indexing="ij")).reshape(3, -1) * 2.0 + 10
SIZE = (2.0, 2.0, 2.0)


def normals(faces):
    return np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])


def test_the_skin_of_a_block_is_its_sides_and_top():
    faces, of = turn.skin(GRID, SIZE)
    # 4 x 3 on top, 4 x 2 and 3 x 2 twice round it.
    assert len(faces) == 12 + 2 * 8 + 2 * 6
    np.testing.assert_allclose(faces.min(axis=(0, 1)), [10, 10, 10])
    np.testing.assert_allclose(faces.max(axis=(0, 1)), [18, 16, 14])
    outwards = np.einsum("ni,ni->n", normals(faces), faces.mean(axis=1) - [14, 13, 12])
    assert (outwards > 0).all()
    np.testing.assert_allclose(np.linalg.norm(normals(faces), axis=1), 2 * 4)
    # Each face is that of the particle that it belongs to.
    assert np.abs(faces.mean(axis=1) - GRID[:, of].T).max() == pytest.approx(1.0)


def test_a_hole_has_a_skin_too():
    middle = np.all(np.abs(GRID - [[13], [13], [13]]) < 0.5, axis=0)
    faces, _ = turn.skin(GRID[:, ~middle], SIZE)
    # A well in the top: its four sides and its floor in the place of one face.
    assert len(faces) == 40 + 4


def test_bodies_of_many_faces_are_drawn_in_larger_boxes():
    small, _ = turn.skin(GRID, (2.0, 2.0, 2.0), most=30)
    assert len(small) <= 30
    spread = np.ptp(small, axis=(0, 1))
    assert (spread >= [8, 6, 4]).all()
    assert (spread <= np.array([8, 6, 4]) + 3).all()


def test_the_page_holds_its_bodies_and_lets_no_text_out():
    faces, of = turn.skin(GRID, SIZE)
    values = np.where(of == 0, np.nan, of.astype(float))
    colours = turn.coloured(values, Normalize(0, 23), "cividis")
    name = "</script><script>alert(1)</script>"
    body = turn.Body(name, faces, colours, [turn.Line(GRID[:, :2].T, name=name)], scale=(name, 0, 23, "cividis"))
    said = turn.turning([body, body], name)
    assert "alert(1)</script>" not in said
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', said)[1])
    assert data["ends"] == [[10, 10, 10], [18, 16, 14]]
    packed = zlib.decompress(base64.b64decode(data["bodies"][0]["data"]))
    count = data["bodies"][0]["faces"]
    np.testing.assert_array_equal(np.frombuffer(packed[: 48 * count], "<f4").reshape(faces.shape), faces)
    np.testing.assert_array_equal(np.frombuffer(packed[48 * count :], np.uint8).reshape(count, 4), colours)
    assert (colours[of == 0] == (*turn.ROCK, 255)).all()
    assert data["bodies"][0]["lines"][0]["name"] == name
    with pytest.raises(ValueError, match="nothing to turn"):
        turn.turning([turn.Body("none", faces[:0], colours[:0])], "")


def test_a_scene_in_3d_is_drawn_as_a_page(tmp_path, capsys):
    text = (
        TERRAIN.replace("[terrain]", "[terrain]\nrun_out_line = [[1, 4], [8, 3], [15, 4]]", 1)
        + '\n[[exposed]]\nname = "road"\npolygon = [[12, 0], [14, 0], [14, 8], [12, 8]]\n'
    )
    (tmp_path / "mine.toml").write_text(text)
    page, picture = tmp_path / "mine.html", tmp_path / "mine.png"
    assert main(["draw", str(tmp_path / "mine.toml")]) == 0
    assert capsys.readouterr().out.split() == [str(picture), str(page)]
    assert picture.read_bytes().startswith(b"\x89PNG")
    said = page.read_text()
    assert not re.search(r'src=|url\(|@import|href="(?!data:)|https?:', said)
    bodies = json.loads(re.search(r'<script type="application/json">(.*?)</script>', said)[1])["bodies"]
    assert len(bodies) == 3
    for body in bodies:
        names = {line["name"] for line in body["lines"]}
        assert {"road", "run-out line"} <= names
        assert any("wall, x = " in name for name in names)
        assert any("fixed base" in name for name in names)
        assert body["faces"] > 100


def test_water_is_drawn_where_it_stands_whatever_says_so():
    x, y = np.array([-1.0, 0.5, 3.0]), np.array([0.0, 1.0, 9.0])
    weight, height = jnp.asarray(9810.0), jnp.asarray(1.0)
    table = mpm.WaterTable(jnp.array([0.0, 2.0]), jnp.array([4.0, 6.0]), weight, height)
    # Heights 4 + x + 2 y on points 2 m apart, level beyond the outermost.
    heights = 4 + jnp.array([[0.0, 4.0], [2.0, 6.0]])
    surface = mpm.WaterSurface(heights, jnp.zeros(2), jnp.asarray(2.0), weight, height)
    for water, known in ((table, [4, 4.5, 6]), (surface, [4, 6.5, 10]), (None, None)):
        found = ground._water(SimpleNamespace(scene=SimpleNamespace(water=water)), x, y)
        assert found is None if known is None else np.allclose(found, known)


@pytest.mark.slow
def test_a_browser_turns_the_ground_without_fetching_anything(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api", reason="extra `browser` is not installed")
    (tmp_path / "mine.toml").write_text(TERRAIN)
    page = tmp_path / "mine.html"
    assert main(["draw", str(tmp_path / "mine.toml"), "--out", str(page)]) == 0
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"no Chromium here ({error.message.splitlines()[0]})")
        for width in (1200, 420):
            tab = browser.new_page(viewport={"width": width, "height": 800})
            asked, wrong = [], []
            tab.on("request", lambda request, asked=asked: asked.append(request.url))
            tab.on("pageerror", lambda error, wrong=wrong: wrong.append(error))
            tab.goto(page.as_uri())
            tab.wait_for_timeout(1000)
            canvas = tab.locator("canvas")
            shown = [canvas.screenshot()]
            box = canvas.bounding_box()
            tab.mouse.move(box["x"] + 100, box["y"] + 100)
            tab.mouse.down()
            tab.mouse.move(box["x"] + 180, box["y"] + 120, steps=4)
            tab.mouse.up()
            tab.wait_for_timeout(500)
            shown.append(canvas.screenshot())
            tab.locator("input[type=radio]").nth(2).check()
            tab.wait_for_timeout(1000)
            shown.append(canvas.screenshot())
            canvas.focus()
            tab.keyboard.press("+")
            tab.wait_for_timeout(500)
            shown.append(canvas.screenshot())
            assert len(set(shown)) == 4
            assert tab.evaluate("document.documentElement.scrollWidth") <= width
            assert asked == [page.as_uri()]
            assert not wrong
        browser.close()
