"""The report in a real browser: nothing fetched, nothing wider than the page, figures that answer, light and dark."""

import json
import re
import shutil
from itertools import pairwise

import pytest

from benchmarks.hazard_populations import SOLID
from cooperative import run
from cooperative.reporting import report
from tests.test_coop_report import SCENE

playwright = pytest.importorskip("playwright.sync_api", reason="extra `browser` is not installed")
pytestmark = pytest.mark.slow
WIDTHS = (1200, 400)

# Contrast of each text with what is behind it, by WCAG 2.1, section 1.4.3.
CONTRASTS = """() => {
  const parts = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const light = (colour) => {
    const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    const [r, g, b] = parts(colour).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    for (let each = element; each; each = each.parentElement) {
      const colour = getComputedStyle(each).backgroundColor, alpha = parts(colour)[3];
      if (alpha === undefined || alpha === 1) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const said = new Map();
  for (const element of document.querySelectorAll("body *")) {
    if (["SCRIPT", "NOSCRIPT", "STYLE"].includes(element.tagName)) continue;
    if (![...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim())) continue;
    const style = getComputedStyle(element), ink = element.closest("svg") ? style.fill : style.color;
    const [a, b] = [light(ink), light(behind(element))].sort((x, y) => y - x);
    const name = `${element.tagName}.${element.getAttribute("class")}: ${element.textContent.slice(0, 20)}`;
    said.set(name, (a + 0.05) / (b + 0.05));
  }
  return Object.fromEntries(said);
}"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Reports of a section with exposed places and of a slope in 3D with maps."""
    found = {}
    solid = SOLID.replace("samples = 300", "samples = 12\nrefined_runs = 10").replace("t_end = 6.0", "t_end = 3.0")
    for name, text in (("section", SCENE), ("solid", solid)):
        folder = tmp_path_factory.mktemp("campaign") / name
        run(text, folder)
        report(folder, slides=1)
        found[name] = folder / "report.html"
    return found


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        try:
            opened = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        except playwright.Error as error:
            said = error.message.splitlines()[0]
            pytest.skip(f"no Chromium here ({said}): playwright install chromium, or a system one")
        yield opened
        opened.close()


@pytest.fixture
def opened(browser, pages):
    """Opens a report: (name, width, colours) -> page; at the end no page may have complained or asked for anything."""
    complaints, asked, contexts = [], [], []

    def opens(name, width=1200, colours="light"):
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=colours)
        contexts.append(context)
        shown = context.new_page()
        shown.on("console", lambda message: complaints.append(message.text))
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.on("request", lambda request: asked.append(request.url))
        shown.goto(pages[name].as_uri())
        return shown

    yield opens
    for context in contexts:
        context.close()
    assert complaints == []
    assert {url for url in asked if not url.startswith("data:")} <= {path.as_uri() for path in pages.values()}


def exceedance(shown):
    """The panel of the run-out's exceedance curve."""
    return shown.locator(".panel", has=shown.get_by_text("probability of more")).first


