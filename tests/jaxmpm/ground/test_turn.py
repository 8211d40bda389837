"""Bodies in 3D: their skin, and a page of a scene that turns and holds all it needs."""

import re
import shutil
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TERRAIN
from cooperative import reporting
from cooperative.__main__ import main
from cooperative.reporting import _bodies as bodies
from cooperative.reporting import _ground as ground
from cooperative.reporting import _interactive as interactive

GRID = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in (4, 3, 2)), indexing="ij")).reshape(3, -1) * 2.0 + 10
SIZE = (2.0, 2.0, 2.0)


def faces_of(skin):
    return skin.corners[skin.faces]


def normals(faces):
    return np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])


def test_the_skin_of_a_block_is_its_sides_and_top():
    skin = bodies.skin(GRID, SIZE)
    faces = faces_of(skin)
    # 4 x 3 on top, 4 x 2 and 3 x 2 twice round it.
    assert len(faces) == 12 + 2 * 8 + 2 * 6
    np.testing.assert_allclose(faces.min(axis=(0, 1)), [10, 10, 10])
    np.testing.assert_allclose(faces.max(axis=(0, 1)), [18, 16, 14])
    outwards = np.einsum("ni,ni->n", normals(faces), faces.mean(axis=1) - [14, 13, 12])
    assert (outwards > 0).all()
    np.testing.assert_allclose(np.linalg.norm(normals(faces), axis=1), 2 * 4)
    # Each face is that of the particle that it belongs to.
    assert np.abs(faces.mean(axis=1) - GRID[:, skin.of].T).max() == pytest.approx(1.0)


def test_a_hole_has_a_skin_too():
    middle = np.all(np.abs(GRID - [[13], [13], [13]]) < 0.5, axis=0)
    # A well in the top: its four sides and its floor in the place of one face.
    assert len(bodies.skin(GRID[:, ~middle], SIZE).faces) == 40 + 4


def test_bodies_of_many_faces_are_drawn_in_larger_boxes():
    small = faces_of(bodies.skin(GRID, (2.0, 2.0, 2.0), most=30))
    assert len(small) <= 30
    spread = np.ptp(small, axis=(0, 1))
    assert (spread >= [8, 6, 4]).all()
    assert (spread <= np.array([8, 6, 4]) + 3).all()


def test_a_mesh_is_the_faces_in_two_triangles_each_and_lets_no_text_out():
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    skin = bodies.skin(GRID, SIZE)
    name = "</script><script>alert(1)</script>"
    top = skin.faces[-12:]
    mesh = interactive.mesh(skin.corners, top, of_faces=np.arange(12.0), name=name)
    corners = np.stack([mesh.x, mesh.y, mesh.z], axis=1)
    assert len(corners) == 5 * 4
    triangles = corners[np.stack([mesh.i, mesh.j, mesh.k], axis=1)]
    np.testing.assert_allclose(triangles[::2], faces_of(skin)[-12:][:, [0, 1, 2]])
    np.testing.assert_allclose(triangles[1::2], faces_of(skin)[-12:][:, [0, 2, 3]])
    assert mesh.intensity.tolist() == np.repeat(np.arange(12.0), 2).tolist()
    figure = interactive.chosen({name: [mesh], "other": [mesh]}, [interactive.line(GRID[:, :2].T, name)])
    assert "alert(1)</script>" not in interactive.html(figure, "ground")


def test_a_slide_turns_at_each_of_its_times():
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    body = bodies.moving(GRID, np.stack([0 * GRID, 0 * GRID + 1.0]), [0.0, 2.0], np.ones(3))
    figure = interactive.turning(body)
    assert [frame.name for frame in figure.frames] == ["t = 0 s", "t = 2 s"]
    np.testing.assert_allclose(figure.data[0].x, figure.frames[0].data[0].x + 1.0)
    np.testing.assert_allclose(figure.frames[1].data[0].intensity, np.sqrt(3.0))


