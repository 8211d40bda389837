"""Campaigns written in Python: the same as a scene's, stored as text, gone on with by the same law only."""

import importlib.util
import inspect
import json
import pickle
import re
import subprocess
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxmpm as mpm
import kl
from benchmarks.robustness.invented import LAYERED, TERRAIN, TINY
from cooperative import (
    Campaign,
    CampaignGrid,
    CrossCorrelation,
    Hazard,
    MonteCarlo,
    Plan,
    Published,
    RandomField,
    Run,
    Site,
    SiteLayer,
    export,
    read,
    read_store,
    report,
    run,
    runs,
)
from cooperative.exports import export_sample
from cooperative.folder import read_results
from cooperative.reporting._sentences import probability
from cooperative.scene import Exposed, FromScript, _words, campaign_of, parse
from cooperative.scene._words import campaign_of_words, of_words, source_of_value
from cooperative.store import Source, open_store, read_rows, refuse_another
from jaxmpm.run import Rule, Settle
from tests.cooperative.effects.test_exposed import HAZARD
from tests.cooperative.scene.test_own_soil import SensitiveClay, Tresca
from tests.cooperative.scene.test_random_soil import CORRELATED, SAND

SLOPE = mpm.Slope(crest=8.0, height=8.0, run_per_rise=1.0, toe=16.0, foundation=2.0)
CLAY = mpm.Soil(
    unit_weight=20e3, young=2e7, poisson=0.3, strength=30e3, softening_modulus=85e3, residual_ratio=0.5,
    tension_cutoff=0.0, softening_length=8.0 / 5,
)  # fmt: skip


def grid(cell):
    return CampaignGrid(cell, (cell / 2, cell / 2))


TINY_IN_PYTHON = Campaign(
    name="tiny",
    ground=Site(SLOPE, "fixed"),
    soil=CLAY,
    random={"strength": RandomField(30e3, 0.4, (20.0, 4.0))},
    rough=grid(2.0),
    refined=grid(1.0),
    run=Run(t_end=4.0),
    estimator=Published(k_t=2),
    plan=Plan(samples=6, seed=3, fields=("rough", "refined")),
)
SHORT = replace(TINY_IN_PYTHON, run=Run(t_end=0.3), plan=Plan(samples=2), estimator=MonteCarlo(refined_runs=10))


@pytest.mark.parametrize("campaign", [TINY_IN_PYTHON, parse(TINY), parse(LAYERED)])
def test_a_campaign_is_pickled_as_it_is(campaign):
    assert pickle.loads(pickle.dumps(campaign)) == campaign


