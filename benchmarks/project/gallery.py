"""`python -m benchmarks.project.gallery`: draw every scene of benchmarks/scenes, measure its cost and write
docs/gallery.md.

A cost is that of `python -m cooperative check`, of all campaigns of a sweep together. Results are written here once the
campaign has been run.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from benchmarks.measure import ROOT
from cooperative.example_scenes import begin
from cooperative.folder import models_of
from cooperative.reporting import _plots as plots
from cooperative.reporting import panels
from cooperative.runs import coefficients_of, cost_of, ground_of, soil_of
from cooperative.scene import Campaign, campaigns_of
from jaxmpm.support.files import write_aside

TRIAL = 10.0
"""Seconds of each trial behind a cost."""
SCENES = ROOT / "benchmarks" / "scenes"
PAGE = ROOT / "docs" / "gallery.md"
FIGURES = ROOT / "docs" / "gallery"

BEGIN = "yours to fill in: `jaxmpm new --kind {}`"
SURVEYED = "what was surveyed against the failures: [real slides](trust.md#real-slides)"
RESULTS = {
    "demo": "P_f 0.49 (0.327 to 0.721); 63 % of the failures deep, 37 % progressive",
    "section": "P_f 0.408 (0.289 to 0.638); 78 % of the failures progressive, 22 % deep",
    "paper_section": "P_f 0.341 (0.222 to 0.578); 59 % of the failures deep, 41 % progressive",
    "slope": "P_f 0.332 (0.246 to 0.534) from 200 rough and 24 refined runs; 0.44 (0.34 to 0.64) from as "
    "many of other samples, of [the study](published-study.md)",
    "paper": "P_f 0.282 (0.244 to 0.382), from 750 rough and 100 refined runs of [the study](published-study.md); "
    "0.244 printed",
    "section_sweep": "P_f 0.20, 0.37, 0.55 at cov 0.2, 0.3, 0.4; 0.37 to 0.42 over lx: [figures](campaigns.md#sweeps)",
    "paper_sweep": "P_f rises with ly, as printed; with lx it rises on the rough grid, and the refined runs leave it "
    "open: [the study](published-study.md)",
    "cho": "P_f 0.085 (0.068 to 0.156); 0.065 to 0.079 printed",
    "cho_cphi": "P_f 0.092 (0.061 to 0.135), 240 samples on the refined grid; 0.055 to 0.064 printed",
    "example_2": "P_f 1.0 (0.89 to 1) where 50 m3 count; 0.43 printed, see [random fields](random-fields.md)",
    "griffiths_fenton": "P_f 0.287 (0.256 to 0.386); 0.290 by the closed form with the factor computed here, 1.298 for "
    "the median soil",
    "what_if": "P_f 0.29 (0.19 to 0.48); 0.29 less (0.15 to 0.43) with the berm, 0.36 more (0.13 to 0.58) at k_h 0.03: "
    "[curves](campaigns.md#sweeps)",
    "embankment": "P_f 0.418 (0.297 to 0.619); all failures deep, run-out 13 m",
    "storm": "P_f 0.35 (0.12 to 0.64) by the end of the rain, 0.03 (0 to 0.48) by 24 h: [in "
    "time](seepage.md#probability-of-failure-against-time)",
    "sites/acads_1c": "factor of safety 1.356 at its limit load (1.35 printed); no failure in 20 refined runs, "
    "P_f below 0.24",
    "sites/acads_3a": "factor of safety 1.271 at its limit load (1.26 printed); P_f has not been run",
    "sites/griffiths_lane_3": "factor of safety 1.372 by the mean strength (1.4 printed), 1.342 by the median; no "
    "failure in 20 refined runs, P_f below 0.24",
    "sites/retrogression_5m_buoyant": "mean soil runs out 22.1 m (21.6 printed) and goes 18.4 m back (14) in 4 slides "
    "(3) on cells of 0.25 m, see [notes](notes/verification.md#retrogression-in-sensitive-clay); P_f has not been run",
    "sites/retrogression_5m": "P_f 1.0 (0.81 to 1.0); mean soil runs out 37.3 m (21.6 printed), in 5 slides (3)",
    "sites/retrogression_5m_divided": "P_f 1.0 (0.80 to 1.0); mean soil runs out 70 m (21.6 printed), in 2 slides (3)",
    "real/lower_san_fernando_1971": SURVEYED,
    "real/sainte_monique_1994": SURVEYED,
    "real/s1000_2021": SURVEYED,
    "real/upper_san_fernando_1971": SURVEYED,
    "new/slope": BEGIN.format("slope"),
    "new/section": BEGIN.format("section"),
    "new/terrain": BEGIN.format("terrain"),
}
"""Result of each scene, by its path below benchmarks/scenes, in the order of the page. Intervals are of 95 %."""

HEAD = """# Gallery

All example scenes. To use one of the first table, write its file into the current folder, change it and run it:

