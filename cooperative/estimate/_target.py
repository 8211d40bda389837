"""What each draw of an audit counts for, and when an audit with a target ends.

Who stops once the spread seen so far is small enough stops when few failures happened to be drawn, or when the estimate
happened to be high: the answer is then biased, and its spread claims too little. So an audit with a target does not
look at its claim. Before a wave is drawn, each of its draws is given the share a in the estimate that it can carry,

    a = (variance allowed) / (variance of one draw),

both from what the earlier waves showed, and the audit ends once the shares add up to 1. Every draw is unbiased given
those before it and its share is fixed before it is drawn, so the errors a (T - truth) are differences of a martingale,
and the mean is unbiased however often was looked. As the shares add up to 1, the variance, the sum of a^2 (variance of
one draw), is the mean of the variances allowed: that which the target asks for. Information that is spent to a limit
fixed beforehand: Lan and DeMets (1983), Biometrika 70, 659-663, DOI 10.1093/biomet/70.3.659; weights fixed before each
stage: Cui, Hung and Wang (1999), Biometrics 55, 853-857, DOI 10.1111/j.0006-341X.1999.00853.x.
"""

from __future__ import annotations

import numpy as np

from cooperative.estimate._estimates import Estimate

PRIOR_DRAWS = 16
"""The model's own variance counts for so many draws beside those that were made."""


def place_share(drawn: int, size: int) -> np.ndarray:
    """What draws count for, in proportion, that follow `drawn` others (size,): later ones rest on a better model and on
    more known outcomes."""
    return np.sqrt(np.arange(drawn + 1.0, drawn + size + 1.0))


def target_share(needed: float, rest: float, *, drawn: int, size: int, left: int) -> np.ndarray:
    """Shares of the draws of a wave of `size` (at most size,), of a mean of which `rest` is left to give.

    needed: share of one draw by the target. drawn, left: draws before, and those that the budget still allows. What the
    target does not need before the budget ends is shared out as without one. Draws that can carry all that is left are
    the last, and share it evenly; so are the last that the budget allows.
    """
    place = place_share(drawn, left)
    share = np.maximum(rest * place[:size] / place.sum(), needed)
    enough = int(np.searchsorted(np.cumsum(share), rest)) + 1
    if enough <= size or size == left:
        share = share[:enough]
        share *= rest / share.sum()
    return share


def needed_share(target: float, found: Estimate, expected: float, beyond: float, variance: float) -> float:
    """Share of one draw of the next wave for a target of the coefficient of variation; 0 where sampling alone scatters
    more.

    found: from the waves before. expected: probability of failure by the model alone, which one heavy draw moves less.
    variance: of one draw, by the model; it is multiplied by what the draws so far scatter beyond that.
    """
    square = ((found.probability + expected) / 2) ** 2
    if not found.probability:
        return 0.0
    sampling = found.cov**2 - found.audit_variance / found.probability**2
    factor = (found.refined_runs * beyond + PRIOR_DRAWS) / (found.refined_runs + PRIOR_DRAWS)
    return max(target**2 - sampling, 0.0) * square / (variance * factor)
