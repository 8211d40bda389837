"""The report in a real browser: nothing fetched, nothing wider than the page, figures that answer."""

import re
import shutil

import pytest

from benchmarks.statistics.hazard_populations import SOLID
from cooperative import run
from cooperative.reporting import report
from tests.cooperative.reporting.test_report import SCENE

playwright = pytest.importorskip("playwright.sync_api", reason="extra `browser` is not installed")
pytest.importorskip("plotly", reason="the extra interactive is not installed")
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
  const contrasts = new Map();
  for (const element of document.querySelectorAll("body *")) {
    if (["SCRIPT", "NOSCRIPT", "STYLE"].includes(element.tagName) || element.closest("figure > div, svg")) continue;
    if (![...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim())) continue;
    const ink = getComputedStyle(element).color;
    const [a, b] = [light(ink), light(behind(element))].sort((x, y) => y - x);
    const name = `${element.tagName}.${element.getAttribute("class")}: ${element.textContent.slice(0, 20)}`;
    contrasts.set(name, (a + 0.05) / (b + 0.05));
  }
  return Object.fromEntries(contrasts);
}"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Reports of a section with elements at risk and of a slope in 3D with maps."""
    reports = {}
    solid = SOLID.replace("samples = 300", "samples = 12\nrefined_runs = 10").replace("t_end = 6.0", "t_end = 3.0")
    for name, text in (("section", SCENE), ("solid", solid)):
        folder = tmp_path_factory.mktemp("campaign") / name
        run(text, folder)
        report(folder, slides=1)
        reports[name] = folder / "report.html"
    return reports


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        try:
            opened = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        except playwright.Error as error:
            reason = error.message.splitlines()[0]
            pytest.skip(f"no Chromium here ({reason}): playwright install chromium, or a system one")
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
    # A driver of graphics on a machine without any says how slow it is.
    assert [each for each in complaints if "GPU stall" not in each and "willReadFrequently" not in each] == []
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} <= {
        path.as_uri() for path in pages.values()
    }


@pytest.mark.parametrize("name", ["section", "solid"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_page(opened, name, width):
    shown = opened(name, width)
    shown.wait_for_timeout(1000)
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    # Figures scroll sideways on a phone.
    beyond = "[...document.querySelectorAll('body > *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1)"
    assert shown.evaluate(f"{beyond}.map(e => e.outerHTML.slice(0, 80))") == []


@pytest.mark.parametrize("name", ["section", "solid"])
def test_text_stands_out_in_light_and_dark(opened, name):
    grounds = set()
    for colours in ("light", "dark"):
        shown = opened(name, 1200, colours)
        contrasts = shown.evaluate(CONTRASTS)
        assert len(contrasts) > 50
        assert {text: ratio for text, ratio in contrasts.items() if ratio < 4.5} == {}
        grounds.add(shown.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert len(grounds) == 2


def test_a_curve_gives_its_values_and_limits_where_one_points(opened):
    shown = opened("section")
    shown.wait_for_timeout(1000)
    plot = shown.locator("#exceedance .nsewdrag").first
    plot.scroll_into_view_if_needed()
    plot.hover()
    assert re.search(r"[\d.]+ \([\d.]+ to [\d.]+\)", shown.locator("#exceedance .hoverlayer").text_content())


def test_a_sample_gives_its_number_where_one_points(opened):
    shown = opened("section")
    shown.wait_for_timeout(1000)
    shown.locator("#ranked .point").first.scroll_into_view_if_needed()
    box = shown.locator("#ranked .point").first.bounding_box()
    shown.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=3)
    shown.wait_for_timeout(300)
    assert re.search(r"sample \d+: ", shown.locator("#ranked .hoverlayer").text_content())


@pytest.mark.parametrize("name", ["section", "solid"])
def test_without_scripts_every_figure_is_there(browser, pages, name):
    context = browser.new_context(java_script_enabled=False)
    shown = context.new_page()
    shown.goto(pages[name].as_uri())
    drawn = shown.locator("figure svg[role=img]")
    assert drawn.count() == shown.locator("figure").count() > 8
    assert all(drawn.nth(at).bounding_box()["height"] > 100 for at in range(drawn.count()))
    context.close()


def test_a_browser_that_cannot_unpack_the_script_shows_every_figure(browser, pages):
    context = browser.new_context()
    context.add_init_script("delete window.DecompressionStream")
    shown = context.new_page()
    shown.goto(pages["section"].as_uri())
    shown.wait_for_timeout(500)
    drawn = shown.locator("figure svg[role=img]")
    assert drawn.count() == shown.locator("figure").count() > 8
    context.close()


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
    body = shown.locator("figure [id^=body-]").first
    body.scroll_into_view_if_needed()
    shown.wait_for_timeout(2000)
    before, box = body.screenshot(), body.bounding_box()
    shown.mouse.move(box["x"] + 400, box["y"] + 200)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 500, box["y"] + 240, steps=4)
    shown.mouse.up()
    shown.wait_for_timeout(1000)
    assert body.screenshot() != before
