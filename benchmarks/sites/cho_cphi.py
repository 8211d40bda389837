"""Cho's slope with cohesion and friction: the class of each sample on the refined grid, beside slip circles on it.

`python -m benchmarks.sites.cho_cphi` writes `benchmarks/data/cho_cphi.csv` and goes on where it was stopped: of each
sample the displacement that the least volume has exceeded when its run ends, whether it sped up on its way, and the
factor of safety of Bishop's simplified method on circles through the same cohesion and friction. The head has the limit
load. Source: Bishop (1955), 10.1680/geot.1955.5.1.7."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.csv_rows import Row, appending, head, read_rows, size, whole, word
from benchmarks.measure import ROOT, scene_campaign
from cooperative import runs
from cooperative.estimate import wilson_interval
from cooperative.scene import measure_limit_load
from jaxmpm import Exceeds, Settle, Slope, diagnostics, solve_each
from jaxmpm.run import Hooks, Midway

PATH = ROOT / "benchmarks" / "data" / "cho_cphi.csv"
COLUMNS = {"number": whole, "displacement": size, "speeds_up": word("True", "False"), "circles": size}
SAMPLES = 240
BEYOND = 2.0
"""Largest displacement (m) at which a run ends: far beyond the limit."""
SLICES = 50


@dataclass(frozen=True)
class Circles:
    """Slip circles through a slope. nearest: particle (C, S) at the middle of each slice's base. weight: of the slices
    (C, S) N. sine, cosine: of their base's dip (C, S). width: of the slices (C, 1) m."""

    nearest: np.ndarray
    weight: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    width: np.ndarray

    @classmethod
    def through(cls, slope: Slope, position: np.ndarray, spacing: float, unit_weight: float) -> Circles:
        """Through the crest, 0.5 m apart, and out of the face or the ground before it, as flat as 0.08 and as deep as
        0.5 of the chord. position: of the particles (2, N) m, on a lattice of this spacing."""
        toe = slope.crest + slope.height * slope.run_per_rise
        line = ([0, slope.crest, toe, toe + slope.toe], [slope.foundation + slope.height] * 2 + [slope.foundation] * 2)
        column, row = (np.floor(position / spacing)).astype(int)
        result: list[tuple[np.ndarray, ...]] = []
        outs = np.r_[np.arange(slope.crest + 4, toe), np.arange(toe, toe + slope.toe - 1, 0.75)]
        for left, right, sag in ((a, b, s) for a in np.arange(0.5, slope.crest + 3, 0.5) for b in outs
                                 for s in np.linspace(0.08, 0.5, 15)):  # fmt: skip
            (high, low), edges = np.interp([left, right], *line), np.linspace(left, right, SLICES + 1)
            chord, x = np.hypot(right - left, high - low), (edges[1:] + edges[:-1]) / 2
            radius = chord * (1 + 4 * sag**2) / (8 * sag)
            across = np.array([high - low, right - left]) / chord
            centre = np.array([(left + right) / 2, (high + low) / 2]) + across * (radius - sag * chord)
            base = centre[1] - np.sqrt(np.maximum(radius**2 - (x - centre[0]) ** 2, 1e-9))
            thick, sine, cosine = np.interp(x, *line) - base, (centre[0] - x) / radius, (centre[1] - base) / radius
            if centre[1] - radius < 0 or thick.min() < -1e-3 or cosine.min() < 0.2 or thick @ sine <= 0:
                continue
            at = np.floor(np.stack([x, base]) / spacing).astype(int)
            apart = np.abs(column - at[0][:, None]) * 1000 + np.abs(row - at[1][:, None])
            width = np.array([edges[1] - edges[0]])
            result.append((apart.argmin(axis=1), unit_weight * np.maximum(thick, 0) * width, sine, cosine, width))
        return cls(*(np.array(column) for column in zip(*result, strict=True)))

    def factor_of_safety(self, soil: Mapping[str, Any]) -> float:
        """The least of all circles, of cohesion (Pa) and friction (degrees) at the particles (N,)."""
        cohesion, friction = (np.asarray(soil[name], float) for name in ("cohesion", "friction"))
        resists = cohesion[self.nearest], np.tan(np.deg2rad(friction))[self.nearest]
        drives, factor = (self.weight * self.sine).sum(axis=1), np.full(len(self.width), 1.2)
        for _ in range(12):
            turned = self.cosine + self.sine * resists[1] / factor[:, None]
            factor = ((resists[0] * self.width + self.weight * resists[1]) / turned).sum(axis=1) / drives
        return float(factor.min())


