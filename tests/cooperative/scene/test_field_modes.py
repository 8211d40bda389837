"""How many modes a campaign's fields have: counted where it began, and the same on machines that would count otherwise.

Another machine is played by a folder that keeps the count that it would have come to.
"""

import json
import warnings
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.scene import Measured, campaign_of, parse, with_measured
from cooperative.store import read_sample, read_store
from tests.cooperative.scene.test_random_soil import CORRELATED, FIELDS, LEFT, SAND


def at_the_edge(few: int) -> tuple[str, int]:
    """A scene whose energy is held by so many modes but for 1e-6, and the modes it takes here."""
    soil = runs.random_soil(parse(TINY))
    (group,) = soil.groups
    energy = float(np.cumsum(np.asarray(group.expansion.fractions, float))[few - 1]) + 1e-6
    text = TINY.replace("[strength]\n", f"[strength]\nenergy = {energy!r}\n")
    return text, runs.random_soil(parse(text)).modes


def test_a_folder_keeps_the_count_of_the_machine_it_began_on(tmp_path):
    text, here = at_the_edge(6)
    assert here == 7
    folder = tmp_path / "out"
    run(text, folder)
    path = folder / "measured.json"
    assert json.loads(path.read_text()) == {"terms": [7]}
    assert campaign_of(read_store(folder)).measured.terms == (7,)
    # With the count of the other machine, everything of the folder is of 7 modes no more.
    path.write_text('{"terms": [6]}')
    with pytest.warns(UserWarning, match="holds 7 coefficients of a field that has 6"):
        run(text, folder)
    assert read_sample(read_store(folder), "refined", 0).coefficients.shape == (6,)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(text, folder)


def test_workers_and_readers_take_the_kept_count(tmp_path):
    text, _ = at_the_edge(6)
    campaign = replace(parse(text), measured=Measured((6,)))
    assert runs.random_soil(campaign).modes == 6
    (tmp_path / "measured.json").write_text('{"terms": [7]}')
    assert with_measured(campaign, tmp_path) == campaign


def test_the_modes_are_those_of_the_field_but_for_the_last():
    text, here = at_the_edge(6)
    own = runs.build(parse(text), "rough", runs.random_soil(parse(text)), at_rest=False)
    fewer_campaign = replace(parse(text), measured=Measured((6,)))
    fewer = runs.build(fewer_campaign, "rough", runs.random_soil(fewer_campaign), at_rest=False)
    xi = np.random.default_rng(1).normal(size=here).astype(np.float32)
    xi[-1] = 0
    np.testing.assert_array_equal(own.strength(jnp.asarray(xi)), fewer.strength(jnp.asarray(xi[:-1])))


@pytest.mark.parametrize("text", [SAND, SAND + CORRELATED, SAND.replace(FIELDS, FIELDS + LEFT)])
def test_each_group_takes_its_own(text):
    soil = runs.random_soil(parse(text))
    kept = runs.random_soil(replace(parse(text), measured=Measured(soil.counts)))
    assert kept.counts == soil.counts
    assert [group.names for group in kept.groups] == [group.names for group in soil.groups]


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ([3], r"measured are 3 terms where energy = 0\.\d+ takes 7: delete the folder's measured\.json"),
        ([12], r"measured are 12 terms where energy = 0\.\d+ takes 7: delete"),
        ([7, 7], r"measured are 2 numbers of terms for 1 expansions: delete"),
        ([0], r"(counts|terms) = \[0\]: give a list of whole numbers, each 1 or more"),
        ([], r"(counts|terms) = \[\]: give a list of whole numbers"),
        ([7.5], r"(counts|terms) = \[7\.5\]: give a list of whole numbers"),
    ],
)
def test_counts_that_are_not_of_this_field_are_refused(tmp_path, counts, said):
    text, _ = at_the_edge(6)
    with pytest.raises(ValueError, match=said):
        runs.random_soil(parse(f"{text}\n[field_modes]\ncounts = {counts}\n"))
    folder = tmp_path / "out"
    run(text, folder)
    (folder / "measured.json").write_text(json.dumps({"terms": counts}))
    with pytest.raises(ValueError, match=said):
        run(text, folder)
    assert read_sample(read_store(folder), "rough", 0).coefficients.shape == (7,)
