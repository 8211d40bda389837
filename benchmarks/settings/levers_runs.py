"""Runs behind `benchmarks.settings.levers`: sections with other particles and time steps.

`python -m benchmarks.settings.levers_runs` runs what its file lacks. Every variant runs the first samples of the
population in `benchmarks.statistics.section_pairs`, as a campaign does but without the rule that ends slides at rest:
all of them until their class is decided where the time step alone differs, fewer to their end, where run-outs show. The
energy of a run, kinetic, elastic and potential, is counted from its start: more than nothing would be made by the step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.csv_rows import ENDED, REMEDY, appending, number, put_once, rows_of, whole, word
from benchmarks.measure import ROOT, scene_campaign
from benchmarks.statistics.section_pairs import study
from cooperative import runs
from cooperative.measure import Consequences, consequences
from cooperative.runs import GridModel
from jaxmpm import Result, Scene, Settle, State, Status, diagnostics, solve_each

DATA = ROOT / "benchmarks" / "data" / "levers.csv"
SCENES = ("paper_section", "section")
SAMPLES = {"class": 400, "end": 40}
"""Of each variant, by where its runs end."""
SPACINGS = {"rough": (1.0, 2.0), "refined": (0.5, 1.0)}
"""Of the particles: four a cell, as published, and one."""
CFL = (0.5, 0.9)
VARIANT = ("scene", "grid", "spacing", "cfl", "until")
MEASURED = ("status", "steps", "time", "displacement", "runout", "energy")
COLUMNS = (*VARIANT, "number", *MEASURED)
Variant = tuple[str, str, float, float, str]


def read() -> dict[Variant, dict[int, dict[str, float]]]:
    """The file: variant -> number -> what was measured. ValueError for a line that does not parse, that no run could
    have left, or whose run stands there twice."""
    answer: dict[Variant, dict[int, dict[str, float]]] = {}
    for where, row in rows_of(DATA, COLUMNS):
        known = answer.setdefault(_variant(row, where), {})
        put_once(known, whole(row["number"], f"{where}: number"), _measured(row, where), where)
    return answer


def _variant(row: Mapping[str, str], where: str) -> Variant:
    scene, grid, until = (
        word(row[name], f"{where}: {name}", allowed=allowed)
        for name, allowed in (("scene", SCENES), ("grid", SPACINGS), ("until", SAMPLES))
    )
    spacing, cfl = (number(row[name], f"{where}: {name}", above=True) for name in ("spacing", "cfl"))
    variant = scene, grid, spacing, cfl, until
    if variant not in variants():
        values = f"spacing = {spacing:g}, cfl = {cfl:g} of the {grid} grid to its {until}"
        raise ValueError(f"{where}: {values} is no variant: spacings are {SPACINGS}, CFL {CFL}, {REMEDY}")
    return variant


def _measured(row: Mapping[str, str], where: str) -> dict[str, float]:
    """What a run left. Its energy may be less than nothing, and a run that broke off at once has taken no time."""
    word(row["status"], f"{where}: status", allowed=[str(Status[name].value) for name in ENDED])
    took = float(row["status"]) <= Status.DECIDED
    return {
        name: number(
            row[name],
            f"{where}: {name}",
            least=-np.inf if name == "energy" else 0.0,
            above=took and name in ("steps", "time"),
        )
        for name in MEASURED
    }


def variants() -> Iterator[Variant]:
    """All that are compared, the cheap ones first."""
    for grid, spacings in SPACINGS.items():
        yield from ((scene, grid, spacings[0], cfl, "class") for scene in SCENES for cfl in CFL)
    for grid, spacings in SPACINGS.items():
        yield from ((scene, grid, spacing, cfl, "end") for scene in SCENES for spacing in spacings for cfl in CFL)


def main() -> None:
    """Run what is missing, one sample after the other."""
    done = read() if DATA.exists() else {}
    with appending(DATA, COLUMNS) as put:
        for variant in variants():
            for row in _rows(variant, sorted(set(range(SAMPLES[variant[-1]])) - done.get(variant, {}).keys())):
                put((*variant, *row))


def _rows(variant: Variant, numbers: list[int]) -> Iterator[tuple[object, ...]]:
    scene, grid, spacing, cfl, until = variant
    campaign = study(scene_campaign(scene))
    shape = replace(campaign.grids[grid], spacing=(spacing, spacing), cfl=cfl)
    campaign = replace(campaign, rough=shape) if grid == "rough" else replace(campaign, refined=shape)
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    model = runs.build(campaign, grid, soil)
    begun = float(_energy(model.scene, model.state))
    strengths = (model.varied(jnp.asarray(coefficients[sample]))["strength"] for sample in numbers)
    for sample, result in solve_each(
        model.scene, model.state, {"strength": strengths}, numbers=numbers, width=1, t_end=campaign.run.t_end,
        settle=Settle(), stop_at=campaign.run.failure_displacement if until == "class" else None,
    ):  # fmt: skip
        done = measured(model, result)
        energy = float(_energy(model.scene, result.state)) - begun
        values = (int(result.state.step) * float(result.time_step), done.displacement, done.runout, energy)
        yield (sample, int(result.status), int(result.state.step), *(f"{value:.6g}" for value in values))


def measured(model: GridModel, result: Result) -> Consequences:
    """Consequences of a run, detached grains included."""
    particles, distance = model.scene.particles, np.asarray(result.state.displacement)
    position, volume = np.asarray(particles.position), np.asarray(particles.volume)
    return consequences(position, distance, volume, model.geometry, half_size=model.half_size)


@jax.jit
def _energy(scene: Scene, state: State) -> jax.Array:
    still = diagnostics.elastic_energy(scene, state) + diagnostics.potential_energy(scene, state)
    return diagnostics.kinetic_energy(scene, state) + still


if __name__ == "__main__":
    main()
