# %% [markdown]
# # 09 A campaign with a law of your own
#
# [07](07_your_own_material_and_scene.ipynb) writes a law and lets one body of it slump. Here a law of your own goes
# through a whole campaign ([04](04_campaign.ipynb)): random samples, a rough and a refined grid, two worker processes,
# an estimate with its interval, and the report. One cell of 35 lines does it, without a file beside the notebook.
#
# A campaign asks three things of a soil of your own.
#
# - **A law**, a frozen dataclass made a pytree, derived from `mpm.laws.Law`: `update` gives the new stress and the new
#   history from the increment of strain; `initial_history` gives the history of undisturbed soil. `PARAMETERS`
#   declares the law's numbers (`mpm.laws.Parameter`): which values they may have, and that strength reduction divides
#   the strength.
# - **A soil**, a frozen dataclass that meets `mpm.soil.AnySoil`: it has a `unit_weight`, and `material` makes the law,
#   in the precision of the grid and for shear bands `band` metres thick. What is random is a field of the soil under
#   the same name; its mean comes from `RandomField`.
# - **Nothing that cannot be sent or written down.** Workers get the classes of the cell with the campaign, by
#   cloudpickle. The folder keeps numbers, and of your classes their names and a checksum of their file.
#
# The law is Tresca's: the shear stress $\tau = \sqrt{J_2}$ of clay that is sheared without drainage is at most
#
# $$s(\gamma) = S_u\,\left[0.5 + 0.5\,e^{-3\gamma/\gamma_{95}}\right],$$
#
# with $\gamma$ the plastic shear strain. Clay that flows keeps half of its strength, and at $\gamma_{95}$ 95 per
# cent of the loss is done. $S_u$ is random and grows with depth. A shear band is about a cell thick, so on a finer
# grid the same slip is a larger strain: $\gamma_{95}$ is 0.4 in a band half a metre thick, and goes with 1 / `band`.

# %%
import os
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import jax.numpy as jnp
from IPython.display import Image, display
from jax import Array

import jaxmpm as mpm
from cooperative import Campaign, CampaignGrid, Plan, RandomField, TwoPhase, report, run
from jaxmpm.laws import add, elastic_increment
from jaxmpm.tensors import deviator, mean, safe_sqrt, second_invariant

SMALL = os.environ.get("JAXMPM_SMALL") == "1"  # small sizes, for a quick look and for the tests
samples, cell = 12 if SMALL else 40, 0.5
scratch = TemporaryDirectory()
os.chdir(scratch.name)
folder = Path("own")


# %%
@mpm.pytree
@dataclass(frozen=True)
class Tresca(mpm.laws.Law):
    bulk: Array
    shear: Array
    strength: Array
    strain_95: Array
    PARAMETERS = {"strength": mpm.laws.Parameter(above=0, unit="Pa", reduced=True)}  # noqa: RUF012

    def initial_history(self, particles):
        return jnp.zeros_like(particles.mass)

    def update(self, strain_increment, stress, plastic_strain, dt=None):
        trial = add(stress, elastic_increment(self.bulk, self.shear, strain_increment))
        shear_stress, pressure = safe_sqrt(second_invariant(deviator(trial))), mean(trial)
        strength = self.strength * (0.5 + 0.5 * jnp.exp(-3 * plastic_strain / self.strain_95))
        scale = jnp.minimum(strength / jnp.where(shear_stress > 0, shear_stress, strength), 1)
        stress = tuple(scale * s + pressure * (axis < 3) for axis, s in enumerate(deviator(trial)))
        return stress, plastic_strain + (1 - scale) * shear_stress / self.shear


@dataclass(frozen=True)
class SensitiveClay:
    strength: float | None = None  # the mean of what varies
    unit_weight: float = 18e3

    def material(self, dtype, band):
        return Tresca(*(jnp.asarray(each, dtype) for each in (2e7, 1e7, self.strength, 0.4 * 0.5 / band)))


campaign = Campaign(
    ground=mpm.Slope(crest=20.0, height=6.0, run_per_rise=1.5, toe=26.0, foundation=2.0),
    soil=SensitiveClay(),
    random={"strength": RandomField(mean=18e3, cov=0.3, length=(20.0, 2.0), trend=1.5e3)},
    rough=CampaignGrid(2 * cell, (cell, cell), fbar=True),
    refined=CampaignGrid(cell, (cell / 2, cell / 2), fbar=True),
    plan=Plan(samples=samples, seed=3),
    estimator=TwoPhase(refined_runs=12),
)
summary = run(campaign, folder, workers=2)
print(report(folder))
display(Image(folder / "figures" / "ranked.png"))

# %% [markdown]
# The words are the summary of the report; `report.html` in the folder has all figures and tables. The figure shows the
# samples in the order of their rough displacement. Twelve refined runs leave a wide interval: a campaign whose number
# counts gets more of them (`refined_runs`), and goes on in the same folder.
#
# ## Going on, and with another law
#
# A folder goes on with the same campaign only. Here everything has run, so the same call reads the answer. Run the cell
# above again, or in a kernel started anew, and it does the same: a class counts by its source. With another law, other
# numbers or another soil, the folder is refused.

# %%
again = run(campaign, folder, workers=2)
try:
    run(replace(campaign, soil=SensitiveClay(unit_weight=20e3)), folder)
except ValueError as error:
    print(error)

# %% [markdown]
# ## What to remember
#
# - `Campaign` is a value: write it in a cell or a script, and change parts of it by `dataclasses.replace`.
# - In a script, put `run(..., workers=2)` below `if __name__ == "__main__":`, as for all worker processes of Python.
# - A law that softens steeply should declare `steepest_softening`, so that soil that would snap back is refused.
# - Numbers that vary are fields of the soil. Here that is the strength; `strain_95` could be another.

# %%
low, high = summary.probability.interval
results = {
    "probability": summary.probability.value,
    "interval_holds": int(low <= summary.probability.value <= high),
    "refined_runs": summary.cost.refined_runs,
    "same_again": int(again == summary),
}
print(results)
