"""An estimator of one's own runs in a campaign as those of the package do, and its folder knows whose it is."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from cooperative import campaign
from cooperative.estimate import TwoPhase, all_samples, rank_samples, with_variance
from cooperative.reporting import progress_of
from cooperative.scene import FromScript, campaign_of, parse
from cooperative.store import read_rows, read_store
from cooperative.summary import summarise
from tests.cooperative.campaign.test_campaign import TINY

SCENE = TINY.replace('estimator = "published"\n', "").replace("k_t = 2\n", "")


@dataclass(frozen=True)
class EveryKth:
    """Every k-th sample of the ranking runs refined and stands for k."""

    k: int
    name: ClassVar[str] = "every k-th rank"

    def check(self, sampling):
        if sampling.samples % self.k:
            raise ValueError(f"samples = {sampling.samples}: give a multiple of k = {self.k}")

    def rough_runs(self, sampling):
        return sampling.samples

    def coefficients(self, sampling, screened):
        return sampling.draw()

    def population(self, sampling, screened):
        return all_samples(sampling, screened)

    def budget(self, samples):
        return samples // self.k

    def chosen(self, population):
        order = rank_samples(population.rough_displacement, population.broke_off).order
        return order[self.k // 2 :: self.k].tolist()

    def next_runs(self, population, answers, lanes, under_way):
        missing = [s for s in self.chosen(population) if s not in answers and s not in under_way]
        return missing[: max(lanes - len(under_way), 0)]

    def estimate(self, population, answers):
        known = [bool(answers[s]) for s in self.chosen(population) if s in answers]
        share = float(np.mean(known)) if known else 0.0
        return with_variance(self.name, share, share * (1 - share) / max(len(known), 1), len(known))

    def path(self, population, answers):
        return [self.estimate(population, answers)]

    def weights(self, population, answers):
        return {s: float(self.k) for s in self.chosen(population) if s in answers}

    def beside(self, population, answers):
        return []

    def why_finished(self, population, answers):
        return None if self.next_runs(population, answers, 1, ()) else f"every {self.k}. rank has run"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign") / "own"
    return folder, campaign.run(SCENE, folder, estimator=EveryKth(2))


def test_an_estimator_of_ones_own_runs_a_campaign(done):
    folder, summary = done
    store = read_store(folder)
    rough, refined = read_rows(store, "rough"), read_rows(store, "refined")
    order = np.argsort(-rough.columns["displacement"], kind="stable")
    assert sorted(order[1::2].tolist()) == refined.numbers
    assert summary.probability.estimator == "every k-th rank"
    assert summary.cost.finished == "every 2. rank has run"
    assert summary.probability.value == np.mean(refined.columns["displacement"] > 1.0)
    assert campaign.run(SCENE, folder, estimator=EveryKth(2)) == summary
    assert summarise(campaign_of(store, EveryKth(2)), rough, refined) == summary
    assert [grid.planned for grid in progress_of(folder, estimator=EveryKth(2)).grids] == [6, 3]


def test_a_folder_goes_on_with_its_own_estimator_only(done):
    folder, _ = done
    with pytest.raises(
        ValueError, match=r"estimator is EveryKth\(k=2\), not EveryKth\(k=3\): give that one, or another folder"
    ):
        campaign.run(SCENE, folder, estimator=EveryKth(3))
    with pytest.raises(ValueError, match=r"estimator is EveryKth\(k=2\), which a script gave"):
        campaign.run(read_store(folder).source, folder)
    with pytest.raises(ValueError, match=r"estimator is EveryKth\(k=2\), not EveryKth\(k=3\)"):
        campaign.run(read_store(folder).source, folder, estimator=EveryKth(3))
    with pytest.raises(ValueError, match=r"EveryKth\(k=2\), which a script gave"):
        progress_of(folder)


def test_what_does_not_go_with_a_given_estimator_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"estimator has no effect beside estimator = EveryKth\(k=2\)"):
        parse(TINY, EveryKth(2))
    with pytest.raises(ValueError, match=r"refined_runs has no effect"):
        parse(SCENE.replace("seed = 3", "seed = 3\nrefined_runs = 20"), TwoPhase(refined_runs=10))
    with pytest.raises(ValueError, match=r"samples = 6: give a multiple of k = 4"):
        parse(SCENE, EveryKth(4))
    with pytest.raises(ValueError, match=r"give an object of a frozen dataclass"):
        parse(SCENE, EveryKth)
    assert not any(tmp_path.iterdir())


def test_a_worker_needs_no_estimator():
    source = parse(SCENE, EveryKth(2)).source
    assert parse(source).estimator == FromScript("estimator", "EveryKth(k=2)")
    assert parse(source, EveryKth(2)).estimator == EveryKth(2)