def scene(folder):
    text = (
        TERRAIN.replace("[terrain]", "[terrain]\nrun_out_line = [[1, 4], [8, 3], [15, 4]]", 1)
        + '\n[[exposed]]\nname = "road"\npolygon = [[12, 0], [14, 0], [14, 8], [12, 8]]\n'
    )
    (folder / "mine.toml").write_text(text)
    return folder / "mine.toml"


def test_a_scene_in_3d_is_drawn_as_a_page(tmp_path, capsys):
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    page, picture = tmp_path / "mine.html", tmp_path / "mine.png"
    assert main(["draw", str(scene(tmp_path))]) == 0
    assert capsys.readouterr().out.split() == [str(picture), str(page)]
    assert picture.read_bytes().startswith(b"\x89PNG")
    whole = page.read_text()
    shown = whole.replace(interactive.script(), "")
    assert len(shown) < len(whole) - 1e6
    assert not re.search(r'src=|url\(|@import|href="(?!data:)|https?:', shown)
    names = set(re.findall(r'"name":"(.*?)"', shown))
    assert {"soil", "road", "run-out line"} <= names
    assert any("wall, x = " in name for name in names)
    assert any("fixed base" in name for name in names)
    assert shown.count('"type":"mesh3d"') >= 3


def test_without_plotly_a_scene_in_3d_is_drawn_as_a_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(interactive, "installed", lambda: False)
    monkeypatch.setattr(reporting, "installed", lambda: False)
    given = scene(tmp_path)
    assert main(["draw", str(given)]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "mine.png")]
    assert main(["draw", str(given), "--out", str(tmp_path / "mine.html")]) == 2
    assert "a page that turns needs plotly, which is not installed: pip install plotly" in capsys.readouterr().err


def test_water_is_drawn_where_it_stands_whatever_says_so():
    x, y = np.array([-1.0, 0.5, 3.0]), np.array([0.0, 1.0, 9.0])
    weight, height = jnp.asarray(9810.0), jnp.asarray(1.0)
    table = mpm.laws.WaterTable(jnp.array([0.0, 2.0]), jnp.array([4.0, 6.0]), weight, height)
    # Heights 4 + x + 2 y on points 2 m apart, level beyond the outermost.
    heights = 4 + jnp.array([[0.0, 4.0], [2.0, 6.0]])
    surface = mpm.laws.WaterSurface(heights, jnp.zeros(2), jnp.asarray(2.0), weight, height)
    for water, known in ((table, [4, 4.5, 6]), (surface, [4, 6.5, 10]), (None, None)):
        result = ground._water(SimpleNamespace(scene=SimpleNamespace(loads=mpm.Loads(water=water))), x, y)
        assert result is None if known is None else np.allclose(result, known)


@pytest.mark.slow
def test_a_browser_turns_the_ground_without_fetching_anything(tmp_path):
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    playwright = pytest.importorskip("playwright.sync_api", reason="extra `browser` is not installed")
    page = tmp_path / "mine.html"
    assert main(["draw", str(scene(tmp_path)), "--out", str(page)]) == 0
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"no Chromium here ({error.message.splitlines()[0]})")
        tab = browser.new_page(viewport={"width": 1200, "height": 800})
        asked, wrong = [], []
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("pageerror", lambda error: wrong.append(error))
        tab.goto(page.as_uri())
        tab.wait_for_timeout(2000)
        body = tab.locator("#ground")
        shown = [body.screenshot()]
        box = body.bounding_box()
        tab.mouse.move(box["x"] + 500, box["y"] + 300)
        tab.mouse.down()
        tab.mouse.move(box["x"] + 580, box["y"] + 320, steps=4)
        tab.mouse.up()
        tab.wait_for_timeout(1000)
        shown.append(body.screenshot())
        tab.get_by_text("refined grid").click()
        tab.wait_for_timeout(1000)
        shown.append(body.screenshot())
        assert len(set(shown)) == 3
        assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page.as_uri()]
        assert not wrong
        browser.close()
