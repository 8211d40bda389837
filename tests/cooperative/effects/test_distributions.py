"""Fits of known samples, against closed forms and against the truth; severity with its uncertainty."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, special, stats

from cooperative.estimate import _fits, fit_distributions, severity_ranking
from cooperative.estimate._fits import CANDIDATES

TRUTHS = {
    "normal": stats.norm(12, 2),
    "logistic": stats.logistic(50, 4),
    "gamma": stats.gamma(1.5, scale=200),
    "Weibull": stats.weibull_min(1.8, scale=400),
    "lognormal": stats.lognorm(0.8, scale=10),
    "Gumbel": stats.gumbel_r(-5, 3),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_the_true_family_is_the_best_for_many_samples(name):
    values = TRUTHS[name].rvs(4000, random_state=3)
    result = fit_distributions(values)
    assert result.best_aic == result.best_bic == name
    at = np.quantile(values, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(result.fits[0].frozen.cdf(at), TRUTHS[name].cdf(at), atol=0.03)


def test_normal_lognormal_and_gamma_fits_meet_their_closed_forms():
    values = stats.gamma(3, scale=1e5).rvs(200, random_state=1)
    fits = {fit.name: fit for fit in fit_distributions(values).fits}
    np.testing.assert_allclose(fits["normal"].parameters, (values.mean(), values.std()), rtol=1e-6)
    log = np.log(values)
    np.testing.assert_allclose(fits["lognormal"].parameters, (log.std(), 0, np.exp(log.mean())), rtol=1e-4, atol=1e-9)
    gap = np.log(values.mean()) - log.mean()
    shape = optimize.brentq(lambda k: np.log(k) - special.digamma(k) - gap, 1e-2, 1e3)
    np.testing.assert_allclose(fits["gamma"].parameters, (shape, 0, values.mean() / shape), rtol=1e-6, atol=1e-9)
    for fit in fits.values():
        assert fit.aic == pytest.approx(4 - 2 * fit.log_likelihood)
        assert fit.bic == pytest.approx(2 * np.log(200) - 2 * fit.log_likelihood)


@pytest.mark.parametrize("name", TRUTHS)
def test_no_nearby_parameters_are_more_likely(name):
    values = TRUTHS["gamma"].rvs(150, random_state=2)
    fit = {fit.name: fit for fit in fit_distributions(values).fits}[name]
    family, free = CANDIDATES[name].family, [at for at, value in enumerate(fit.parameters) if value != 0]
    for at in free:
        for factor in (0.99, 1.01):
            changed = list(fit.parameters)
            changed[at] *= factor
            assert family.logpdf(values, *changed).sum() < fit.log_likelihood + 1e-6


@given(st.floats(1e-3, 1e6))
def test_the_choice_does_not_depend_on_the_unit(factor):
    values = TRUTHS["lognormal"].rvs(60, random_state=4)
    here, there = fit_distributions(values), fit_distributions(values * factor)
    assert [fit.name for fit in here.fits] == [fit.name for fit in there.fits]
    assert here.fits[0].aic - here.fits[1].aic == pytest.approx(there.fits[0].aic - there.fits[1].aic, abs=1e-3)


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_families_that_are_nearly_as_good_as_the_best_are_named(factor):
    first, *others = (result := fit_distributions(TRUTHS["gamma"].rvs(60, random_state=0) * factor)).fits
    close = [fit.name for fit in others if fit.aic < first.aic + 2]
    assert 0 < len(close) < len(others)
    assert f"{first.name} is not clearly better than {', '.join(close)}" in " ".join(result.notes)


def test_too_few_and_not_positive_are_noted():
    few = fit_distributions(np.arange(1.0, 11.0))
    assert few.best_aic is not None
    assert "10 samples are too few to tell distributions apart" in few.notes[0]
    for values in (np.arange(1.0, 10.0), np.full(20, 3.0)):
        none = fit_distributions(values)
        assert (none.best_aic, none.fits) == (None, ())
        assert "too few for a fit: it takes 10" in none.notes[0]
    touched = fit_distributions(np.append(TRUTHS["normal"].rvs(40, random_state=0), 0.0))
    assert {fit.name for fit in touched.fits} == {"normal", "logistic", "Gumbel"}
    assert sum("is for positive values" in note for note in touched.notes) == 3


def test_fits_refuse_what_is_not_finite():
    with pytest.raises(ValueError, match="not finite"):
        fit_distributions(np.array([1.0, np.nan]))


def test_severity_order_and_its_doubt():
    generator = np.random.default_rng(0)
    groups = {
        "shallow": generator.normal(5, 1, 60),
        "deep": generator.normal(12, 2, 80),
        "compound": generator.normal(12.1, 2, 8),
        "progressive": generator.normal(30, 3, 20),
        "lone": np.array([1.0]),
        "few": np.array([0.1, 0.2, 0.3, 0.4]),
    }
    ranked = severity_ranking(groups)
    assert ranked[0].group == "progressive"
    assert ranked[0].rank_interval == (1, 1)
    assert {ranked[1].group, ranked[2].group} == {"deep", "compound"}
    for entry in ranked[1:3]:
        assert entry.rank_interval == (2, 3)
    # Four show too little of their spread, as one does.
    for entry in ranked[4:]:
        assert entry.rank_interval == (1, 6)
        assert entry.interval is None
    assert [entry.group for entry in ranked[4:]] == ["lone", "few"]
    with pytest.raises(ValueError, match="'none' is empty"):
        severity_ranking({"none": np.array([])})


def test_bootstrap_interval_covers_the_mean():
    generator = np.random.default_rng(5)
    hits = 0
    for seed in range(200):
        entry = severity_ranking({"a": generator.normal(0, 1, 50)}, statistic=np.mean, resamples=400, seed=seed)[0]
        hits += entry.interval[0] <= 0 <= entry.interval[1]
    assert 0.83 <= hits / 200 <= 0.96


@pytest.mark.parametrize("name", TRUTHS)
def test_a_weight_counts_as_so_many_values(name):
    values = TRUTHS[name].rvs(60, random_state=5)
    weight = np.random.default_rng(0).integers(1, 4, 60)
    weighted = {fit.name: fit for fit in fit_distributions(values, weight).fits}[name]
    repeated = {fit.name: fit for fit in fit_distributions(np.repeat(values, weight)).fits}[name]
    at = np.quantile(values, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(weighted.frozen.cdf(at), repeated.frozen.cdf(at), atol=2e-3)
    # Log-likelihoods are those of the values' worth, which is less than their weights' sum.
    worth = weight.sum() ** 2 / (weight @ weight)
    assert weighted.log_likelihood / worth == pytest.approx(repeated.log_likelihood / weight.sum(), rel=1e-3)


def test_weights_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="give one above 0 each"):
        fit_distributions(np.arange(4.0), np.ones(3))
    with pytest.raises(ValueError, match="give one above 0 each"):
        fit_distributions(np.arange(4.0), np.array([1.0, 1, 0, 1]))


def test_weighted_severity_is_that_of_what_the_values_stand_for():
    groups = {"a": np.array([1.0, 9.0]), "b": np.array([5.0, 5.0])}
    plain = severity_ranking(groups, statistic=np.mean)
    assert {rank.group: rank.middle for rank in plain} == {"a": 5.0, "b": 5.0}
    weighted = severity_ranking(groups, statistic=np.mean, weights={"a": np.array([1.0, 9.0]), "b": np.ones(2)})
    assert weighted[0].group == "a"
    assert weighted[0].middle == pytest.approx(8.2, abs=0.1)


def test_a_family_that_does_not_fit_is_named_and_the_others_are_fitted(monkeypatch):
    values = TRUTHS["gamma"].rvs(100, random_state=5)
    whole = fit_distributions(values)
    fit = _fits._fit

    def but_not(failing, error):
        return lambda name, *others: (_ for _ in ()).throw(error) if name in failing else fit(name, *others)

    for error in (stats.FitError("no maximum"), ZeroDivisionError("no maximum")):
        monkeypatch.setattr(_fits, "_fit", but_not({"Weibull"}, error))
        without = fit_distributions(values)
        assert [each.name for each in without.fits] == [each.name for each in whole.fits if each.name != "Weibull"]
        assert any(re.match(r"Weibull does not fit values from .* \(no maximum\)", note) for note in without.notes)
    monkeypatch.setattr(_fits, "_fit", but_not(set(CANDIDATES), stats.FitError("no maximum")))
    assert fit_distributions(values).fits == ()
    assert len(fit_distributions(values).notes) == len(CANDIDATES)
