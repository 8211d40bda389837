"""What a reader of a scene should know before it runs; how far a slide may run beyond the toe, by its energy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cooperative.scene import Campaign, remarks
from jaxmpm.soil import AnisotropicSoil, AnySoil, CamClaySoil, FrictionalSoil, GranularSoil, Soil

POINTS = 2000
"""Of the surface behind the toe, and of the lengths of a deposit that are tried."""

LONGEST = 1e3
"""Longest deposit that is tried, over the ground behind the toe."""


@dataclass(frozen=True)
class Reach:
    """Ground beyond the toe.

    Args:
        slide: how far a slide may run there (m).
        ground: how much of it there is (m).
    """

    slide: float
    ground: float

    @property
    def short(self) -> bool:
        """Whether a slide may reach the end of the ground."""
        return self.slide > self.ground


def warnings_of(campaign: Campaign) -> Iterator[str]:
    """What is allowed in a campaign and limits its answer, known before anything is run.

    Args:
        campaign: the campaign.

    Yields:
        Sentences.
    """
    yield from remarks(campaign)
    for layer, thickness in zip(campaign.site.layers, campaign.site.thicknesses, strict=True):
        few = [grid for grid, numerics in campaign.grids.items() if thickness.too_thin(numerics.cell)]
        if few:
            yield (
                f"{layer.label}, {thickness.metres:.3g} m thick, is weak and thin for the cells of the "
                f"{' and the '.join(few)} grid: it is too strong there"
            )
    reach = reach_of(campaign)
    if reach is not None and reach.short:
        yield (
            f"a slide may reach the end of the ground, {reach.ground:g} m beyond the toe: make that {reach.slide:.0f} "
            "m, or look in the summary for walls that slides reach"
        )


def reach_of(campaign: Campaign) -> Reach | None:
    """Run-out of all soil above the toe, by energy; None for ground without a toe or without strength.

    All soil behind the toe and above its level slides out, and ends with the profile of soil at yield on a level base,
    h = h_0 sqrt(1 - x / L). The potential energy that it loses is the work of its residual strength at its base along
    the way of its centre: cohesion on the mean of both lengths, friction on the weight. Within the slide none is lost,
    so that slides end earlier. Of several layers and an interface the weakest counts. A water table is left out.

    Sources: Heim (1932), Bergsturz und Menschenleben (energy line of the centre); Liu and Mei (1989),
    doi:10.1017/S0022112089002685 (profile).

    Args:
        campaign: the campaign.
    """
    shape, site = campaign.site.shape, campaign.site
    if shape.face is None:
        return None
    face, (low, high) = shape.face, (shape.corner[0], shape.corner[0] + shape.extent[0])
    rear, end = (low, high) if face.downhill == 1 else (high, low)
    behind, ground = abs(face.toe_x - rear), abs(face.toe_x - end)
    x = (np.arange(POINTS) + 0.5) * behind / POINTS
    plan = [
        rear + face.downhill * x,
        *([np.full_like(x, shape.corner[1] + shape.extent[1] / 2)] * (campaign.dimension - 2)),
    ]
    height = np.maximum(shape.heights(*plan) - face.toe_z, 0.0)
    drained, factor = 1 - (site.r_u or 0.0), campaign.run.strength_factor
    soils = [layer.soil for layer in site.soils(campaign.soil)]
    ways = []
    for soil, by_stress in zip(soils, site.by_stress(campaign.soil) or [None] * len(soils), strict=True):
        stress = drained * soil.unit_weight * face.height / 2
        peak = None if by_stress is None else max(by_stress.ratio * stress, by_stress.minimum)
        cohesion, friction = _residual(soil, peak)
        if cohesion or friction:
            ways.append(run_out(height, behind, factor * cohesion / soil.unit_weight, factor * friction * drained))
    contact = getattr(shape, "interface", None)
    if contact is not None:
        residual = factor * contact.residual_ratio
        friction = residual * math.tan(math.radians(contact.friction)) * drained
        ways += [run_out(height, behind, residual * contact.cohesion / soil.unit_weight, friction) for soil in soils]
    return Reach(max(ways), ground) if ways else None


def run_out(height: np.ndarray, behind: float, cohesion: float, friction: float) -> float:
    """Run-out (m) beyond the toe of soil that loses energy at its base alone.

    Args:
        height: above the toe at the middles of equal parts of the ground behind it (n,) m.
        behind: length of that ground (m).
        cohesion: at the base, over the unit weight of the soil (m).
        friction: coefficient at the base.
    """
    x = (np.arange(height.size) + 0.5) * behind / height.size
    area = float(height.mean()) * behind
    if area == 0:
        return 0.0
    centre, energy = float((height * x).mean()) * behind / area, float((height**2).mean()) * behind / 2
    length = behind * np.geomspace(1.0, LONGEST, POINTS)
    rest = energy - 9 / 16 * area**2 / length
    lost = (cohesion * (behind + length) / 2 + friction * area) * (0.4 * length - centre)
    enough = np.flatnonzero(rest >= lost)
    return float(length[enough[-1]]) - behind if enough.size else 0.0


def _residual(soil: AnySoil, peak: float | None) -> tuple[float, float]:
    """Cohesion (Pa) and friction coefficient on the base of a slide that softening leaves, 0 of elastic soil.

    Cam Clay and grains have those of simple shear, at the critical state and at rest, strength by direction has that of
    simple shear.

    Args:
        soil: whose strength it is.
        peak: undrained strength (Pa), None for the soil's own.
    """
    if isinstance(soil, CamClaySoil):
        return 0.0, float(np.mean(soil.critical_state)) / math.sqrt(3)
    if isinstance(soil, GranularSoil):
        return 0.0, math.tan(math.radians(float(np.mean(soil.static_friction))))
    if isinstance(soil, AnisotropicSoil):
        return float(np.mean(soil.simple_strength)), 0.0
    if isinstance(soil, FrictionalSoil):
        friction = soil.residual_friction if soil.softens else soil.friction
        return soil.residual_cohesion if soil.softens else soil.cohesion, math.tan(math.radians(friction))
    if not isinstance(soil, Soil) or soil.strength is None:
        return 0.0, 0.0
    peak = float(np.mean(soil.strength)) if peak is None else peak
    return peak * (soil.residual_ratio if soil.softens else 1.0), 0.0
