"""Runs behind `benchmarks.settings.levers`: sections with other particles and time steps.

`python -m benchmarks.settings.levers_runs` runs what its file lacks. Every variant runs the first samples of the
population in `benchmarks.statistics.section_pairs`, as a campaign does but without the rule that ends slides at rest:
all of them until their class is decided where the time step alone differs, fewer to their end, where run-outs show. The
energy of a run, kinetic, elastic and potential, is counted from its start: more than nothing would be made by the step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.csv_rows import Row, appending, number, read_rows, size, whole, word
from benchmarks.measure import ROOT
from benchmarks.statistics.section_pairs import study
from cooperative import runs
from cooperative.measure import Consequences, consequences
from cooperative.runs import GridModel
from jaxmpm import Exceeds, Result, Scene, Settle, State, diagnostics, solve_each

DATA = ROOT / "benchmarks" / "data" / "levers.csv"
SCENES = ("paper_section", "section")
SAMPLES = {"class": 400, "end": 40}
"""Of each variant, by where its runs end."""
SPACINGS = {"rough": (1.0, 2.0), "refined": (0.5, 1.0)}
"""Of the particles: four a cell, as published, and one."""
CFL = (0.5, 0.9)
VARIANT = ("scene", "grid", "spacing", "cfl", "until")
MEASURED = ("status", "steps", "time", "displacement", "runout", "runout_foremost", "energy")
COLUMNS = {
    **dict(zip(VARIANT, (word(*SCENES), word(*SPACINGS), size, size, word(*SAMPLES)), strict=True)),
    **dict(zip(("number", *MEASURED), (whole, whole, whole, size, size, size, size, number), strict=True)),
}
Variant = tuple[str, str, float, float, str]


def read() -> dict[Variant, dict[int, Row]]:
    """The file: variant -> number -> what was measured. ValueError for a row that does not parse or occurs twice."""
    answer: dict[Variant, dict[int, Row]] = {}
    for (*variant, sample), row in read_rows(DATA, COLUMNS, (*VARIANT, "number")).items():
        answer.setdefault((*variant,), {})[sample] = row
    return answer


def variants() -> Iterator[Variant]:
    """All that are compared, the cheap ones first."""
    for grid, spacings in SPACINGS.items():
        yield from ((scene, grid, spacings[0], cfl, "class") for scene in SCENES for cfl in CFL)
    for grid, spacings in SPACINGS.items():
        yield from ((scene, grid, spacing, cfl, "end") for scene in SCENES for spacing in spacings for cfl in CFL)


def main() -> None:
    """Run what is missing, one sample after the other."""
    done = read()
    with appending(DATA, COLUMNS) as put:
        for variant in variants():
            for row in _rows(variant, sorted(set(range(SAMPLES[variant[-1]])) - done.get(variant, {}).keys())):
                put((*variant, *row))


def _rows(variant: Variant, numbers: list[int]) -> Iterator[tuple[object, ...]]:
    scene, grid, spacing, cfl, until = variant
    campaign = study(scene)
    varied = replace(getattr(campaign, grid), spacing=(spacing, spacing), cfl=cfl)
    campaign = replace(campaign, **{grid: varied})
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    model = runs.build(campaign, grid, soil)
    start_energy = float(_energy(model.scene, model.state))
    strengths = (model.varied(jnp.asarray(coefficients[sample]))["strength"] for sample in numbers)
    for sample, result in solve_each(
        model.scene, model.state, {"strength": strengths}, numbers=numbers, width=1, t_end=campaign.run.t_end,
        rules=[Settle(), *([Exceeds(campaign.run.failure_displacement)] if until == "class" else [])],
    ):  # fmt: skip
        done = measured(model, result)
        energy = float(_energy(model.scene, result.state)) - start_energy
        time = int(result.state.step) * float(result.time_step)
        values = (time, done.displacement, done.runout, done.runout_foremost, energy)
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