def test_a_scene_is_read_from_text_and_from_its_path(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(TINY)
    assert read(str(path)) == read(path) == read(TINY)
    with pytest.raises(ValueError, match=r"there is no scene elsewhere\.toml: give the path of a scene"):
        read("elsewhere.toml")


def test_a_campaign_in_python_has_the_defaults_of_a_scene():
    assert source_of_value(TINY_IN_PYTHON).tables == source_of_value(parse(TINY)).tables


def test_ground_alone_is_a_site_and_the_soil_has_the_means_of_what_varies():
    campaign = replace(TINY_IN_PYTHON, ground=SLOPE, soil=replace(CLAY, strength=None))
    assert campaign.site == Site(SLOPE)
    assert campaign.soil.strength == 30e3


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"random": {"strength": RandomField(30e3, 0.4, (20.0,))}}, r"strength has a length of 1 values: give 2"),
        ({"run": Run(slides_t_end=30.0), "plan": Plan(samples=6, slides=0)}, "has no effect beside slides = 0"),
        ({"run": Run(least_volume=1e6)}, "least_volume = 1e[+]06 m2: give more than 0 and less than"),
        ({"plan": Plan(samples=6, screening_stop=0.5)}, r"screening_stop = 0.5 m is below the failure displacement"),
        ({"cross_correlation": CrossCorrelation(("a", "b"), ((1, 0), (0, 1)))}, "parameters hold 'a', which is no"),
        (
            {"soil": mpm.FrictionalSoil(4e3, 30.0, saturated_unit_weight=21e3), "random": {}},
            "has no effect without water in the ground",
        ),
        ({"soil": replace(CLAY, strength=None, strength_ratio=0.3)}, "strength_ratio = 0.3 without water in the"),
        ({"estimator": Published(k_t=0)}, r"k_t = 0"),
        ({"ground": 3.0}, r"float lacks .*: add the members of jaxmpm.Ground"),
    ],
)
def test_a_value_is_checked_as_a_scene_is_and_no_table_of_a_scene_named(changed, message):
    with pytest.raises(ValueError, match=message) as refused:
        replace(TINY_IN_PYTHON, **changed)
    assert "estimator" in changed or not re.search(r"\[[a-z_]+\]", str(refused.value))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Run(t_end=-1.0), "t_end = -1 s: give a finite value above 0"),
        (lambda: Run(t_end="20"), "t_end = '20' is text: give a number"),
        (lambda: Run(early="maybe"), "early = 'maybe' is text: give true or false"),
        (lambda: Run(settle="yes"), "settle = 'yes' is text: give true or false"),
        (lambda: Run(settle=1), "settle = 1 is a whole number: give true or false"),
        (lambda: Run(cfl=1.0), "cfl = 1: give a value above 0 and below 1"),
        (lambda: Run(slides_t_end=1.0), "slides_t_end = 1 s is before t_end = 20 s, up to which all runs go: give"),
        (lambda: Run(rest=True, settle=False), "rest = true with settle = false: a slide that rests has settled"),
        (lambda: Run(duration=3.0), "Run has an unknown key 'duration' (did you mean 't_end'?)"),
        (lambda: Plan(), "Plan lacks samples: add it"),
        (lambda: Plan(0), "samples = 0: give a whole number of 1 or more"),
        (lambda: Plan(samples=6, seed=-1), "seed = -1: give a whole number of 0 or more"),
        (lambda: Plan(6, fields="rouhg"), "fields = 'rouhg': give one of 'none', 'refined', 'both'"),
        (lambda: CampaignGrid(2.0), "CampaignGrid lacks spacing: add it"),
        (
            lambda: CampaignGrid(2.0, (0.0, 1.0)),
            "spacing = (0.0, 1.0) m: give a list of numbers, one per axis, each a finite",
        ),
        (lambda: RandomField(30e3, -0.1, (20.0, 4.0)), "cov = -0.1: give a finite value of 0 or more"),
        (lambda: RandomField(30e3, 0.1, (20.0, 4.0), lower=1.0), "lower = 1: Lognormal has no such bound"),
        (lambda: Hazard(["50"]), "thresholds = '50' has no unit: give one of m, cm, m/s, km/h"),
        (lambda: Exposed("house"), "Exposed has no position: give one of at = [x]"),
        (lambda: replace(TINY_IN_PYTHON, run=3), "run = 3 is a whole number: make it a table"),
    ],
)
def test_a_part_of_a_campaign_is_refused_in_one_line_by_its_class(make, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}") as refused:
        make()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", [TINY, LAYERED, TERRAIN, TINY + HAZARD, SAND + CORRELATED])
