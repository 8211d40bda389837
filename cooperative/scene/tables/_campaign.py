"""Tables of the grids and of the campaign: `[rough]`, `[refined]`, `[coarse]` and `[campaign]`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Annotated, Literal

from annotated_types import Ge
from jax import Array
from jax.typing import ArrayLike
from pydantic import BeforeValidator, Strict

import kl
from cooperative.estimate import ESTIMATORS, SETTINGS, Estimator, SubsetPlan, named_estimator
from cooperative.scene.tables._key import (
    Count,
    Flag,
    FromNone,
    Length,
    Part,
    PerAxis,
    Seconds,
    Share,
    Within,
    key,
    made,
    one_of,
    table,
)
from cooperative.scene.tables._run import CFL
from jaxmpm import GIMP, Discretisation, Linear, QuadraticBSpline, Scheme, cell_independent
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Limit, at, from_zero

COEFFICIENTS = {"latin hypercube": kl.latin_hypercube, "monte carlo": kl.monte_carlo, "sobol": kl.sobol}
KERNELS = {"gimp": GIMP, "linear": Linear, "quadratic b-spline": QuadraticBSpline}
SCHEMES = {scheme.name.lower(): scheme for scheme in Scheme}
FIELDS = {"none": (), "refined": ("refined",), "both": ("rough", "refined")}
MODES = {"refined": ("refined",), "both": ("rough", "refined")}


@table
class CampaignGrid(Part):
    """The grid of the screening, on which every sample runs."""

    cell: Length = key("Edge of a cell of the background grid.", 2.0, synonyms="h dx cell_size grid_size mesh_size")
    spacing: PerAxis[Length] = key(
        "Distance of the particles along each axis, at most a cell.", [1.0, 1.0],
        synonyms="ppc particles_per_cell particle_size particles",
    )  # fmt: skip
    kernel: Annotated[type, one_of(KERNELS, type)] = key("Shape function of a particle.", "gimp", "gimp")
    scheme: Annotated[Scheme, one_of(SCHEMES)] = key("When the stress is updated within a step.", "musl", "musl")
    cfl: CFL | None = key(
        "Time step over the time in which a wave crosses a cell, of this grid alone.", 0.9, None,
        otherwise="`cfl` of `[run]`", synonyms="dt time_step timestep",
    )  # fmt: skip
    flip: Share = key("Share of FLIP in the update of velocities; the rest is PIC.", 1.0, 1.0)
    pic_damping: Annotated[float, Within(from_zero("1/s"))] = key(
        "Rate at which velocities decay that particles have and the grid does not resolve; with `flip` = 1.", 0.3, 0.0
    )
    xpic: Count = key(
        "Order of XPIC, which filters the share of PIC: 1 is PIC, 2 keeps more of what the grid resolves in part.",
        2,
        1,
    )
    apic: Flag = key("Affine transfers instead of the blend of FLIP and PIC.", False, False)
    finite_strain: Flag = key(
        "Hencky strains in place of the hypoelastic rate, for elastic strains of hundredths and more, at which that "
        "rate creates or loses energy.",
        True,
        False,
    )
    damping: Annotated[float, Within(from_zero("1/s"))] = key("Damping of the velocity.", 0.0, 0.0)
    cell_average: Flag | None = key(
        "Volumetric strain averaged over each cell, the cure of locking.", True, None,
        otherwise="`true`; where no soil has friction `false` if `fbar` is given, as either value",
    )  # fmt: skip
    fbar: Flag | None = key(
        "F-bar instead, averages over neighbours; for soil without friction.",
        True, None, otherwise="`false`",
    )  # fmt: skip
    bridging: Flag = key(
        "Shear stress of undrained soil crosses level gaps between soils undiminished; a step takes some 14 % longer.",
        True, False,
    )  # fmt: skip
    internal_length: Length | Literal["none"] | None = key(
        "Length over which plastic strain is averaged.", 2.0, None,
        otherwise='0.4 of `softening_length`; `"none"` where that is less than cells resolve, soil does not soften, '
        "or the ends are tied or a free field",
    )  # fmt: skip
    air: Length | None = key(
        "Height of the grid above the highest ground; a run whose soil is thrown higher breaks off.", 6.0, None,
        otherwise="a cell; on terrain in a box of mostly air or rock half its height more",
    )  # fmt: skip

    def discretisation(self, cfl: float, soil: AnySoil, *, endless: bool) -> Discretisation:
        """What the solver is built with, in single precision: answers do not follow the cell unless the keys have them.

        Args:
            cfl: of the run.
            soil: of the campaign.
            endless: whether the ground has ends that are tied or free fields, over which nothing is averaged.
        """
        choices = {part.name: getattr(self, part.name) for part in fields(self)}
        values = {"cfl": cfl} | {name: value for name, value in choices.items() if value is not None}
        if self.internal_length == "none" or (endless and self.internal_length is None):
            values["internal_length"] = None
        if "fbar" in values:
            values.setdefault("cell_average", None)  # the choice of `fbar`, of either value, is one for clay
        return replace(cell_independent(Discretisation(**values, dtype="float32"), soil), **values)


def _number(slides: object) -> object:
    return None if slides == "all" else slides


@table
class Plan(Part):
    """What a campaign does: samples and their coefficients, lanes of the screening, what is stored."""

    samples: Count = key("Number of random slopes.", 200, synonyms="n count number runs realisations realizations")
    rough_samples: Count | None = key(
        "Number of samples that run on the rough grid where the scene has a coarse one, on which all run.",
        100,
        None,
        otherwise="all samples; with `[coarse]`: none, give it",
    )
    seed: FromNone = key("Number from which all randomness follows.", 1, 0)
    coefficients: Annotated[Callable[[Array, int, int], ArrayLike], one_of(COEFFICIENTS, Callable)] = key(
        "How coefficients of the field are drawn.", "latin hypercube", "latin hypercube"
    )
    lanes: Count | None = key("Rough runs in one program.", 1, None, otherwise="`1` on CPU, `64` for each GPU")
    look_ahead: Count | None = key(
        "Refined runs under way at once in one process.",
        1,
        None,
        otherwise="`1` on CPU; on a GPU as many as have 680,000 particles together, up to 64",
    )
    screening_stop: Length | None = key(
        "Displacement at which a rough run ends, since its sample has certainly failed.",
        2.0,
        None,
        otherwise="none: rough runs continue",
    )
    calibrate: Flag = key("Whether rough strength is brought down by the grids' factors of safety.", False, False)
    restart_every: Seconds = key("Time between restart points of a refined run.", 600.0, 600.0)
    fields: Annotated[tuple[str, ...], one_of(FIELDS)] = key(
        "Grids of which final displacement and plastic strain are stored, and two frames of each failure.",
        "refined",
        "refined",
    )
    modes: Annotated[tuple[str, ...], one_of(MODES)] = key(
        "Grids whose failures get a mode; only a slope with a toe has modes.", "refined", "refined"
    )
    valley: Annotated[float, Within(Limit(above=0, below=1))] = key(
        "A slide is progressive where the rate at which soil lets go falls between two peaks to this share of the "
        "lesser one.",
        0.5,
        0.5,
    )
    slides: Annotated[
        FromNone | None, BeforeValidator(_number, json_schema_input_type=FromNone | Literal["all"] | None)
    ] = key(
        "Number of failures, drawn along the ranks, that slide to their end; other refined runs end at failure. "
        "`None` in Python is all.",
        30,
        None,
        otherwise='`"all"`',
    )
    annual_frequency: Annotated[float, Within(Limit(above=0, most=366))] | None = key(
        "How often a year the scene's trigger comes, such as its water level or its earthquake: 0.01 for once in a "
        "hundred years. The summary then has annual probabilities and losses, too, of triggers that come at random.",
        0.01,
        None,
        units="per year",
        otherwise="not known: probabilities are conditional on the scene",
        synonyms="frequency annual_probability return_period",
    )


@table
class PlanAndEstimator(Plan):
    """How many samples, and how the failure probability is estimated."""

    k_t: Count | None = key(
        'Stopping rule of `"published"`: refined runs in a row that stand.', 5, None,
        otherwise='not used; `"published"`: none, give it',
    )  # fmt: skip
    estimator: Annotated[str, one_of({name: name for name in ESTIMATORS})] = key(
        "Method of estimating the failure probability, see [estimators](campaigns.md#estimators).",
        "two-phase",
        "two-phase",
    )
    refined_runs: Annotated[int, Strict(), Ge(10)] | None = key(
        "Budget of refined runs.", 60, None, synonyms="budget",
        otherwise='a fifth of the samples, at least 20; with `target_cov`, and of `"monte carlo"`, all samples',
    )  # fmt: skip
    target_cov: Annotated[float, Within(Limit(above=0, below=1))] | None = key(
        "Coefficient of variation of the estimate at which to stop. It allows for failures that may hide among low "
        "ranks, which takes 30 to 60 % more runs, see "
        "[when it stops](campaigns.md#what-the-controller-does-and-when-it-stops).",
        0.2,
        None,
        otherwise="none",
    )
    levels: Count | None = key(
        "Levels of subset simulation above plain sampling.", 6, None, otherwise=f"`{SubsetPlan.levels}`"
    )
    replicates: Annotated[int, Strict(), Ge(2)] | None = key(
        "Independent repeats of subset simulation.", 8, None, otherwise=f"`{SubsetPlan.replicates}`"
    )

    @property
    def plan(self) -> Plan:
        """What the campaign does, without its estimator."""
        return made(Plan, self)

    @property
    def chosen(self) -> Estimator:
        """The estimator, with its settings."""
        with at("campaign"):
            return named_estimator(self.estimator, {name: getattr(self, name) for name in (*SETTINGS, "seed")})
