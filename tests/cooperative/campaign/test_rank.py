"""A campaign whose samples a function ranks in place of a coarse grid."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run
from cooperative.folder import read_results
from cooperative.reporting import progress_of
from cooperative.reporting._sentences import screened, words
from cooperative.runs import coefficients_of, random_soil, scores_of, screened_by
from cooperative.scene import Campaign, campaign_of, parse
from cooperative.store import COARSE, read_rows, read_store, stored_text
from cooperative.tools.safety import RANKS, factor_of_safety, rank_by_slices
from jaxmpm import FrictionalSoil, Section

SCENE = TINY.replace(
    'samples = 6\nseed = 3\nk_t = 2\nestimator = "published"',
    "samples = 40\nseed = 3\nrefined_runs = 10\nslides = 0",
)
CALLS = []


def by_first(campaign, coefficients):
    """The first coefficient, the largest part of the field's mean: weak soil fails."""
    assert isinstance(campaign, Campaign)
    CALLS.append(len(coefficients))
    return -coefficients[:, 0]


@dataclass(frozen=True)
class Linear:
    """What a regression has learnt."""

    weight: tuple[float, ...]

    def __call__(self, campaign, coefficients):
        return coefficients[:, : len(self.weight)] @ np.array(self.weight)


def ranked(rank):
    """The small campaign with what ranks its samples."""
    campaign = parse(SCENE)
    return replace(campaign, coarse=rank, plan=replace(campaign.plan, rough_samples=14))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ranked") / "campaign"

    class Enough(Exception):
        pass

    def leave(phase):
        if phase == "audit":
            raise Enough

    with pytest.raises(Enough):
        run(ranked(by_first), folder, on_phase=leave)
    return folder, run(ranked(by_first), folder)


def test_the_scores_draw_one_sample_of_each_zone(done):
    store, summary = read_store(done[0]), done[1]
    rough = read_rows(store, "rough")
    scores = np.array(json.loads(stored_text(done[0], "scores")), float)
    assert scores.shape == (40,)
    assert read_rows(store, COARSE).numbers == []
    assert len(rough.numbers) == 14
    assert rough.columns["zone_weight"].sum() == pytest.approx(1.0)
    of_zones = rough.columns["coarse_score"]
    assert (np.argsort(scores[rough.numbers]) == np.argsort(of_zones)).all()
    assert (summary.cost.coarse_samples, summary.cost.samples) == (40, 14)


def test_a_campaign_that_goes_on_asks_for_no_scores_again(done):
    assert CALLS.count(40) == 1


def test_its_folder_is_read_without_the_function(done):
    campaign = campaign_of(read_store(done[0]))
    assert campaign.coarse.words.endswith("test_rank.by_first")
    assert [each.grid for each in progress_of(done[0]).grids] == ["rough", "refined"]
    results = read_results(done[0])
    assert results.summary == done[1]
    assert screened(results.summary).startswith(f"40 random slopes were ranked by {__name__}.by_first, 14 of them")
    assert f"{__name__}.by_first: 40 samples" in words(results)
    with pytest.raises(ValueError, match=r"coarse is .*by_first, which a script gave"):
        scores_of(campaign, np.zeros((40, 3)))


def test_another_function_is_another_campaign(done):
    with pytest.raises(ValueError, match="belongs to another scene"):
        run(ranked(Linear((1.0, 2.0))), done[0])


@pytest.mark.parametrize("facing", [1, -1])
def test_slices_rank_soil_by_its_factor_of_safety(facing):
    campaign = parse(SCENE)
    if facing == -1:
        slope = campaign.site.shape
        corners = [(-x, z) for x, z in reversed(as_corners(slope))]
        campaign = replace(campaign, ground=replace(campaign.site, shape=Section(corners), ends="fixed"))
    coefficients = np.asarray(coefficients_of(campaign, random_soil(campaign)))[:4]
    scores = rank_by_slices(campaign, coefficients)
    known = [factor_of_safety(campaign, sample=n, grid="rough", solver=False).equilibrium for n in range(4)]
    critical = np.array([each.circle.factor for each in known])
    # The scores have the circles with which the search for the critical one begins.
    assert (np.argsort(-scores) == np.argsort(critical)).all()
    assert (-scores >= critical * (1 - 1e-6)).all()
    assert (-scores < 1.1 * critical).all()


def as_corners(slope):
    top = slope.foundation + slope.height
    return [(0, top), (slope.crest, top), (slope.toe_x, slope.foundation), (slope.length, slope.foundation)]


