"""How far chains of subset simulation leave a probability open.

A replicate of subset simulation has few chains in each level, and their samples resemble one another. The scatter of
its replicates shows all of that, but it is seen in a handful of numbers of which most are small and one is large: where
the large one is missing the estimate and its scatter are too small together. The chains themselves show more, since
every level of every replicate has several. A level's estimate varies by the scatter of the means of its chains (Au and
Beck 2001, Probabilistic Engineering Mechanics 16, 263-277, DOI 10.1016/S0266-8920(01)00019-4, Section 6, who write it
by autocorrelations), and levels multiply:

    1 + v = product over levels of (1 + variance of the level's mean over its square).

A chain that starts far up is worth more than one that starts at the threshold, so levels depend on each other. What a
seed is worth is therefore not a mean over seeds but a straight line in the order of their responses, fitted to the
means of the chains of all replicates; the scatter of a chain's mean is that about the line, and the line's own slope
counts in the level that the seeds come from. What dependence is left is in the scatter of the replicates, and the
larger of the two counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Chains:
    """Which samples the chains of each replicate and level visit.

    Args:
        visits: positions of samples (replicates, levels + 1, per level). The first level has independent samples; in
            the others all chains take a step together, from their seeds on.
        seeds: of a level's visits those from which the chains of the next one start, by falling response (replicates,
            levels, chains).
    """

    visits: np.ndarray
    seeds: np.ndarray

    def moved(self, to: np.ndarray) -> Chains:
        """The same of samples that stand in another order; `to` is the new position of each (N,)."""
        return Chains(to[self.visits], self.seeds)

    def relative_variance(self, value: np.ndarray) -> float:
        """Variance over the square of the mean that the levels give, of all replicates together.

        Args:
            value: what is averaged, of each sample (N,), 0 or more and not 0 throughout.
        """
        replicates, levels, chains = self.seeds.shape
        order, whole = np.linspace(-1.0, 1.0, chains), 1.0
        worth = np.zeros(chains)
        for level in range(levels, -1, -1):
            visited = value[self.visits[:, level]]
            if level < levels:
                np.put_along_axis(visited, self.seeds[:, level], np.broadcast_to(worth, (replicates, chains)), axis=1)
            # The first level has no chains: each of its samples is one.
            means = visited if level == 0 else visited.reshape(replicates, -1, chains).mean(axis=1)
            mean, line = float(means.mean()), np.zeros(means.shape[1])
            if level:
                line = float(means.mean(axis=0) @ order) / float(order @ order) * order
                worth = np.maximum(mean + line, 0.0)
            freedom = means.size - 1 - (level > 0)
            whole *= 1 + float(((means - mean - line) ** 2).sum()) / freedom / means.shape[1] / mean**2
        return (whole - 1) / replicates