```sh
jaxmpm example embankment                     # writes embankment.toml
jaxmpm check embankment.toml
jaxmpm run embankment.toml --out out/embankment
```

Copy a scene of the second or third table from its link. `jaxmpm new --kind KIND` writes those of the last table.
[Every key](scenes.md) explains what to change.

- **Closest to an embankment on soft clay**: `embankment`.
- **Water**: `what_if`, `storm`, in which it moves, and `sites/acads_3a` (a piezometric line). **Earthquakes**:
  `what_if` by its k_h; a record goes into [`[motion]`](scenes.md#motion).
- **Under five minutes on one core**: `demo` (half a minute on two), `section`, `paper_section`, `griffiths_fenton`,
  `what_if`, `embankment`, `new/slope`, `new/section`.

Each picture shows sample 0 on the refined grid; `jaxmpm draw SCENE` draws it larger, with layers, walls and both grids.
The cost is an upper limit, by `jaxmpm check SCENE --measure` on one core of a shared machine. Runs end far sooner where
the slope stands. P_f is the probability of failure, with its 95 % interval. `python -m benchmarks.project.gallery`
writes this page.
"""
GROUPS = {"": "Examples", "sites": "Slopes with known answers", "real": "Real slides", "new": "To begin your own with"}


def names() -> list[str]:
    """Every scene that comes along, by its path below benchmarks/scenes without the suffix."""
    return sorted(path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.toml"))


def campaigns(name: str) -> list[Campaign]:
    """The campaigns of a scene: one, or those of a sweep, of which the first has the scene's own values."""
    with tempfile.TemporaryDirectory() as scratch:
        path = SCENES / f"{name}.toml"
        if name.startswith("new/"):
            # A terrain model is written beside it.
            path = Path(scratch) / "own.toml"
            begin(name.removeprefix("new/"), path)
        return campaigns_of(path)


def about(name: str) -> str:
    """A scene's own first comment."""
    lines = (SCENES / f"{name}.toml").read_text().splitlines()
    last = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    return " ".join(line.lstrip("# ") for line in lines[:last])


def picture(campaign: Campaign) -> Figure:
    """The random soil of sample 0 on the refined grid; in 3D in the section in the middle."""
    models = models_of(campaign)
    ground, model = ground_of(models), models["refined"]
    plane = plots.plane_at(ground.grids["refined"], ground.middle)
    position, half = plots.section_of(ground.grids["refined"], plane)
    name = next(iter(campaign.random))
    quantity = plots.quantity(name)
    values = soil_of(model, coefficients_of(campaign, model.soil)[0]).values[name][plane] / quantity.size
    length, height = np.ptp(position, axis=1)
    figure, (ax,) = panels(1, size=(4.8, 3.8 * height / length + 0.6))
    norm = Normalize(float(np.nanmin(values)), float(np.nanmax(values)))
    boxes = plots.draw_particles(ax, position, half, values, "cividis", norm)
    figure.colorbar(boxes, ax=ax, label=f"{quantity.symbol} [{quantity.unit}]", aspect=12)
    return figure


def cost(parts: list[Campaign], seconds: float) -> str:
    """Particles of both grids and the most hours of one core, in words."""
    result = [cost_of(part, seconds / len(parts)) for part in parts]
    sizes = result[0].sizes
    hours = sum(part_cost.hours(grid) for part_cost in result for grid in part_cost.sizes)
    minutes = f"{60 * hours:.0f} minutes" if 60 * hours >= 1.5 else "a minute"
    duration = minutes if hours < 1 else f"{float(f'{hours:.2g}'):,g} hours"
    rough, refined = (sum(part_cost.runs[grid] for part_cost in result) for grid in ("rough", "refined"))
    grids = " and ".join(f"{size.particles:,.0f}" for size in sizes.values())
    return f"{rough:,} rough and at most {refined:,} refined runs of {grids} particles: {duration}"


def row(name: str, cost_text: str) -> str:
    """One line of the page's table."""
    link = f"[`{name}`](../benchmarks/scenes/{name}.toml)"
    shown = f"![Random soil of {name}](gallery/{name.replace('/', '-')}.png)"
    return f"| {link}: {about(name)} | {shown} | {cost_text} | {RESULTS[name]} |"


def draw(name: str, campaign: Campaign) -> None:
    """Write a scene's picture."""
    plots.save(picture(campaign), FIGURES / f"{name.replace('/', '-')}.png", dpi=80)


def main() -> None:
    """Draw the pictures, try the costs, write the page."""
    lines = [HEAD]
    for group, title in GROUPS.items():
        lines += [f"## {title}\n", "| scene | sample 0 | most that it can cost | result |", "|---|---|---|---|"]
        for name in (name for name in RESULTS if os.path.dirname(name) == group):
            parts = campaigns(name)
            draw(name, parts[0])
            lines.append(row(name, cost(parts, TRIAL)))
        lines.append("")
    write_aside(PAGE, "\n".join(lines).encode())
    print(PAGE)


if __name__ == "__main__":
    main()