def test_a_sample_without_a_score_leads_the_ranks():
    assert screened_by(np.array([1.0, np.nan])) == {0: (1.0, False), 1: (pytest.approx(np.nan, nan_ok=True), True)}


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        (np.zeros(39), r"shape \(39,\).*each of the 40 samples"),
        (np.zeros((40, 1)), r"shape \(40, 1\)"),
        (np.full(40, np.inf), "40 of them infinite"),
        (np.full(40, "a"), "gives <U1 numbers"),
        (np.zeros(40, complex), "gives complex128 numbers"),
    ],
)
def test_what_is_no_score_is_refused(scores, message):
    campaign = ranked(lambda campaign, coefficients: scores)
    with pytest.raises(ValueError, match=message):
        scores_of(campaign, np.zeros((40, 3)))


def test_what_neither_ranks_nor_is_a_grid_is_refused():
    with pytest.raises(ValueError, match="coarse"):
        ranked("slice")
    with pytest.raises(ValueError, match="has a coarse grid without rough_samples: give both, or neither"):
        replace(parse(SCENE), coarse=by_first)


def test_ground_that_is_no_section_has_no_slices():
    campaign = parse(SCENE)
    shape = replace(campaign.site.shape, width=4.0)
    random = {name: replace(field, length=(20.0, 20.0, 2.0)) for name, field in campaign.random.items()}
    grid = replace(campaign.rough, spacing=(1.0, 1.0, 1.0))
    solid = replace(campaign, ground=replace(campaign.site, shape=shape), random=random, rough=grid, refined=grid)
    with pytest.raises(ValueError, match="limit equilibrium is for sections"):
        rank_by_slices(solid, np.zeros((1, random_soil(solid).modes)))


def test_soil_with_friction_is_ranked_too():
    campaign = parse(SCENE)
    soil = FrictionalSoil(cohesion=4e3, friction=20.0)
    varies = replace(campaign.random["strength"], mean=4e3)
    campaign = replace(campaign, soil=soil, random={"cohesion": varies})
    modes = random_soil(campaign).modes
    weak, strong = rank_by_slices(campaign, np.stack([np.zeros(modes), 2 * np.eye(modes)[0]]))
    assert weak != strong
    assert np.isfinite([weak, strong]).all()


def test_rows_are_read_by_the_path_of_the_folder_or_its_database(done):
    known = read_rows(read_store(done[0]), "refined").columns["displacement"]
    for path in (done[0], str(done[0]), done[0] / "campaign.db"):
        assert (read_rows(path).columns["displacement"] == known).all()
    with pytest.raises(ValueError, match="holds no campaign"):
        read_rows(done[0].parent)


SLICED = 'coarse = "slices"\n' + SCENE.replace("samples = 40\n", "samples = 40\nrough_samples = 10\n").replace(
    "t_end = 4.0", "t_end = 0.3"
)


def test_a_scene_names_the_slices_that_rank_its_samples(tmp_path):
    with pytest.raises(ValueError, match=r"coarse = 'slices' is a name, .* ranks=cooperative.tools.safety.RANKS"):
        run(SLICED, tmp_path / "none")
    assert not (tmp_path / "none").exists()
    summary = run(SLICED, tmp_path / "out", ranks=RANKS)
    campaign = campaign_of(read_store(tmp_path / "out"))
    assert (campaign.coarse, summary.cost.ranked_by, summary.cost.samples) == ("slices", "slices", 10)
    scores = np.array(json.loads(stored_text(tmp_path / "out", "scores")), float)
    known = rank_by_slices(campaign, np.asarray(coefficients_of(campaign, random_soil(campaign))))
    assert scores == pytest.approx(known, rel=1e-6)
    assert read_results(tmp_path / "out").summary == summary


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"slices"', '"slice"', "coarse = 'slice': give 'slices', or a table"),
        ('"slices"', '"os:system"', "coarse = 'os:system': give 'slices', or a table"),
        ("rough_samples = 10\n", "", "has a coarse grid without rough_samples: give both"),
        ("toe = 16.0", "toe = 16.0\nwidth = 4.0", "coarse = 'slices' is for sections, not for ground in 3D"),
    ],
)
def test_a_scene_names_only_what_this_package_has(old, new, message):
    solid = SLICED.replace("1.0]", "1.0, 1.0]").replace("0.5]", "0.5, 0.5]").replace("4.0]", "4.0, 4.0]")
    with pytest.raises(ValueError, match=message):
        parse((solid if "width" in new else SLICED).replace(old, new))
