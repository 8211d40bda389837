"""What another assumption does to the real slides where data are missing: the median soil, on the rough grid.

Each assumption is a change of keys of the slide's scene, in benchmarks/scenes/real/assumptions.json; null leaves a key
out. The spread of Sainte-Monique stands with its median soil, so that its strength is multiplied by 0.65 in all its
rows. The viscosities are those of docs/soils.md (Locat and Demers 1988, Canadian Geotechnical Journal 25, 799-806).
A row has the quantities of `benchmarks.sites.real_surveys` in m and m2, none where the soil stands or its run broke
off. `--quick` runs the first assumption of the spread alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from benchmarks.measure import Report
from benchmarks.sites.real_slides import SCENES, measured
from benchmarks.sites.real_surveys import KNOWN
from cooperative import runs
from cooperative.scene import Campaign, changed, parse, read_scene, to_toml

Row = dict[str, str | float | None]


def scene_of(name: str, changes: Mapping[str, object]) -> Campaign:
    """The scene of a slide under an assumption.

    Args:
        name: of the slide.
        changes: values by the path of their key, None to leave a key out.
    """
    return parse(to_toml(changed(read_scene(SCENES / f"{name}.toml").tables, changes)))


def row_of(name: str, assumption: str, changes: Mapping[str, object]) -> Row:
    """The slide of the median soil under an assumption."""
    campaign = scene_of(name, changes)
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil)
    (sample,) = runs.run_samples(model, np.zeros((1, soil.modes)), [0])
    head: Row = {"slide": name, "assumption": assumption, "status": sample.status}
    if float(sample.row["displacement"]) <= campaign.run.failure_displacement or sample.row["broke_off"]:
        return head
    (quantities,) = measured(campaign, "rough", KNOWN[name].crest, [sample])
    return head | {quantity: round(value, 1) for quantity, value in quantities.items() if quantity != "change"}


def run(quick: bool) -> Report:
    """All assumptions."""
    slides = json.loads((SCENES / "assumptions.json").read_text(encoding="utf-8"))
    if quick:
        slides = {"sainte_monique_1994": dict(list(slides["sainte_monique_1994"].items())[:1])}
    rows = [
        row_of(name, words, changes)
        for name, changes_by_words in slides.items()
        for words, changes in changes_by_words.items()
    ]
    return Report({"assumptions": len(rows), "slid": sum("runout" in row for row in rows)}, rows)
