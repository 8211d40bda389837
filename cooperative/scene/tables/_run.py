"""How each sample of a campaign runs, `[run]`: its loads, and when it ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import InstanceOf
from pydantic import model_validator as validates
from pydantic.json_schema import SkipJsonSchema

from cooperative.scene.tables._key import (
    AboveZero,
    Flag,
    FromScript,
    FromZero,
    Length,
    Part,
    Seconds,
    Within,
    key,
    table,
)
from cooperative.scene.tables._stored import LimitLoad
from jaxmpm import Exceeds, Settle
from jaxmpm.run import Early, Rule
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support.check import Invalid, Limit, above_zero

CFL = Annotated[float, Within(Limit(above=0, below=1))]


@table
class Run(Part):
    """How each sample runs."""

    gravity: Annotated[float, Within(above_zero("m/s2"))] = key("Acceleration of gravity.", 9.81, STANDARD_GRAVITY)
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
    cfl: CFL = key(
        "Time step over the time in which a wave crosses a cell.", 0.9, 0.9, synonyms="dt time_step timestep"
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
    runout_thickness: FromZero | None = key(
        "Thickness of the deposit at the front of the run-out, the mean over the width of two particles. Soil runs on "
        "ahead of it as a film as thin as a particle, which a survey does not see. 0 takes the foremost soil.",
        0.5,
        None,
        units="m",
        otherwise="a tenth of the slope's height, or of three mean thicknesses of the ground where that is less",
        synonyms="front_thickness deposit_thickness",
    )
    settle: Flag | SkipJsonSchema[InstanceOf[Rule] | InstanceOf[FromScript]] = key(
        "Whether a run ends once its slope has come to rest. Python may give a `jaxmpm.Settle`, or another rule, taken "
        "as it is.",
        True,
        True,
    )
    rest: Flag | None = key("Whether a slide ends once its deposit rests.", True, None, otherwise="as `settle`")
    early: Flag | None = key(
        "Whether a run of which only the class is asked for ends once the rate of its plastic strain shows it, see "
        "[settings](settings.md#early-classes).",
        False,
        None,
        otherwise="`true` where all soil has a `softening_modulus`, runs settle and nothing shakes them",
    )

    @validates(mode="after")
    def _consistent(self) -> Self:
        if isinstance(self.settle, type):
            name = self.settle.__name__
            raise Invalid(("settle",), name, "is a class", f"give a rule of it, {name}(...)")
        if self.rest and not self.settle:
            raise Invalid(
                ("rest",), "true", "with settle = false", "a slide that rests has settled, leave one of them out"
            )
        if self.slides_t_end is not None and self.slides_t_end < self.t_end:
            raise Invalid(
                ("slides_t_end",), f"{self.slides_t_end:g} s",
                f"is before t_end = {self.t_end:g} s, up to which all runs go", "give at least that, or leave it out",
                beside=("t_end",),
            )  # fmt: skip
        return self

    def settling(self, volume: float | None = None) -> Rule | None:
        """When a lane has settled; a slide, which exceeds the failure displacement, once its deposit rests.

        Args:
            volume: of soil whose motion counts (m3, in a section m2), None for that of any particle.
        """
        if isinstance(self.settle, Rule):
            return self.settle
        slides = None if self.rest is False else self.failure_displacement
        return Settle(slides=slides, least_volume=volume) if self.settle else None

    def last(self, grid: str) -> float:
        """Time (s) at which a run of a grid ends at the latest."""
        return self.slides_t_end if grid == "refined" and self.slides_t_end is not None else self.t_end

    def rules(
        self, limit: float | None = None, volume: float | None = None, *, softens: bool = False, shaken: bool = False
    ) -> tuple[Rule, ...]:
        """What ends a run before its end time; of several the first that holds.

        A rule states by its status what its end means, see `jaxmpm.run.Rule`: what has SETTLED is measured as it lies;
        what is DECIDED fails or stands by the displacement that the rule foresees.

        Args:
            limit: displacement (m) that decides its class, None where more than the class is asked for.
            volume: of soil whose motion counts (m3, in a section m2), None for that of any particle.
            softens: whether all soil does, linearly.
            shaken: whether the base moves.
        """
        rules: list[Rule] = [] if (settling := self.settling(volume)) is None else [settling]
        if limit is not None:
            early = self.early is not False and self._never_early(softens, shaken) is None
            rules.append(Early(self.t_end, limit, least_volume=volume) if early else Exceeds(limit, volume))
        return tuple(rules)

    def check_early(self, *, softens: bool, shaken: bool) -> None:
        """Raise ValueError for `early` where its rule does not hold.

        Args:
            softens: whether all soil does, linearly.
            shaken: whether the base moves.
        """
        if self.early and (why := self._never_early(softens, shaken)):
            raise Invalid(
                ("early",), "true", f"while {why}",
                "its rule holds for slopes that settle unshaken, of soil with softening_modulus, leave it out",
            )  # fmt: skip

    def _never_early(self, softens: bool, shaken: bool) -> str | None:
        """Why `early` does not hold, None where it does."""
        if not self.settle:
            return "settle is off"
        return "the base moves" if shaken else None if softens else "not all soil softens linearly"

    def failing_at(self, limit_load: LimitLoad) -> Run:
        """The run of samples that fail from the displacement of a limit load.

        Args:
            limit_load: as measured.
        """
        return replace(self, failure_displacement=limit_load.displacement, least_volume=limit_load.volume or 0.0)
