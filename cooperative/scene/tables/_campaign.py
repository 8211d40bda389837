"""Tables of the two grids, of a run, of the campaign and of a sweep."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal, Self

from annotated_types import Ge
from pydantic import model_validator as validates

import kl
from cooperative.estimate import ESTIMATORS, SubsetPlan
from cooperative.scene.tables._key import (
    AboveZero,
    FromZero,
    Length,
    PerAxis,
    Seconds,
    Share,
    Table,
    Within,
    key,
    one_of,
)
from jaxmpm import GIMP, Linear, QuadraticBSpline, Scheme
from jaxmpm.support.check import Limit, above_zero, from_zero

COEFFICIENTS = {"latin hypercube": kl.latin_hypercube, "monte carlo": kl.monte_carlo, "sobol": kl.sobol}
KERNELS = {"gimp": GIMP, "linear": Linear, "quadratic b-spline": QuadraticBSpline}
SCHEMES = {scheme.name.lower(): scheme for scheme in Scheme}
FIELDS = {"none": (), "refined": ("refined",), "both": ("rough", "refined")}
MODES = {"refined": ("refined",), "both": ("rough", "refined")}


class Grid(Table):
    """The grid of the screening, on which every sample runs."""

    cell: Length = key("Edge of a cell of the background grid.", 2.0, synonyms="h dx cell_size grid_size mesh_size")
    spacing: PerAxis[Length] = key(
        "Distance of the particles along each axis, at most a cell.", [1.0, 1.0],
        synonyms="ppc particles_per_cell particle_size particles",
    )  # fmt: skip
    kernel: Annotated[type, one_of(KERNELS)] = key("Shape function of a particle.", "gimp", "gimp")
    scheme: Annotated[Scheme, one_of(SCHEMES)] = key("When the stress is updated within a step.", "musl", "musl")
    cfl: Annotated[float, Within(Limit(above=0, below=1))] = key(
        "Time step over the time in which a wave crosses a cell.", 0.9, 0.9, synonyms="dt time_step timestep"
    )
    flip: Share = key("Share of FLIP in the update of velocities; the rest is PIC.", 1.0, 1.0)
    pic_damping: Annotated[float, Within(from_zero("1/s"))] = key(
        "Rate at which velocities decay that particles have and the grid does not resolve; with `flip` = 1.", 0.3, 0.0
    )
    xpic: Annotated[int, Ge(1)] = key(
        "Order of XPIC, which filters the share of PIC: 1 is PIC, 2 keeps more of what the grid resolves in part.",
        2,
        1,
    )
    apic: bool = key("Affine transfers instead of the blend of FLIP and PIC.", False, False)
    finite_strain: bool = key(
        "Hencky strains in place of the hypoelastic rate, for elastic strains of hundredths and more, at which that "
        "rate creates or loses energy.",
        True,
        False,
    )
    damping: Annotated[float, Within(from_zero("1/s"))] = key("Damping of the velocity.", 0.0, 0.0)
    cell_average: bool | None = key(
        "Volumetric strain averaged over each cell, the cure of locking.", True, None,
        otherwise="`true`; where no soil has friction `false` if `fbar` is given, as either value",
    )  # fmt: skip
    fbar: bool | None = key(
        "F-bar instead, averages over neighbours; for soil without friction.",
        True, None, otherwise="`false`",
    )  # fmt: skip
    internal_length: Length | Literal["none"] | None = key(
        "Length over which plastic strain is averaged.", 2.0, None,
        otherwise='0.4 of `softening_length`; `"none"` where that is less than cells resolve, soil does not soften, '
        "or the ends are tied or a free field",
    )  # fmt: skip
    air: Length | None = key(
        "Height of the grid above the highest ground; a run whose soil is thrown higher breaks off.", 6.0, None,
        otherwise="a cell",
    )  # fmt: skip


class Run(Table):
    """How each sample runs."""

    gravity: Annotated[float, Within(above_zero("m/s2"))] = key("Acceleration of gravity.", 9.81, 9.81)
    k_h: Annotated[float, Within(Limit(above=-1, below=1))] = key(
        "Pseudo-static horizontal acceleration over gravity: towards the toe, or the lower end of a section without "
        "one; along x in a terrain. The initial stress holds it, as that of elastic loading.",
        0.1,
        0.0,
        synonyms="kh seismic_coefficient",
    )
    k_v: Annotated[float, Within(Limit(above=-1, below=1))] = key(
        "Pseudo-static vertical acceleration over gravity, upwards.", 0.05, 0.0, synonyms="kv"
    )
    strength_factor: AboveZero = key(
        "Factor on all strength, random or not, as strength reduction divides it: peak and residual strength, cohesion "
        "and the tangent of friction.",
        0.9,
        1.0,
    )
    t_end: Seconds = key(
        "Time at which a run ends, if it has not before.", 20.0, 20.0, synonyms="duration end_time total_time"
    )
    slides_t_end: Seconds | None = key(
        "Time up to which slides of the refined grid continue that had not come to rest at `t_end`; at least `t_end`. "
        "The class of a sample is decided at `t_end`.",
        60.0,
        None,
        otherwise="`t_end`",
    )
    failure: Literal["displacement", "limit load"] = key(
        "Criterion of failure: a given displacement, or the displacement of the slope of median soil at its limit "
        "load. The campaign then measures that displacement first and prints it with the answer.",
        "limit load",
        "displacement",
    )
    failure_displacement: Length = key(
        "Displacement from which soil counts as sliding. A sample fails when soil moves farther.",
        1.0,
        1.0,
        synonyms="threshold criterion limit",
    )
    least_volume: FromZero | None = key(
        "Volume of soil that must move farther than `failure_displacement` for a sample to fail, on either grid, so "
        "that a few grains are no failure. In a section an area (m2). 0 counts any particle.",
        5.0,
        None,
        units="m3",
        otherwise="0.05 h^2 in a section, 0.05 h^3 in 3D, no wider than the ground; h is the slope's height, or three "
        "mean thicknesses of the ground where that is less",
    )
    settle: bool = key("Whether a run ends once its slope has come to rest.", True, True)
    rest: bool | None = key("Whether a slide ends once its deposit rests.", True, None, otherwise="as `settle`")
    early: bool | None = key(
        "Whether a run of which only the class is asked for ends once the rate of its plastic strain shows it, see "
        "[settings](settings.md#early-classes).",
        False,
        None,
        otherwise="`true` where all soil has a `softening_modulus`, runs settle and nothing shakes them",
    )

    @validates(mode="after")
    def _settles(self) -> Self:
        if self.rest and not self.settle:
            raise ValueError(" rest = true with settle = false: a slide that rests has settled, leave one of them out")
        return self


class Campaign(Table):
    """How many samples, and how the failure probability is estimated."""

    samples: Annotated[int, Ge(1)] = key(
        "Number of random slopes.", 200, synonyms="n count number runs realisations realizations"
    )
    rough_samples: Annotated[int, Ge(1)] | None = key(
        "Number of samples that run on the rough grid where the scene has a coarse one, on which all run.",
        100,
        None,
        otherwise="all samples; with `[coarse]`: none, give it",
    )
    seed: Annotated[int, Ge(0)] = key("Number from which all randomness follows.", 1, 0)
    coefficients: Annotated[Callable[..., object], one_of(COEFFICIENTS)] = key(
        "How coefficients of the field are drawn.", "latin hypercube", "latin hypercube"
    )
    k_t: Annotated[int, Ge(1)] | None = key(
        'Stopping rule of `"published"`: refined runs in a row that stand.', 5, None,
        otherwise='not used; `"published"`: none, give it',
    )  # fmt: skip
    estimator: Annotated[str, one_of({name: name for name in ESTIMATORS})] = key(
        "Method of estimating the failure probability, see [estimators](report.md#estimators).",
        "two-phase",
        "two-phase",
    )
    refined_runs: Annotated[int, Ge(10)] | None = key(
        "Budget of refined runs.", 60, None, synonyms="budget",
        otherwise='a fifth of the samples, at least 20; with `target_cov`, and of `"monte carlo"`, all samples',
    )  # fmt: skip
    target_cov: Annotated[float, Within(Limit(above=0, below=1))] | None = key(
        "Coefficient of variation of the estimate at which to stop, by the scatter that the runs show. Where failures "
        'hide among low ranks the true one is up to 1.4 times it, and with `"control variate"` or `"monte carlo"` the '
        "estimate is too high by about its square, see "
        "[when it stops](report.md#what-the-controller-does-and-when-it-stops).",
        0.2,
        None,
        otherwise="none",
    )
    levels: Annotated[int, Ge(1)] | None = key(
        "Levels of subset simulation above plain sampling.", 6, None, otherwise=f"`{SubsetPlan.levels}`"
    )
    replicates: Annotated[int, Ge(2)] | None = key(
        "Independent repeats of subset simulation.", 8, None, otherwise=f"`{SubsetPlan.replicates}`"
    )
    lanes: Annotated[int, Ge(1)] | None = key(
        "Rough runs in one program.", 1, None, otherwise="`1` on CPU, `64` elsewhere"
    )
    look_ahead: Annotated[int, Ge(1)] = key("Refined runs under way at once.", 1, 1)
    screening_stop: Length | None = key(
        "Displacement at which a rough run ends, since its sample has certainly failed.",
        2.0,
        None,
        otherwise="none: rough runs continue",
    )
    calibrate: bool = key("Whether rough strength is brought down by the grids' factors of safety.", False, False)
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
    slides: Annotated[int, Ge(0)] | Literal["all"] = key(
        "Number of failures, drawn along the ranks, that slide to their end; other refined runs end at failure.",
        30,
        "all",
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
