"""What the report is about: a campaign's rows and summary, read once from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cooperative import runs
from cooperative.estimate import Phases
from cooperative.hazard import Maps
from cooperative.scene import Campaign
from cooperative.store import Rows, Store
from cooperative.summary import Summary, slides_of


@dataclass(frozen=True)
class Told:
    """A campaign read once: its rows, and its summary as `summary.json` has it. left_out: what is there and does not
    count, and why. maps: of hazard, None where the scene asks for none or nothing slid."""

    store: Store
    campaign: Campaign
    rough: Rows
    refined: Rows
    summary: Summary
    left_out: tuple[str, ...] = ()
    maps: Maps | None = None

    @cached_property
    def phases(self) -> Phases:
        """What the rows tell the campaign's estimator."""
        return runs.phases_of(self.campaign, self.rough, self.refined)

    @property
    def labels(self) -> dict[str, str]:
        """Axis label of each consequence, with its unit. In a section the influence area is the run-out, and is told
        once."""
        solid = self.campaign.dimension == 3
        return {
            "displacement": "largest displacement $R_d$ [m]",
            "depth": "sliding depth $H$ [m]",
            "runout": "run-out $L$ [m]",
            "volume": f"sliding volume $V$ [{'m$^3$' if solid else 'm$^3$/m'}]",
        } | ({"area": "influence area $S$ [m$^2$]"} if solid else {})

    @property
    def units(self) -> dict[str, str]:
        """Unit of each consequence in words."""
        each = "" if self.campaign.dimension == 3 else " per metre of width"
        toe = self.campaign.site.shape.face is not None
        drawn = "" if self.campaign.site.track is None else ", along the line that the scene draws"
        return {
            "displacement": "m",
            "depth": "m below the crest" if toe else "m below the surface",
            "runout": "m beyond the toe" if toe else f"m from its rear to its front{drawn}",
            "volume": f"m³{each}",
            "area": "m² beyond the toe" if toe else "m² at its end",
        }

    @property
    def failed(self) -> np.ndarray:
        """Refined runs that failed and have consequences: they slid to their end (runs,) bool."""
        slid = slides_of(self.campaign, self.phases, self.refined).slid
        return slid & ~self.refined.columns.get("broke_off", np.zeros(slid.size)).astype(bool)
