"""The report: one page that needs nothing else, with every figure drawn, and the same numbers as the summary."""

import csv
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from cooperative import runs
from cooperative.__main__ import main
from cooperative.estimate import FITTED, Estimate
from cooperative.exports import write_table
from cooperative.folder import models_of, read_results
from cooperative.hazard import hazard_maps
from cooperative.reporting import _bodies as bodies
from cooperative.reporting import _composition as composition
from cooperative.reporting import _interactive as interactive
from cooperative.reporting import _page as html
from cooperative.reporting import _sentences as sentences
from cooperative.reporting import report
from cooperative.scene import parse
from cooperative.store import open_store, read_rows, read_sample, read_store, write_sample
from cooperative.summary import Summary
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.effects.test_exposed import HAZARD
from tests.databases import spoil

SCENE = TINY.replace("samples = 6", "samples = 14").replace('estimator = "published"', "refined_runs = 10") + HAZARD


class Page(HTMLParser):
    """Tags, sources and text of a page; raises where tags do not close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.images, self.links, self.text, self.ids = [], [], [], [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        given = dict(attributes)
        self.links += [given[name] for name in ("href", "xlink:href", "src", "action", "data") if name in given]
        self.ids += [given["id"]] if "id" in given else []
        if given.get("role") == "img":
            self.images.append(given)
        if tag not in ("meta", "link", "img", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in ("meta", "link", "img", "input"):
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] not in (["style"], ["script"]):
            self.text.append(data)


@pytest.fixture(params=["with the extra", "without"])
def extra(request, monkeypatch):
    """Whether Plotly is installed."""
    with_it = request.param == "with the extra"
    if with_it:
        pytest.importorskip("plotly", reason="the extra interactive is not installed")
    monkeypatch.setattr(interactive, "installed", lambda: with_it)
    return with_it


def test_the_page_needs_nothing_else_and_every_figure_is_drawn(tmp_path, done, extra):
    folder = copied(done, tmp_path / "c")
    if not extra:  # with it the folder is reported already
        report(folder)
    text = (folder / "report.html").read_text()
    shown = Page(text)
    assert "default-src 'none'" in text.split("</head>")[0]
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert {"ranked", "convergence", "grids", "exceedance", "hazard", "losses", "field", "slope"} <= names
    assert len([name for name in names if name.startswith("slide-")]) == 3
    # Every figure has its caption, and a drawing that is well-formed for itself and names that caption.
    drawings = re.findall(r'<svg role="img".*?</svg>', text, flags=re.S)
    assert shown.tags.count("figure") == shown.tags.count("figcaption") == len(drawings) == len(names)
    captions = dict(re.findall(r'<figcaption id="(.*?)">(.*?)</figcaption>', text))
    assert len(captions) == len(names)
    assert all(len(caption) > 25 for caption in captions.values())
    for drawing in map(ElementTree.fromstring, drawings):
        assert drawing.get("aria-labelledby") in captions
        inside = {each.get("id") for each in drawing.iter()}
        used = {each.get("{http://www.w3.org/1999/xlink}href", "") for each in drawing.iter()}
        used |= {f"#{name}" for each in drawing.iter() for name in re.findall(r"url\(#(.*?)\)", str(each.attrib))}
        assert {name[1:] for name in used if name.startswith("#")} <= inside
        assert not drawing.findall(".//{*}style")
    assert len(set(shown.ids)) == len(shown.ids)
    # Nothing is fetched, and nothing runs but where figures answer.
    assert all(link.startswith(("data:", "#")) for link in shown.links)
    assert not re.search(r"url\((?!#)|@import", re.sub(r"<script.*?</script>", "", text, flags=re.S))
    live = re.findall(r'<div id="([\w-]+)" class="plotly-graph-div"', text)
    assert set(live) == ({"ranked", "grids", "exceedance", "hazard", "losses"} if extra else set())
    assert text.count("<noscript>") == len(live)
    assert ("<script" in text) == extra
    assert len(text) < 1.5e6 + (len(interactive.script()) if extra else 0)


def test_nothing_is_shown_twice(done):
    folder, summary = done
    modes = {mode for mode, share in summary.modes.shares.items() if share.count}
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert ("modes" in names) == ("severity" in names) == (len(modes) > 1)
    # Nothing is fitted to fewer than ten slides.
    fitted = {mode for mode in modes if summary.modes.shares[mode].count >= FITTED} if len(modes) > 1 else {"all"}
    enough = summary.consequences.slides >= FITTED
    assert {name for name in names if name.startswith("fits")} == {f"fits-{mode}" for mode in fitted if enough}
    assert enough or "Too few slides for a fit" in (folder / "report.html").read_text()
    shown = Page((folder / "report.html").read_text())
    assert not any("influence area" in text for text in shown.text)


def test_figures_that_answer_hold_the_numbers_of_the_summary(done):
    pytest.importorskip("plotly", reason="the extra interactive is not installed")
    _, summary = done
    curve = summary.consequences.exceedance["runout"]
    *band, shown = interactive.stairs({"runout": curve}, {"runout": "run-out $L$ [m]"}, "probability [-]").data
    assert (shown.x.tolist(), shown.y.tolist()) == ([*curve.thresholds], [*curve.probability])
    assert [each.y.tolist() for each in band] == [[*curve.low], [*curve.high]]
    assert shown.customdata.tolist() == [list(limits) for limits in zip(curve.low, curve.high, strict=True)]
    displacements = {
        "sample": np.array([4, 7, 9]),
        "rough": np.array([0.1, np.nan, 2.0]),
        "refined": np.array([np.nan, 3.0, 4]),
    }
    rough, refined = interactive.ranked(displacements, 1.0).data
    assert rough.x.tolist() == refined.x.tolist() == [3, 1, 2]
    assert rough.customdata.tolist() == [4, 7, 9]


def test_the_page_says_what_the_summary_holds(done):
    folder, summary = done
    text = " ".join(Page((folder / "report.html").read_text()).text)
    low, high = summary.probability.interval
    assert f"{summary.probability.value:.3g}" in text
    assert f"{low:.3g} to {high:.3g}" in text
    assert f"{summary.probability.grids.spearman:.2f}" in text
    assert "What more runs would bring" in text
    assert "One slope in 10 slides to" in text
    for mode, share in summary.modes.shares.items():
        assert (mode in text) == (share.count > 0)
    for fits in summary.consequences.fits["all"].values():
        assert fits.best_aic is None or fits.best_aic in text
    for status in summary.cost.status["refined"]:
        assert status in text
    assert "jaxlib" in text
    assert "run_per_rise = 1.0" in text
    assert Summary.from_json((folder / "summary.json").read_text()) == summary


def test_the_table_tells_what_each_refined_run_stands_for(done):
    folder, summary = done
    with open(write_table(read_store(folder)), newline="") as file:
        lines = list(csv.DictReader(file))
    refined = [line for line in lines if line["grid"] == "refined"]
    failing = sum(float(line["weight"]) for line in refined if line["failed"] == "1.0")
    assert failing / sum(float(line["weight"]) for line in refined) == pytest.approx(
        summary.probability.value, abs=1e-12
    )
    assert sum(line["failed"] == "1.0" for line in refined) == summary.probability.failures_refined > 0
    assert {line["weight"] for line in lines if line["grid"] == "rough"} == {""}


def test_maps_add_up_to_what_the_slides_cover(done):
    folder, summary = done
    maps = hazard_maps(folder)
    reached, covered = maps.maps["reached"], maps.maps["covered at the end"]
    assert (reached.value + 1e-12 >= covered.value).all()
    assert reached.value.max() == pytest.approx(summary.probability.value)
    assert (reached.high <= summary.probability.interval[1] + 1e-12).all()
    with open(write_table(read_store(folder)), newline="") as file:
        slides = [line for line in csv.DictReader(file) if line["failed"] == "1.0"]
    expected = sum(float(line["slide_weight"]) * float(line["area_columns"]) for line in slides)
    assert float(covered.value[maps.beyond].sum()) * maps.plan.area == pytest.approx(expected, rel=1e-9)
    # Edges of particles lead the columns by less than one.
    for line in slides:
        assert abs(float(line["area_columns"]) - float(line["area"])) < 1.5 * maps.plan.cell
    thickness = maps.maps["expected thickness"].value.sum() * maps.plan.area
    store, grid = read_store(folder), models_of(parse(SCENE))["refined"]
    position, size = np.asarray(grid.scene.particles.position, float), np.asarray(grid.scene.particles.volume, float)
    volume = 0.0
    for line in slides:
        moved = read_sample(store, "refined", int(line["sample"])).fields["displacement"].astype(float)
        x, z = position + moved
        above = np.clip((z - grid.campaign.site.shape.heights(x)) / 0.5 + 0.5, 0.0, 1.0)
        mine = float(line["slide_weight"]) * size * above * (np.linalg.norm(moved, axis=0) >= 1.0)
        volume += mine.sum()
        # What slides below the surface that was there before is no deposit.
        assert mine.sum() < 0.8 * float(line["slide_weight"]) * float(line["volume"])
    assert thickness == pytest.approx(volume, rel=1e-3)
    carried = maps.maps["ground carried away"]
    assert 0 < carried.value.max() <= summary.probability.value + 1e-12
    assert summary.consequences.elements_at_risk["road"].carried.probability <= summary.probability.value + 1e-12


def test_expected_loss_is_the_area_under_its_curve(done):
    _, summary = done
    loss, road = summary.consequences.risk.loss, summary.consequences.elements_at_risk["road"]
    curve = loss.exceedance
    assert float(np.array(curve.probability[:-1]) @ np.diff(curve.thresholds)) == pytest.approx(loss.expected, rel=1e-9)
    assert loss.expected == pytest.approx(road.loss.expected)
    assert 0 < loss.interval[0] < loss.expected < loss.interval[1]
    assert sum(loss.modes.values()) == pytest.approx(1.0)
    assert summary.consequences.elements_at_risk["house"].loss is None
    assert 0 < road.arrival.mean < summary.consequences.elements_at_risk["house"].arrival.mean


@pytest.mark.usefixtures("unrendered")
def test_names_with_markup_stay_text(tmp_path, done):
    text = SCENE.replace('name = "tiny"', "name = '<script>alert(1)</script> & co'")
    with open_store(tmp_path / "odd", text) as store:
        for number in range(14):
            write_sample(store, "rough", read_sample(read_store(done[0]), "rough", number))
    report(tmp_path / "odd", slides=0)
    shown = Page((tmp_path / "odd" / "report.html").read_text())
    assert "<script>alert" not in (tmp_path / "odd" / "report.html").read_text()
    assert any("<script>alert(1)</script> & co" in text for text in shown.text)
    # A campaign that has not ended says so.
    assert any("has not ended. The results so far are from 14 of 14 samples" in text for text in shown.text)


@pytest.mark.usefixtures("unrendered")
def test_runs_that_broke_off_and_damaged_files_are_on_the_page(tmp_path, done):
    with open_store(tmp_path / "c", SCENE) as store:
        for number in range(14):
            sample = read_sample(read_store(done[0]), "rough", number)
            if number == 4:
                row = {"displacement": 0.3, "broke_off": True}
                sample = replace(sample, status="NOT_FINITE", row=row, fields={})
            write_sample(store, "rough", sample)
    spoil(tmp_path / "c", "rough", 7)
    report(tmp_path / "c", slides=0)
    text = " ".join(Page((tmp_path / "c" / "report.html").read_text()).text)
    assert "sample 4 on the rough grid: NOT_FINITE at step" in text
    assert "sample 7 of the rough grid does not match its checksum" in text


def test_slides_are_chosen_by_mode_then_by_distance(done):
    folder, summary = done
    results = read_results(folder)
    rows = results.refined
    grid, chosen = results.slides_to_draw(3)
    assert grid == "refined"
    assert len(chosen) == len(set(chosen)) == 3
    modes = dict(zip(rows.numbers, rows.columns["mode"], strict=True))
    occur = {mode for mode, share in summary.modes.shares.items() if share.count}
    assert {modes[number] for number in chosen} == occur or len(occur) > 3
    assert chosen[0] == rows.numbers[int(np.argmax(rows.columns["displacement"]))]
    none = replace(results, summary=replace(summary, consequences=replace(summary.consequences, weights={})))
    assert none.slides_to_draw(3) == ("refined", [chosen[0]])
    assert results.soils() == [("rough", chosen[0]), *(("refined", number) for number in chosen)]


def test_a_sample_run_again_ends_where_it_ended(done):
    folder, _ = done
    store = read_store(folder)
    rows = read_rows(store, "refined")
    sample = read_sample(store, "refined", rows.numbers[int(np.argmax(rows.columns["displacement"]))])
    campaign = parse(SCENE)
    shown = composition.moments(runs.build(campaign, "refined", runs.random_soil(campaign)), sample)
    assert np.array_equal(shown.displacement[-1], sample.fields["displacement"])
    far = np.linalg.norm(shown.displacement, axis=1).max(axis=1)
    assert len(shown.times) == 4
    assert (np.diff(far) > 0).all()
    assert (far >= np.array([0.1, 0.3, 0.6, 1.0]) * sample.row["displacement"] * (1 - 1e-6)).all()


def test_slides_are_drawn_from_their_frames_and_without_them_from_their_end(done):
    folder, _ = done
    store = read_store(folder)
    rows = read_rows(store, "refined")
    sample = read_sample(store, "refined", rows.numbers[int(np.argmax(rows.columns["displacement"]))])
    models = models_of(parse(SCENE))
    soil = runs.soil_of(models["refined"], sample.coefficients)
    shown = composition.stored_moments(sample, soil)
    limit, far = (
        parse(SCENE).run.failure_displacement,
        [np.linalg.norm(each, axis=0).max() for each in shown.displacement],
    )
    assert len(shown.times) == 1 + sum(sample.row["displacement"] > passed * limit for passed in (1, 5))
    assert limit < far[0] < far[-1]
    ends = {name: values for name, values in sample.fields.items() if not name.startswith("frame")}
    (only,) = composition.stored_moments(replace(sample, fields=ends), soil).times
    assert only == shown.times[-1]
    none = composition.stored_moments(replace(sample, fields={}), soil)
    assert list(composition.drawn_slide(runs.ground_of(models), "refined", sample, soil, none)) == []


def test_no_slides_and_bad_numbers_of_slides(done, capsys):
    folder, _ = done
    assert main(["report", str(folder), "--slides", "-1"]) == 2
    assert "slides = -1: give 0 or more" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("chance", "text"),
    [(0.0, ""), (1.0, ""), (0.999, ": more than 99 in 100 such slopes"),
     (0.4, ": 40 in 100 such slopes"), (0.1, ": 10 in 100 such slopes"),
     (0.05, ": one in 20 such slopes"), (0.0012, ": one in 830 such slopes"), (1e-6, ": one in 1,000,000 such slopes")],
)  # fmt: skip
def test_probabilities_are_counted_in_slopes(chance, text):
    assert sentences.in_slopes(chance) == text


def _estimate(chance, interval, runs=20):
    return Estimate(chance, interval, np.inf, runs, "two-phase")


@pytest.mark.parametrize(
    ("estimate", "terminal", "page"),
    [
        (_estimate(0.465, (0.0, 1.0), 0), "not known yet  (two-phase; no refined run counts so far)",
         "How likely the slope fails is not known yet (no refined run counts so far)."),
        (_estimate(0.0, (0.0, 0.171)), "0, at most 0.171  (95% confidence; two-phase)",
         "No refined run has failed: the slope fails with a probability of at most 0.171 (95% confidence)."),
        (_estimate(1.0, (0.829, 1.0)), "1, at least 0.829  (95% confidence; two-phase)",
         "Every refined run has failed: the slope fails with a probability of at least 0.829 (95% confidence)."),
        (_estimate(3.57e-6, (1.23456e-6, 1e-5)), "3.57e-06  (95% interval 1.23e-06 to 1e-05; two-phase)",
         "(95% interval 1.23e-06 to 1e-05): one in 280,000 such slopes."),
        (_estimate(0.24449, (0.0, 0.5)), "0.244  (95% interval 0 to 0.5; two-phase)", ": 24 in 100 such slopes."),
    ],
    ids=["before the first refined run", "none fails", "all fail", "rare", "some fail"],
)  # fmt: skip
def test_the_answer_in_words(estimate, terminal, page):
    assert sentences.probability(estimate) == terminal
    whole = " ".join(sentences.verdict(estimate))
    assert page in whole
    # Only failures that were seen are counted in slopes.
    assert ("such slopes" in whole) == (0 < estimate.probability < 1 and estimate.interval != (0.0, 1.0))


def test_bodies_go_with_their_soil():
    at = np.meshgrid(np.arange(6.0), np.arange(4.0), np.arange(3.0), indexing="ij")
    position, half = np.stack([each.ravel() for each in at]), np.full(3, 0.5)
    stretch = np.array([[0.5], [0.0], [0.0]]) * position
    displacement = np.stack([0 * position, 2.0 + 0 * position, stretch])
    body = bodies.moving(position, displacement, [0.0, 1.0, 2.0], half)
    still, shifted, stretched = body.corners
    np.testing.assert_allclose(still.min(axis=0), -0.5)
    np.testing.assert_allclose(shifted, still + 2.0)
    np.testing.assert_allclose(body.magnitude[1], 2.0 * np.sqrt(3))
    # Faces share their corners: the skin has no cracks.
    assert len(np.unique(still, axis=0)) == len(still) == len(np.unique(body.faces))
    inner = (still[:, 0] > 0) & (still[:, 0] < 5)
    np.testing.assert_allclose(stretched[inner, 0], 1.5 * still[inner, 0])
    assert bodies.picture(body).axes[0].collections[0].get_rasterized()


def test_tables_set_numbers_apart_from_text():
    made = html.table(["a", "b"], [["x < y", 1.23456], [None, 7]])
    assert '<td data-head="a">x &lt; y</td><td class="number" data-head="b">1.23</td>' in made
    assert '<td class="number" data-head="a">–</td><td class="number" data-head="b">7</td>' in made
    assert '<th scope="col">a</th><th scope="col" class="number">b</th>' in made
    values = (0.12345, 42_561.0, 999.7, 1234.5, 1e12, -123.456)
    assert [html.number(value) for value in values] == ["0.123", "42,600", "1,000", "1,230", "1e+12", "-123"]


def copied(done, folder):
    """A campaign's folder copied from a finished one."""
    shutil.copytree(done[0], folder)
    return folder