def test_words_are_the_campaign_again(text):
    source = source_of_value(parse(text))
    again = campaign_of_words(replace(source, beside=json.loads(json.dumps(source.beside))))
    assert source_of_value(again).tables == source.tables
    model, known = (runs.build(each, "rough", runs.random_soil(each), at_rest=False) for each in (again, parse(text)))
    xi = np.full(known.soil.modes, 0.5, np.float32)
    for name, values in known.parameters(xi).items():
        np.testing.assert_array_equal(values, model.parameters(xi)[name])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "holds no campaign"),
        ({"ground": {"class": "os.system"}}, r"ground holds os\.system, which this version does not have"),
        ({"ground": {"class": "jaxmpm.solve", "scene": 1}}, r"ground holds jaxmpm\.solve"),
        ({"plan": {"class": "cooperative.Plan", "sample": 3}}, "holds no campaign .*sample"),
        ({"soil": {"array": "AAAA", "dtype": "<f8", "shape": [1]}}, "holds no campaign"),
        ({"soil": {"array": "AAAA", "dtype": "|O", "shape": [1]}}, "holds no campaign"),
    ],
)
def test_words_that_are_of_no_campaign_are_named(words, message):
    source = source_of_value(TINY_IN_PYTHON)
    changed = source.beside["campaign"] | words if words else {}
    with pytest.raises(ValueError, match=message):
        campaign_of_words(replace(source, beside={"campaign": changed}))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("value") / "out"
    return folder, run(SHORT, folder)


@pytest.mark.usefixtures("unrendered")
def test_it_runs_goes_on_and_is_reported_from_its_folder_alone(done):
    folder, summary = done
    assert read_store(folder).source.text is None
    assert run(SHORT, folder) == summary
    assert run(read_store(folder).source, folder) == summary
    assert campaign_of(read_store(folder)) == replace(SHORT, measured=campaign_of(read_store(folder)).measured)
    assert probability(summary.probability.estimate) in report(folder)


def test_the_folder_of_another_campaign_is_refused(done):
    folder, _ = done
    with pytest.raises(ValueError, match=r"campaign\.run\.cfl is 0\.9 there and 0\.5 now"):
        run(replace(SHORT, run=replace(SHORT.run, cfl=0.5)), folder)
    with pytest.raises(ValueError, match="it is written in Python there and a scene now"):
        run(TINY, folder)


def test_a_scene_that_was_read_keeps_its_text_unless_it_was_changed(tmp_path):
    def stop(phase):
        raise InterruptedError(phase)

    path = tmp_path / "scene.toml"
    path.write_text(TINY)
    campaign = read(path)
    assert replace(campaign, run=Run(t_end=0.3)).source == campaign.source == Source(TINY)
    again = replace(replace(campaign, run=Run(t_end=0.3)), run=campaign.run)
    for name, value in (("same", again), ("other", replace(campaign, run=Run(t_end=0.3)))):
        with pytest.raises(InterruptedError):
            run(value, tmp_path / name, on_phase=stop)
    assert read_store(tmp_path / "same").source.text == TINY
    assert read_store(tmp_path / "other").source.text is None
    with pytest.raises(InterruptedError):
        run(path, tmp_path / "same", on_phase=stop)


@dataclass(frozen=True)
class Logged(mpm.Soil):
    """A soil that holds more than its numbers."""

    log: Any = None


def test_a_campaign_that_cannot_be_stored_is_refused_before_anything_is_written(tmp_path):
    with open(tmp_path / "log", "w") as file:
        soil = Logged(strength=30e3, log=file)
        with pytest.raises(ValueError, match=r"soil\.log is <_io\.TextIOWrapper .*which has no words"):
            run(replace(SHORT, soil=soil), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@dataclass(frozen=True)
class Stratum(mpm.Layer):
    """A layer of a script's own."""


@dataclass(frozen=True)
class SlowRest(Settle):
    """A stopping rule of a script's own."""


@dataclass(frozen=True)
class AtTime(Rule):
    """A stopping rule of a script's own that looks at nothing but the time."""

    seconds: float

    def measure(self, scene, state):
        return ()

    def judge(self, memory, reading):
        return memory, np.where(reading.time >= self.seconds, mpm.Status.SETTLED, mpm.Status.RUNNING)


class Skewed(kl.Lognormal):
    """A marginal of a script's own."""


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"run": Run(settle=SlowRest())}, "run"),
        ({"run": Run(settle=AtTime(0.1))}, "run"),
        ({"random": {"strength": replace(SHORT.random["strength"], marginal=Skewed)}}, "random"),
        ({"ground": Site(SLOPE, layers=(SiteLayer("clay", Stratum(CLAY, depth=None), {}, rock=False),))}, "ground"),
    ],
)
def test_a_folder_names_each_part_that_its_script_has_to_give_again(changed, name):
    campaign = campaign_of_words(source_of_value(replace(SHORT, **changed)))
    assert [missing.what for missing in campaign.missing] == [name]
    with pytest.raises(ValueError, match=f"the campaign's {name} is .*, which a script gave: run that script"):
        campaign.require()


