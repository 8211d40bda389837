"""All tables of a scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

from annotated_types import MaxLen
from pydantic import Field
from pydantic import model_validator as validates
from pydantic.config import JsonDict

from cooperative.scene.tables._campaign import CampaignGrid, PlanAndEstimator
from cooperative.scene.tables._ground import GroundTable, SlopeTable, TerrainTable, Water
from cooperative.scene.tables._hazard import Exposed, Hazard
from cooperative.scene.tables._key import MOST_TABLES, Name, OrTable, Part, table
from cooperative.scene.tables._motion import Motion
from cooperative.scene.tables._run import Run
from cooperative.scene.tables._seepage import Drawdown, Rain
from cooperative.scene.tables._soil import LayerTable, SoilTable, with_soil
from cooperative.scene.tables._stored import Calibration, GivenEstimator, LimitLoad
from cooperative.scene.tables._sweep import Scenario, Sweep
from cooperative.scene.tables._varying import CrossCorrelation, RandomField
from jaxmpm.laws import MuI
from jaxmpm.support.check import Invalid, at

SITES = ("slope", "ground", "terrain")
"""Tables of which a scene has one: it describes the ground."""


@table
class SceneTable(Part):
    """A scene of jaxmpm."""

    SCHEMA: ClassVar[JsonDict] = {"oneOf": [{"required": [site]} for site in SITES]}

    name: Name = Field("campaign", description="Title of the campaign.")
    slope: SlopeTable | None = None
    ground: GroundTable | None = None
    terrain: TerrainTable | None = None
    layer: Annotated[list[LayerTable], MaxLen(MOST_TABLES)] = Field(default_factory=list)
    water: Water | None = None
    rain: Rain | None = None
    drawdown: Drawdown | None = None
    soil: SoilTable | None = None
    strength: RandomField | None = None
    cross_correlation: CrossCorrelation | None = None
    rough: CampaignGrid = Field(kw_only=True)
    refined: CampaignGrid = Field(
        kw_only=True, description="The grid of the audit, on which ranked samples run. Keys as in `[rough]`."
    )
    coarse: OrTable[Literal["slices"], CampaignGrid] | None = Field(
        None,
        description="A grid coarser than the rough one, on which all samples run first. By their displacement there, "
        "the campaign draws the `rough_samples` that run on the rough grid. Keys as in `[rough]`. Or a line "
        '`coarse = "slices"` before all tables: the factor of safety by slices ranks the samples of a section instead.',
    )
    run: Run = Field(default_factory=Run)
    motion: Motion | None = None
    campaign: PlanAndEstimator = Field(kw_only=True)
    hazard: Hazard | None = None
    exposed: Annotated[list[Exposed], MaxLen(MOST_TABLES)] | None = None
    sweep: Sweep | None = Field(None, json_schema_extra={"minProperties": 1})
    scenario: Annotated[list[Scenario], MaxLen(MOST_TABLES)] | None = None
    calibration: Calibration | None = None
    estimator: GivenEstimator | None = None
    limit_load: LimitLoad | None = None
    files: dict[str, object] = Field(
        default_factory=dict,
        description="What the files hold that the scene names.",
        json_schema_extra={"additionalProperties": True},  # versions of pydantic differ in whether they write that
    )

    @validates(mode="before")
    @classmethod
    def _layers_with_soil(cls, values: object) -> object:
        if not isinstance(values, dict) or not isinstance(layers := values.get("layer"), list):
            return values
        for number, layer in enumerate(layers := list(layers)):
            with at("layer", number):
                layers[number] = with_soil(layer, values) if isinstance(layer, dict) else layer
        return values | {"layer": layers}

    @validates(mode="after")
    def _idle_keys(self) -> Self:
        """Keys have an effect."""
        if self.soil is None:
            if self.strength is not None or not self.layer:
                raise Invalid((), None, "lacks [soil]", "add it, or give each [[layer]] all of its own soil")
            return self
        if self.strength is not None and self.soil.strength is not None:
            raise Invalid((), None, "has both [strength] and [soil] strength", "leave one of them out")
        opens = any(soil.tension_cutoff is not None or soil.law is MuI for soil in (self.soil, *self.layer))
        if self.soil.gap_memory is not None and not opens:
            raise Invalid(
                ("soil", "gap_memory"), None, "has no effect in soil without tension_cutoff, which opens no gap",
                "leave it out, or give tension_cutoff",
            )  # fmt: skip
        return self

    @property
    def whole_soil(self) -> SoilTable | None:
        """That of `[soil]`, with the strength of `[strength]`."""
        return self.soil if self.soil is None or self.strength is None else replace(self.soil, strength=self.strength)

    @property
    def unusual(self) -> bool:
        """Whether `[soil]` has unusual numbers on purpose."""
        return self.soil is not None and self.soil.unusual

    @validates(mode="after")
    def _one_ground(self) -> Self:
        """A scene has one ground, and tables that this ground has."""
        sites = [name for name in SITES if getattr(self, name) is not None]
        if len(sites) != 1:
            has = f"has both {' and '.join(f'[{name}]' for name in sites)}" if sites else "has no ground"
            raise Invalid((), None, has, f"give one of {', '.join(f'[{name}]' for name in SITES)}")
        for number, layer in enumerate(self.layer):
            if isinstance(layer.top, tuple) and self.ground is None:
                rule = "is a line, which is for a scene with [ground]"
                raise Invalid(("layer", number, "top"), None, rule, "give its elevation (m)")
        other = "table" if self.ground is None else "raster"
        if self.water is not None and getattr(self.water, other) is not None:
            remedy = "give level, depth, r_u or " + {"table": "raster", "raster": "table"}[other]
            raise Invalid(("water", other), None, f"is not for a scene with [{sites[0]}]", remedy)
        for name in ("layer", "water"):
            if getattr(self, name) and self.slope is not None:
                raise Invalid(
                    (), None, f"has [{name}], which is for a scene with [ground], not with [slope]",
                    "draw the slope as a surface",
                )  # fmt: skip
        return self
