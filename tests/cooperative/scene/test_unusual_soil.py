"""Numbers of a scene's soil that look like slips, and fields that no soil has: refused, unless declared unusual."""

import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.scene import campaign_of, parse
from cooperative.store import read_store
from tests.cooperative.scene.test_random_soil import CORRELATED, CRACKED, LEFT, SAND, SOFT, changed


def bounded(lower, upper):
    return f'cov = 0.4\nmarginal = "truncated normal"\nlower = {lower}\nupper = {upper}'


REFUSED = [
    (TINY, ("mean = 30e3", "mean = 30.0"), r"mean = 30 Pa, below 1000 Pa: were kPa meant\?.* unusual = true in"),
    (TINY, ("unit_weight = 20e3", "unit_weight = 18.0"), r"unit_weight = 18 N/m3, below 3000 N/m3: were kN/m3 .*meant"),
    (TINY, ("young = 2e7", "young = 20.0"), r"young = 20 Pa, below 200000 Pa: were kPa or MPa meant\?"),
    (TINY, ("softening_modulus = 85e3", "softening_modulus = 85.0"), r"modulus = 85 Pa, below 500 Pa: were kPa meant"),
    (SAND, ("mean = 5e3", "mean = 3.0"), r"\[soil.cohesion\] mean = 3 Pa, below 100 Pa: were kPa meant\?"),
    (SAND, ("mean = 22.0", "mean = 0.35"), r"\[soil.friction\] mean = 0.35 degrees, below 1.6 .* degrees meant"),
    (TINY, ("cov = 0.4", "cov = 0.4\nboreholes = [[1.0, 1.0, 35.0]]"), r"value = 35 Pa, below 1000 Pa: were kPa meant"),
    (TINY, ("unit_weight = 20e3", "unit_weight = 18e6"), r"= 1.8e\+07 N/m3, above 40000 N/m3: was a factor of 1000"),
    (TINY, ("unit_weight = 20e3", "unit_weight = 1800.0"), r"= 1800 N/m3, below .* or kg/m3 \(9.81 N/m3\) meant"),
    (TINY, ("mean = 30e3", "mean = 30e6"), r"\[strength\] mean = 3e\+07 Pa, above 5e\+06 Pa: was a factor of 1000 put"),
    (TINY, ("cov = 0.4", "cov = 0.4\ntrend = -1.2"), r"\[strength\] -trend = 1.2 Pa per metre, below 50 Pa per metre"),
    (TINY, ("cov = 0.4", bounded("10.0", "60e3")), r"\[strength\] lower = 10 Pa, below 1000 Pa: were kPa meant"),
    (SAND, ("upper = 50.0", "upper = 0.9"), r"\[soil.friction\] upper = 0.9 degrees, below 1.6 degrees"),
    (TINY, ("cov = 0.4", "cov = 30.0"), r"\[strength\] cov = 30, above 3: it is a share, 1 for 100 per cent; were per"),
    (TINY, ("softening_modulus = 85e3", "strain_95 = 200.0"), r"strain_95 = 200, above 5: .* were per cent meant"),
    (SOFT, ("mean = 0.2", "mean = 20.0"), r"\[soil.softening_strain\] mean = 20, above 5: .* per cent meant"),
    (TINY, ("[run]", "[run]\ngravity = 981.0"), r"\[run\] gravity = 981 m/s2, above 30 m/s2: were cm/s2 meant"),
    (
        SAND,
        ("poisson = 0.3", "poisson = 0.3\nresidual_friction = 70.0"),
        r"residual_friction = 70 degrees: give a value",
    ),
    (SAND, ("poisson = 0.3", "poisson = 0.3\ndilation = 10.0"), r"dilation reaches 10 degrees, friction comes down to"),
    (
        SAND,
        ('marginal = "truncated normal"\nlower = 5.0\nupper = 50.0', 'marginal = "normal"\nupper = 50.0'),
        r"Normal has",
    ),
    (
        SAND,
        ('cov = 0.2\nmarginal = "truncated normal"\nlower = 5.0\nupper = 50.0', "cov = 0.4"),
        r"values of .* degrees",
    ),
    (
        SAND,
        ("poisson = 0.3", "poisson = 0.3\nsoftening_strain = 0.2\nresidual_friction = 12.0"),
        r"residual_friction = 12 degrees, but friction comes down to 5\.49: give a residual of at most",
    ),
    (
        SOFT,
        ("mean = 4.0", "mean = 6.0"),
        r"\[soil.residual_friction\] reaches 7\.3.* degrees, but friction comes down to 5\.49",
    ),
    (
        CRACKED,
        ("[soil.softening_modulus]\nmean = 85e3\ncov = 0.4\nlength = [20.0, 4.0]", ""),
        r"\[soil.residual_ratio\] varies, but the soil does not soften: add softening_modulus or strain_95 to \[soil\]",
    ),
    (SOFT, (LEFT[LEFT.index("[soil.softening_strain") :], ""), r"does not soften: add softening_strain to \[soil\]"),
    (
        CRACKED,
        ("mean = 0.5\ncov = 0.1", "mean = 0.5\ncov = 0.3"),
        r"\[soil.residual_ratio\] has values of 1\.55, 4 dev.*: give a value from 0 to 1",
    ),
    (CRACKED, ("mean = 85e3", "mean = nan"), r"\[soil.softening_modulus\] mean = nan: give finite values"),
    (TINY, ("young = 2e7", "young = 2e7\ncohesion = 5e3"), r"\[soil\] cohesion is given beside a strength"),
    (TINY, ("young = 2e7", "young = 2e7\nstrength = 30e3"), r"both \[strength\] and \[soil\] strength are given"),
    (TINY, ("young = 2e7", "young = 2e7\ncriterion = 'mohr-coulomb'"), r"criterion has no say in undrained soil"),
    (SAND, ("young = 2e7", "young = 2e7\ngap_memory = true"), r"gap_memory has no say in soil without tension_cutoff"),
    (SAND, ("young = 2e7", "young = 2e7\nresidual_ratio = 0.5"), r"residual_ratio has no say in soil with cohesion"),
    (TINY, ("cov = 0.4", "cov = 0.4\ntrend = -5e3"), r"trend = -5000 per metre brings the mean of 30000 to -2e\+04"),
    (
        TINY,
        ("cov = 0.4", "cov = 0.4\nbedding = { dip = 95.0 }"),
        r"\[strength.bedding\] dip = 95 degrees: give a value from 0 to 90",
    ),
    (TINY, ("cov = 0.4", "cov = 0.4\nbedding = { slope = 5.0 }"), r"\[strength.bedding\] has an unknown key 'slope'"),
    (TINY, ("cov = 0.4", "cov = 0.4\nboreholes = [[1.0, 35e3]]"), r"boreholes hold \[1.0, 35000.0\]: give 3 numbers"),
    (TINY, ("length = [20.0, 4.0]", "length = [nan, 4.0]"), r"\[strength\] length = \[nan, 4.0\]: give finite values"),
    (SAND, ("[rough]", CORRELATED.replace('"friction"]', '"young"]') + "[rough]"), r"'young', which is no parameter"),
    (SAND, ("[rough]", CORRELATED.replace("[-0.5, 1.0]", "[0.5, 1.0]") + "[rough]"), r"is not symmetric"),
    (SAND, ("[rough]", CORRELATED.replace("0.5", "1.5") + "[rough]"), r"not positive definite"),
    (SAND, ("[rough]", CORRELATED.replace("[1.0, -0.5]", "[2.0, -0.5]") + "[rough]"), r"diagonal .* must be 1"),
    (SAND, ("[rough]", CORRELATED.replace("-0.5", "nan") + "[rough]"), r"matrix = .* give finite values"),
    (SAND, ("[rough]", CORRELATED.replace("[[1.0, -0.5], ", "[") + "[rough]"), r"matrix has 1 rows of 2 numbers for 2"),
    (SAND + CORRELATED, ("length = [20.0, 4.0]", "length = [20.0, 5.0]"), r"friction has not the length, correlation"),
]