def test_the_class_of_a_rule_is_no_rule():
    scene, state = mpm.block((2.0,), CLAY, mpm.Discretisation(1.0, (0.5,)), domain=(8,), corner=(3.0,))
    for rule in (Settle, AtTime):
        with pytest.raises(ValueError, match=f"settle = {rule.__name__} is a class: give a rule of it"):
            Run(settle=rule)
        with pytest.raises(ValueError, match="give a list of rules"):
            mpm.solve(scene, state, t_end=0.1, rules=[rule])
        with pytest.raises(ValueError, match=r"give Settle\(...\) or another rule"):
            mpm.factor_of_safety(scene, state, settle=rule)


def test_runs_of_a_campaign_end_by_a_rule_of_ones_own(tmp_path):
    run(replace(SHORT, run=Run(t_end=0.3, settle=AtTime(0.1))), tmp_path)
    for grid in ("rough", "refined"):
        columns = read_rows(tmp_path, grid).columns
        assert set(columns["status"]) == {"SETTLED"}
        assert (columns["time"] >= 0.1).all()
        assert (columns["time"] < 0.3).all()


def test_what_a_script_gave_is_asked_of_it():
    source = source_of_value(replace(SHORT, soil=Logged(strength=30e3)))
    campaign = campaign_of_words(source)
    assert isinstance(campaign.soil, FromScript)
    assert campaign.run == SHORT.run
    with pytest.raises(ValueError, match=r"the campaign's soil is .*Logged\(.*log=null\), which a script gave"):
        runs.check_size(campaign)


@dataclass(frozen=True)
class Hill(mpm.Section):
    """Ground of a script's own."""


@pytest.mark.usefixtures("unrendered")
def test_ground_of_ones_own_is_reported_drawn_and_exported_from_the_folder_alone(tmp_path):
    strata = tuple(
        SiteLayer(name, mpm.Layer(replace(CLAY, unusual=True), depth=depth), SHORT.random, rock=False)
        for name, depth in (("crust", 2.0), ("clay", None))
    )
    hill = Hill([(0, 10), (8, 10), (16, 2), (32, 2)], toe=16.0)
    campaign = replace(SHORT, ground=Site(hill, layers=strata), plan=replace(SHORT.plan, fields=("rough", "refined")))
    summary = run(campaign, tmp_path)
    ground = runs.read_ground(tmp_path)
    ((x, z),) = ground.boundaries()
    np.testing.assert_allclose(z, np.interp(x, [0, 8, 16, 32], [8, 8, 0, 0]), atol=1e-3)
    assert ground.walls == ((0, 0.0, "roller"), (0, 32.0, "roller"))
    assert isinstance(campaign_of(read_store(tmp_path)).site.shape, FromScript)
    assert probability(summary.probability.estimate) in report(tmp_path)
    drawn = {number for _, number in read_results(tmp_path).soils()}
    others = {0, 1} - drawn
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        paths = [path.name for path in export(tmp_path)]
    assert {f"rough-{number:06d}.vtkhdf" for number in drawn} <= set(paths)
    assert not {f"rough-{number:06d}.vtkhdf" for number in others} & set(paths)
    assert all(any(f"no particles of sample {number} on" in str(each.message) for each in caught) for number in others)
    for number in others:
        with pytest.raises(ValueError, match=r"grid fails .*Hill\(.*which a script gave.*give one of"):
            export_sample(tmp_path, number, "rough")


