"""A campaign on ground with a toe: drawn like a slope it has the slope's answer, and a user's own class will do."""

import json
import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import TINY
from cooperative import Campaign, CampaignGrid, MonteCarlo, Plan, RandomField, Run, report, run, runs
from cooperative.scene import parse
from tests.cooperative.scene.test_scene_sections import OUTLINE
from tests.jaxmpm.ground.test_ground import Embankment

TOED = OUTLINE.replace("[ground]", "[ground]\ntoe = 16.0\ncrest = 8.0")
RIGHT = "[[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]"
MEASURED_ANEW = {"seconds", "checksum"}
"""What differs between two campaigns of one scene."""


def flat(summary, where="summary"):
    """Values of a summary by their path: floats, which `approx` compares to 1e-6, and the words of all else."""
    if isinstance(summary, dict):
        pairs = [(f"{where}/{key}", each) for key, each in summary.items() if key not in MEASURED_ANEW]
    elif isinstance(summary, list):
        pairs = [(f"{where}/{number}", each) for number, each in enumerate(summary)]
    else:
        return {where: summary if isinstance(summary, float) else repr(summary)}
    return {where: str(len(pairs))} | {path: value for at, each in pairs for path, value in flat(each, at).items()}


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def test_a_slope_drawn_with_its_toe_has_the_slopes_summary(tiny_campaign, tmp_path):
    run(TOED, tmp_path / "drawn")
    drawn, slope = summary_of(tmp_path / "drawn"), summary_of(tiny_campaign[0])
    assert flat(drawn) == pytest.approx(flat(slope), nan_ok=True)
    assert drawn["modes"]["shares"]["deep"]["count"] > 0
    assert drawn["consequences"]["means"]["runout"]["mean"] > 5


def test_without_a_toe_there_are_no_modes():
    assert parse(TINY).modes == parse(TOED).modes == ("refined",)
    assert parse(OUTLINE).modes == ()


def test_a_section_that_falls_to_the_left_has_run_outs_and_modes_beyond_its_toe(tmp_path):
    left = TOED.replace(RIGHT, "[[0.0, 2.0], [16.0, 2.0], [24.0, 10.0], [32.0, 10.0]]").replace("= 8.0", "= 24.0")
    assert runs.reach_of(parse(left)) == pytest.approx(runs.reach_of(parse(TOED)))
    run(left, tmp_path)
    summary = summary_of(tmp_path)
    assert summary["modes"]["shares"]["deep"]["count"] > 0
    assert summary["consequences"]["means"]["runout"]["mean"] > 5


REFUSED = {
    "toe = 500.0": "[ground] toe = 500 m lies outside the ground, which reaches from x = 0 to 32 m",
    "toe = 12.0": "[ground] toe = 12 m is no foot of a slope, a point of the surface",
    "toe = 16.0\ncrest = 20.0": "[ground] crest = 20 m lies on the other side of the toe at x = 16 m",
    "crest = 8.0": "[ground] crest = 8 m without a toe",
}


@pytest.mark.parametrize("keys", REFUSED)
def test_a_toe_that_the_ground_has_not_is_refused(keys):
    with pytest.raises(ValueError, match=re.escape(REFUSED[keys])):
        parse(OUTLINE.replace("[ground]", f"[ground]\n{keys}"))


def test_a_campaigns_grid_is_built_and_run_over_a_ground_of_ones_own():
    scene = parse(
        TOED.replace('fields = "both"', 'fields = "both"\nmodes = "both"').replace("mean = 30e3", "mean = 9e3")
    )
    own = Embankment()
    campaign = replace(scene, ground=own)
    assert campaign.dimension == 2
    soil = runs.random_soil(campaign)
    assert soil.groups[0].box == (own.corner, own.extent)
    model = runs.build(campaign, "rough", soil)
    size = runs.grid_size(campaign, "rough")
    assert size.particles == pytest.approx(model.scene.particles.mass.size, rel=0.02)
    assert size.nodes == np.prod(model.scene.grid.shape)
    (sample,) = runs.run_samples(model, jnp.zeros((1, soil.modes)), [0])
    displacement = sample.fields["displacement"]
    x, z = np.asarray(model.scene.particles.position)
    sliding = np.linalg.norm(displacement, axis=0) >= 1
    front = (x + displacement[0])[sliding].max() + 0.5
    assert sliding.any()
    # Beyond its own toe, and below its own crest.
    assert sample.row["runout_any"] == pytest.approx(max(front - own.face.toe_x, 0))
    assert sample.row["depth"] == pytest.approx(own.subsoil + own.height - (z[sliding].min() - 0.5))
    assert sample.row["mode"] in ("deep", "shallow", "progressive")
    assert isinstance(model.geometry, mpm.Face)


@pytest.mark.slow
def test_a_campaign_of_a_ground_of_ones_own_runs_on_two_workers_and_is_reported(tmp_path, unrendered):
    clay = mpm.Soil(unit_weight=20e3, young=2e7, strength=14e3, softening_modulus=85e3, tension_cutoff=0.0)
    campaign = Campaign(
        ground=Embankment(),
        soil=clay,
        random={"strength": RandomField(14e3, 0.3, (20.0, 4.0))},
        rough=CampaignGrid(2.0, (1.0, 1.0)),
        refined=CampaignGrid(1.0, (0.5, 0.5)),
        run=Run(t_end=3.0),
        plan=Plan(samples=3),
        estimator=MonteCarlo(refined_runs=10),
    )
    summary = run(campaign, tmp_path / "own", workers=2)
    assert sum(mode.count for mode in summary.modes.shares.values()) == summary.probability.failures_refined == 3
    text = report(tmp_path / "own")
    assert f"m beyond the toe, where {campaign.runout_thickness:.3g} m is left" in text
    assert summary_of(tmp_path / "own")["consequences"]["slides"] == 3