def rows() -> dict[tuple[Any, ...], Row]:
    """The stored rows."""
    return read_rows(PATH, COLUMNS, ("number",), comments=2)


def summarised() -> dict[str, Any]:
    """Shares that fail, with their intervals, on the refined grid and by circles, and how often both agree."""
    stored, at = rows().values(), head(PATH)
    distance, circles = (np.array([row[name] for row in stored]) for name in ("displacement", "circles"))
    fails, sped = distance > at["displacement"], np.array([row["speeds_up"] == "True" for row in stored])
    low, high = wilson_interval(int(fails.sum()), len(stored))
    return {
        "pf": float(fails.mean()),
        "low": low,
        "high": high,
        "fos": at["factor"],
        "runs": len(stored),
        "circles_pf": float((circles < 1).mean()),
        "circles_same_class": float((fails == (circles < 1)).mean()),
        "circles_rank_correlation": float(stats.spearmanr(distance, -circles).statistic),
        "in_time_same_class": float((fails == sped).mean()),
    }


def main() -> None:
    """Run what is missing, one sample after the other."""
    campaign = scene_campaign("cho_cphi")
    model = runs.build(campaign, "refined", soil := runs.random_soil(campaign))
    if not PATH.exists():
        limit = json.dumps(asdict(measure_limit_load(campaign, model)))
        PATH.write_text(f"# {limit}\n# displacement in m\n{','.join(COLUMNS)}\n")
    coefficients, done = runs.coefficients_of(campaign, soil), {number for (number,) in rows()}
    slope: Any = campaign.site.shape
    circles = Circles.through(
        slope, np.asarray(model.scene.particles.position, float), 2 * model.half_size[0], campaign.soil.unit_weight
    )
    with appending(PATH, COLUMNS) as put:
        for number in sorted(set(range(SAMPLES)) - done):
            distance, sped = _run(model, model.varied(coefficients[number]), head(PATH)["volume"])
            factor = circles.factor_of_safety(model.parameters(coefficients[number]))
            put((number, f"{distance:.5g}", sped, f"{factor:.4f}"))


def speeds_up(displacements: np.ndarray, first: int) -> np.ndarray:
    """Whether the displacement of lanes grew more in some period than in all the time before, of the same length.

    A lane that stands, creeps at a constant speed or comes to rest has not; a body that slides off covers three times
    as much. Displacements count by their largest value so far, so elastic oscillation has no effect.

    Args:
        displacements: (looks, B) m.
        first: least number of looks in such a period.

    Returns:
        (B,) bool.
    """
    farthest = np.maximum.accumulate(displacements, axis=0)
    halves = np.arange(max(first, 1), len(farthest) // 2 + 1)
    return np.any(farthest[2 * halves - 1] > 2 * farthest[halves - 1], axis=0)


def _run(model: runs.GridModel, varied: Mapping[str, Any], least: float) -> tuple[float, bool]:
    """Displacement (m) that the least volume has exceeded at the end, and whether it sped up between looks."""
    seen = []

    def record_displacement(_: int, seconds: float, midway: Midway) -> None:
        seen.append(float(diagnostics.exceeded_displacement(model.scene, midway.state, least)))

    values = {name: [value] for name, value in varied.items()}
    for _ in solve_each(
        model.scene, model.state, values, width=1, t_end=model.campaign.run.t_end, rules=[Settle(), Exceeds(BEYOND)],
        hooks=Hooks(observe=record_displacement),
    ):  # fmt: skip
        pass
    return seen[-1], bool(speeds_up(np.array(seen)[:, None], 2)[0])


if __name__ == "__main__":
    main()