@pytest.mark.parametrize(("text", "change", "message"), REFUSED, ids=[str(c[1])[:40] for _, c, _ in REFUSED])
def test_slips_and_fields_that_no_soil_has_are_refused(text, change, message):
    with pytest.raises(ValueError, match=message) as refused:
        parse(changed(text, change))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 500


def test_a_scene_may_mean_what_looks_like_a_slip():
    odd = changed(TINY, ("mean = 30e3", "mean = 30.0"), ("unit_weight = 20e3", "unit_weight = 18.0\nunusual = true"))
    assert parse(odd).soil.unit_weight == 18.0
    spun = changed(TINY, ("[run]", "[run]\ngravity = 490.5"), ("young = 2e7", "young = 1e5\nunusual = true"))
    assert parse(spun).run.gravity == 490.5


def test_a_campaign_under_way_is_not_asked_about_its_numbers(tmp_path):
    odd = changed(TINY, ("young = 2e7", "young = 1e5"), ("[run]", "[run]\ngravity = 490.5"))
    with pytest.raises(ValueError, match=r"\[run\] gravity = 490.5 m/s2, above 30 m/s2"):
        run(odd, tmp_path / "new")
    assert not (tmp_path / "new").exists()
    (tmp_path / "scene.toml").write_text(odd)
    assert campaign_of(read_store(tmp_path)).soil.young == 1e5
    with pytest.raises(ValueError, match="workers = 0"):
        run(odd, tmp_path, workers=0)


def test_boreholes_that_cannot_be_are_refused():
    outside = changed(TINY, ("cov = 0.4", "cov = 0.4\nboreholes = [[99.0, 1.0, 35e3]]"))
    with pytest.raises(ValueError, match=r"random strength: points reach from 99\.0"):
        runs.random_soil(parse(outside))
    bounded = changed(TINY, ("cov = 0.4", 'cov = 0.2\nmarginal = "uniform"\nboreholes = [[4.0, 1.0, 95e3]]'))
    with pytest.raises(ValueError, match=r"value 95000 at \[4.0, 1.0\] m cannot occur in Uniform"):
        runs.random_soil(parse(bounded))