@pytest.mark.parametrize("name", ["section", "solid"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_page(opened, name, width):
    shown = opened(name, width)
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    beyond = "[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1)"
    assert shown.evaluate(f"{beyond}.map(e => e.outerHTML.slice(0, 80))") == []
    # Text in figures can be read on a phone.
    high = shown.evaluate("[...document.querySelectorAll('.panel text')].map(e => e.getBoundingClientRect().height)")
    assert min(high) > 8


@pytest.mark.parametrize("name", ["section", "solid"])
def test_text_stands_out_in_light_and_dark(opened, name):
    grounds = set()
    for colours in ("light", "dark"):
        shown = opened(name, 1200, colours)
        exceedance(shown).locator(".chart").focus()
        shown.keyboard.press("ArrowRight")
        found = shown.evaluate(CONTRASTS)
        assert len(found) > 50
        assert {said: ratio for said, ratio in found.items() if ratio < 4.5} == {}
        grounds.add(shown.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert len(grounds) == 2


def test_a_curve_tells_its_values_to_keyboard_and_mouse(opened):
    shown = opened("section")
    panel = exceedance(shown)
    panel.get_by_text("values").click()
    rows = [[float(cell) for cell in row.split("\t")] for row in panel.locator("tbody").inner_text().splitlines()]
    chart, said = panel.locator(".chart"), panel.locator("output")
    chart.focus()
    for at, value, low, high in rows:
        shown.keyboard.press("ArrowRight")
        assert said.inner_text() == (
            f"run-out L [m]: {at:.4g}; probability of more [-]: {value:.4g} ({low:.4g} to {high:.4g})"
        )
    shown.keyboard.press("Home")
    assert f": {rows[0][0]:.4g};" in said.inner_text()
    # Half way between two thresholds the curve is what it was at the first.
    plot = panel.locator(".frame").bounding_box()
    low, high = json.loads(panel.get_attribute("data-panel"))["x"]["ends"]
    first, then = max(pairwise(rows), key=lambda pair: pair[1][0] - pair[0][0])
    between = (first[0] + then[0]) / 2
    across = plot["x"] + (between - low) / (high - low) * plot["width"]
    shown.mouse.move(across, plot["y"] + plot["height"] / 2)
    at, value = re.findall(r"\[[m-]\]: ([\d.]+)", said.inner_text())
    assert float(at) == pytest.approx(between, abs=0.01 * (high - low))
    assert float(value) == pytest.approx(first[1], rel=1e-3)


def test_figures_are_zoomed_by_mouse_and_keyboard_and_shown_whole_again(opened):
    shown = opened("section")
    panel = exceedance(shown)
    chart, ticks, drawn = panel.locator(".chart"), panel.locator(".ticks"), panel.locator(".zoomed")
    chart.scroll_into_view_if_needed()
    whole = ticks.inner_html()
    plot = panel.locator(".frame").bounding_box()
    shown.mouse.move(plot["x"] + 0.25 * plot["width"], plot["y"] + 0.25 * plot["height"])
    shown.mouse.down()
    shown.mouse.move(plot["x"] + 0.75 * plot["width"], plot["y"] + 0.75 * plot["height"], steps=3)
    shown.mouse.up()
    scale = [float(value) for value in re.findall(r"-?[\d.]+", drawn.get_attribute("transform"))]
    assert scale[0] == pytest.approx(2, rel=0.02)
    assert scale[3] == pytest.approx(2, rel=0.02)
    low, high = json.loads(panel.get_attribute("data-panel"))["x"]["ends"]
    below = [float(each.text_content()) for each in ticks.locator("text[text-anchor=middle]").all()]
    assert len(below) > 1
    assert all(low + 0.24 * (high - low) <= tick <= low + 0.76 * (high - low) for tick in below)
    chart.dblclick()
    assert ticks.inner_html() == whole
    chart.focus()
    for key in "++-0":
        shown.keyboard.press(key)
    assert ticks.inner_html() == whole


def test_maps_tell_all_their_values_at_a_place(opened):
    shown = opened("solid")
    first = shown.locator("[data-linked] .panel").first
    first.locator(".chart").focus()
    for key in ("ArrowRight", "ArrowUp", "ArrowRight"):
        shown.keyboard.press(key)
    said = shown.locator("[data-linked]").first.locator("output").all_inner_texts()
    assert len(said) == 9 - (shown.locator("[data-linked] .panel").count() < 9)
    assert len({each.split(";")[0] for each in said}) == 1
    reached, lower, upper = (float(re.search(r"; ([\d.]+)$", each)[1]) for each in said[:3])
    assert lower <= reached <= upper


def test_the_tab_key_goes_through_figures_from_the_top(opened):
    shown = opened("section")
    tops = []
    for _ in range(12):
        shown.keyboard.press("Tab")
        tops.append(shown.evaluate("scrollY + document.activeElement.getBoundingClientRect().top"))
    named = "document.activeElement.getAttribute('aria-label') || document.activeElement.textContent"
    assert shown.evaluate(named)
    rows = shown.evaluate("document.querySelectorAll('.chart[tabindex=\"0\"]').length")
    assert rows == shown.locator(".chart").count()
    assert tops[-1] > tops[0]


@pytest.mark.parametrize("name", ["section", "solid"])
def test_every_figure_has_a_text_alternative(opened, name):
    shown = opened(name)
    bare = """[...document.querySelectorAll("img, canvas, svg")].filter((e) => !e.closest("[aria-hidden]"))
      .filter((e) => !(e.getAttribute("alt") || e.getAttribute("aria-label") || e.parentElement.closest("svg")))"""
    assert shown.evaluate(f"{bare}.length") == 0
    assert shown.evaluate("[...document.querySelectorAll('button')].every((e) => e.getAttribute('aria-label'))")


@pytest.mark.parametrize("colours", ["light", "dark"])
def test_the_page_prints_on_white(opened, colours):
    shown = opened("section", 1200, colours)
    shown.emulate_media(media="print", color_scheme=colours)
    assert shown.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    printed = shown.pdf(prefer_css_page_size=True)
    assert printed.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 3


def test_a_slide_in_3d_turns(opened):
    shown = opened("solid")
    canvas = shown.locator("figure.turn canvas").first
    canvas.scroll_into_view_if_needed()
    shown.wait_for_timeout(500)
    before = canvas.screenshot()
    canvas.focus()
    for _ in range(5):
        shown.keyboard.press("ArrowRight")
    shown.wait_for_timeout(200)
    assert canvas.screenshot() != before
