"""How many modes a campaign's fields have: counted where it began, and the same on machines that would count otherwise.

Another machine is played by a folder that keeps the count that it would have come to.
"""

import shutil
import warnings
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.scene import Measured, campaign_of, parse, tables, with_measured
from cooperative.store import open_store, read_sample, read_store
from tests.cooperative.scene.test_random_soil import CORRELATED, FIELDS, LEFT, SAND
from tests.databases import keep, stored


@pytest.fixture(scope="module")
def edge() -> str:
    """A scene whose energy is held by 6 modes but for 1e-6, so that it takes 7 here."""
    (group,) = runs.random_soil(parse(TINY)).groups
    energy = float(np.cumsum(np.asarray(group.expansion.fractions, float))[5]) + 1e-6
    return TINY.replace("[strength]\n", f"[strength]\nenergy = {energy!r}\n").replace("t_end = 4.0", "t_end = 0.3")


@pytest.fixture(scope="module")
def done(edge, tmp_path_factory):
    """The folder of its campaign, which has run."""
    folder = tmp_path_factory.mktemp("edge") / "out"
    run(edge, folder)
    return folder


def test_a_folder_keeps_the_count_of_the_machine_it_began_on(edge, done, tmp_path):
    text, folder = edge, tmp_path / "out"
    shutil.copytree(done, folder)
    assert stored(folder, "measured") == {"terms": [7]}
    assert campaign_of(read_store(folder)).measured.terms == (7,)
    # With the count of the other machine, everything of the folder is of 7 modes no more.
    keep(folder, "measured", {"terms": [6]})
    with pytest.warns(UserWarning, match="holds 7 coefficients of a field that has 6"):
        run(text, folder)
    assert read_sample(read_store(folder), "rough", 0).coefficients.shape == (6,)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(text, folder)


def test_workers_and_readers_take_the_measured_count(edge, tmp_path):
    campaign = replace(parse(edge), measured=Measured((6,)))
    assert runs.random_soil(campaign).modes == 6
    open_store(tmp_path, edge).close()
    keep(tmp_path, "measured", {"terms": [7]})
    assert with_measured(campaign, tmp_path) == campaign


def test_the_modes_are_those_of_the_field_but_for_the_last(edge):
    campaigns = parse(edge), replace(parse(edge), measured=Measured((6,)))
    own, fewer = (runs.build(each, "rough", runs.random_soil(each), at_rest=False) for each in campaigns)
    xi = np.random.default_rng(1).normal(size=7).astype(np.float32)
    xi[-1] = 0
    np.testing.assert_array_equal(own.strength(jnp.asarray(xi)), fewer.strength(jnp.asarray(xi[:-1])))


@pytest.mark.parametrize("text", [SAND, SAND + CORRELATED, SAND.replace(FIELDS, FIELDS + LEFT)])
def test_each_group_takes_its_own(text):
    soil = runs.random_soil(parse(text))
    measured = runs.random_soil(replace(parse(text), measured=Measured(soil.counts)))
    assert measured.counts == soil.counts
    assert [group.names for group in measured.groups] == [group.names for group in soil.groups]


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([3], r"measured are 3 terms where energy = 0\.\d+ takes 7: delete what was measured"),
        ([12], r"measured are 12 terms where energy = 0\.\d+ takes 7: delete"),
        ([7, 7], r"measured are 2 numbers of terms for 1 expansions: delete"),
        ([0], r"(counts|terms) = \[0\]: give a list of whole numbers, each 1 or more"),
        ([], r"(counts|terms) = \[\]: give a list of whole numbers"),
        ([7.5], r"(counts|terms) = \[7\.5\]: give a list of whole numbers"),
    ],
)
def test_counts_that_are_not_of_this_field_are_refused(edge, done, tmp_path, counts, message):
    with pytest.raises(ValueError, match=message):
        runs.random_soil(replace(parse(edge), measured=tables.read(Measured, {"terms": counts})))
    folder = tmp_path / "out"
    shutil.copytree(done, folder)
    keep(folder, "measured", {"terms": counts})
    with pytest.raises(ValueError, match=message):
        run(edge, folder)
    assert read_sample(read_store(folder), "rough", 0).coefficients.shape == (7,)