def test_a_script_that_changed_is_warned_of_and_another_parameter_is_refused(tmp_path):
    law = tmp_path / "law_of_mine.py"
    text = "import dataclasses, jaxmpm\n"
    text += "@dataclasses.dataclass(frozen=True)\nclass Weak(jaxmpm.Soil):\n    share: float = 0.2\n"

    def campaign(text, **numbers):
        law.write_text(text)
        spec = importlib.util.spec_from_file_location("law_of_mine", law)
        module = importlib.util.module_from_spec(spec)
        sys.modules["law_of_mine"] = module
        spec.loader.exec_module(module)
        return replace(SHORT, soil=module.Weak(strength=30e3, **numbers))

    with open_store(tmp_path / "folder", source_of_value(campaign(text))):
        pass
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refuse_another(tmp_path / "folder", source_of_value(campaign(text)))
    with pytest.warns(UserWarning, match=r"the file that defines law_of_mine\.Weak is not as it was when"):
        refuse_another(tmp_path / "folder", source_of_value(campaign(text + "# changed\n")))
    with pytest.raises(ValueError, match=r"campaign\.soil\.fields\.share is 0\.2 there and 0\.3 now"):
        refuse_another(tmp_path / "folder", source_of_value(campaign(text, share=0.3)))


OWN = """
import sys
from dataclasses import dataclass
from functools import partial
from typing import Any
import jax.numpy as jnp
import jaxmpm as mpm
import kl
from cooperative import Campaign, CampaignGrid, MonteCarlo, Plan, RandomField, Run, run
from jaxmpm.laws import add, elastic_increment
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant

"""
OWN += inspect.getsource(Tresca) + inspect.getsource(SensitiveClay)
OWN += """
if __name__ == "__main__":
    campaign = Campaign(
        ground=mpm.Slope(crest=8.0, height=8.0, run_per_rise=1.0, toe=16.0, foundation=2.0), soil=SensitiveClay(),
        random={"strength": RandomField(25e3, 0.4, (20.0, 4.0), trend=1e3)},
        rough=CampaignGrid(2.0, (1.0, 1.0)), refined=CampaignGrid(1.0, (0.5, 0.5)),
        run=Run(t_end=0.5), plan=Plan(samples=3), estimator=MonteCarlo(refined_runs=10))
    print(run(campaign, sys.argv[1], workers=int(sys.argv[2])).probability.value)
"""


def script(text: str, folder: Path, workers: int) -> subprocess.CompletedProcess[str]:
    path = folder.parent / "own.py"
    path.write_text(text)
    command = [sys.executable, str(path), str(folder), str(workers)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.slow
def test_a_law_of_a_script_runs_on_two_workers_and_warns_of_another_source(tmp_path):
    first = script(OWN, tmp_path / "two", 2)
    assert first.returncode == 0, first.stderr
    assert script(OWN, tmp_path / "one", 1).stdout == first.stdout
    assert script(OWN, tmp_path / "two", 1).stdout == first.stdout
    again = script(OWN.replace("jnp.exp(-3 *", "jnp.exp(-4 *"), tmp_path / "two", 2)
    assert again.returncode == 0, again.stderr
    assert "the file that defines __main__.SensitiveClay is not as it was" in again.stderr
    assert f"probability of failure  {float(first.stdout):.3g}" in report(tmp_path / "two")


def test_no_two_objects_of_the_packages_have_the_same_name_in_words():
    objects = {}
    for module in _words.OFFER:
        for name in module.__all__:
            known = objects.setdefault((module.__name__.partition(".")[0], name), getattr(module, name))
            assert known is getattr(module, name), name


@pytest.mark.parametrize(
    "name", ["jaxmpm.save_state", "jaxmpm.load_state", "jaxmpm.write_vtkhdf", "jaxmpm.read_raster"]
)
def test_no_words_lead_to_a_function_that_opens_files(name):
    assert of_words({"offered": "kl.sobol"}, "coefficients") is kl.sobol
    with pytest.raises(ValueError, match=f"holds {name}, which this version does not have"):
        of_words({"offered": name}, "coefficients")
