"""Pictures of chosen samples: the field that both grids see, the slide at several times, from the side and above."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.colors import Normalize
from scipy.spatial import cKDTree

from cooperative.measure import SEVERITY
from cooperative.reporting import _plots as plots
from cooperative.reporting import _turn as turn
from cooperative.reporting._plots import Drawn
from cooperative.runs import Frames, GridModel, build, random_soil
from cooperative.scene import Campaign
from cooperative.store import Rows, Sample
from jaxmpm import Midway, solve_each

FACES = 10_000
"""Of a body on the page: a slide has several, and the page is to stay below 5 MB."""

SHARES = (0.1, 0.3, 0.6)
"""Shares of the largest displacement at which a slide that is run again is drawn, and at its end."""


def choose(rows: Rows, failed: np.ndarray, most: int) -> list[int]:
    """Numbers of the samples to draw: the farthest of each failure mode that occurs, then the next farthest.

    failed: (runs,) bool. Where nothing failed it is the sample that moved farthest.
    """
    moved = rows.columns["displacement"]
    modes = rows.columns.get("mode", np.full(moved.size, ""))
    order = np.argsort(-moved, kind="stable").tolist()
    if not failed.any():
        return [rows.numbers[order[0]]]
    falls = [at for at in order if failed[at]]
    leaders = [next((at for at in falls if modes[at] == mode), None) for mode in SEVERITY]
    chosen = dict.fromkeys([falls[0], *(at for at in leaders if at is not None), *falls])
    return [rows.numbers[at] for at in list(chosen)[:most]]


def fields(models: dict[str, GridModel], sample: Sample) -> Iterator[Drawn]:
    """The random fields that both grids see for one sample, a picture for each parameter."""
    planes = {grid: _plane(model, sample) for grid, model in models.items()}
    sections = {grid: section_of(models[grid], planes[grid]) for grid in models}
    found = {grid: values_of(model, sample.coefficients) for grid, model in models.items()}
    for place, name in enumerate(next(iter(models.values())).campaign.random):
        seen = {grid: found[grid][name][planes[grid]] for grid in models}
        figure = plots.parameter_fields(name, sections, seen)
        said = f"Sample {sample.number}: the same random field of {_word(name)} on both grids."
        yield Drawn(f"field-{name}" if place else "field", said, figure)


def before_and_after(model: GridModel, sample: Sample) -> Drawn:
    """One sample's section before and after, by the plastic strain that was kept."""
    plane = _plane(model, sample)
    section, half = section_of(model, plane)
    figure = plots.before_and_after(
        section, sample.fields["displacement"][[0, -1]][:, plane], sample.fields["plastic_strain"][plane], half
    )
    return Drawn("slope", f"Sample {sample.number} before and after its slide, by plastic strain.", figure)


def slides(model: GridModel, samples: Sequence[Sample], *, again: bool) -> Iterator[Drawn]:
    """Each sample's strength and slide at several times, in 3D from above too.

    again: run the samples again for it; otherwise the fields that were kept serve, and a sample without is left out.
    """
    if again:
        model = build(model.campaign, model.grid, model.soil)
    for sample in samples:
        shown = moments(model, sample) if again else kept_moments(model, sample)
        if not shown.times:
            continue
        displacement = np.stack(shown.displacement)
        mode = f", {sample.row['mode']}" if sample.row.get("mode") not in (None, "none") else ""
        plane, name = _plane(model, sample), next(iter(model.campaign.random))
        figure = plots.slide(
            section_of(model, plane),
            name,
            values_of(model, sample.coefficients)[name][plane],
            displacement[:, [0, -1]][:, :, plane],
            shown.times,
        )
        where = " Section where it moved farthest." if len(model.half_size) == 3 else ""
        yield Drawn(
            f"slide-{sample.number:06d}", f"Sample {sample.number}{mode}: {_word(name)} and slide.{where}", figure
        )
        if len(model.half_size) == 3:
            position = np.asarray(model.scene.particles.position, float)
            face = model.campaign.site.shape.face
            toe = None if face is None else face.toe_x
            figure = plots.plan(position, displacement, shown.times, model.half_size, toe=toe)
            said = f"Sample {sample.number}{mode}, by how far the soil on top has moved"
            body = turn.turning(bodies(position, displacement, shown.times, model.half_size), f"{said}.")
            yield Drawn(f"plan-{sample.number:06d}", f"{said}, from above.", figure, body)


def bodies(
    position: np.ndarray, displacement: np.ndarray, times: Sequence[float], half_size: np.ndarray
) -> list[turn.Body]:
    """A slide in 3D at several times, the last one first: the skin of the ground before, moved with its soil.

    position: initial (3, N) m. displacement: (T, 3, N) m at the T times (s). half_size: half the particle spacing
    (3,) m.
    """
    faces, of = turn.skin(position, 2 * half_size, most=FACES)
    corners, place = np.unique(faces.reshape(-1, 3).round(6), axis=0, return_inverse=True)
    # A corner goes with the particles that meet there, as in a section; where boxes are larger, with the nearest ones.
    away, near = cKDTree(position.T).query(corners, k=min(8, position.shape[1]))
    meets = (away <= away[:, :1] * (1 + 1e-6))[None]
    moved = np.linalg.norm(displacement, axis=1)
    norm = Normalize(0.0, max(float(moved.max()), 1e-6))
    found = []
    for time, step, far in zip(times, displacement, moved, strict=True):
        now = corners + (np.where(meets, step[:, near], 0).sum(axis=2) / meets.sum(axis=2)).T
        colours = turn.coloured(far[of], norm, "viridis")
        scale = ("displacement, m", 0.0, float(norm.vmax or 0.0), "viridis")
        found.append(turn.Body(f"t = {time:.3g} s", now[place.reshape(-1)].reshape(faces.shape), colours, scale=scale))
    return found[::-1]


def kept_moments(model: GridModel, sample: Sample) -> Frames:
    """A sample's frames in single precision, and its end; nothing where its fields were not kept."""
    if "displacement" not in sample.fields:
        return Frames()
    frames = Frames.of(sample.fields)
    earlier = (each.astype(np.float32) for each in frames.displacement)
    return Frames((*frames.times, end_of(model, sample)), (*earlier, sample.fields["displacement"]))


def end_of(model: GridModel, sample: Sample) -> float:
    """When a sample's run ended (s)."""
    return sample.steps * model.time_step(sample.coefficients)


def moments(model: GridModel, sample: Sample) -> Frames:
    """Run a finished sample again and keep its displacement when it has moved the given shares of its largest one, and
    at its end."""
    reach = float(sample.row["displacement"])
    due = [share * reach for share in SHARES]
    times: list[float] = []
    kept: list[np.ndarray] = []

    def look(_: int, seconds: float, midway: Midway) -> None:
        displacement = midway.state.displacement
        if due and float(np.linalg.norm(displacement, axis=0).max()) >= due[0]:
            del due[0]
            times.append(seconds)
            kept.append(np.asarray(displacement))

    run = model.campaign.run
    varied = {name: [value] for name, value in model.varied(sample.coefficients).items()}
    for _, result in solve_each(
        model.scene, model.state, varied, width=1, t_end=run.t_end, settle=run.settle, slides_end=model.slides_end,
        least_volume=run.least_volume, observe=look,
    ):  # fmt: skip
        end = int(result.state.step) * float(result.time_step)
        if not times or end > times[-1]:
            times.append(end)
            kept.append(np.asarray(result.state.displacement))
    return Frames(tuple(times), tuple(kept))


def models_of(campaign: Campaign) -> dict[str, GridModel]:
    """Both grids of a campaign, free of stress: to be looked at, not run."""
    soil = random_soil(campaign)
    return {grid: build(campaign, grid, soil, at_rest=False) for grid in ("rough", "refined")}


def _word(name: str) -> str:
    return "strength" if name == "strength" else plots.QUANTITIES[name].word


def values_of(model: GridModel, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """The random parameters at the particles, each (N,), by name; nan where they are rock."""
    found = {name: np.asarray(value, float) for name, value in model.parameters(coefficients).items()}
    if model.layer is None:
        return found
    rock = np.array([each.rock for each in model.campaign.site.layers])[model.layer]
    return {name: np.where(rock, np.nan, value) for name, value in found.items()}


def _plane(model: GridModel, sample: Sample) -> np.ndarray:
    """Particles (N,) of the section to draw: all of them in 2D, in 3D the slice that moved farthest."""
    position, moved = np.asarray(model.scene.particles.position), sample.fields.get("displacement")
    if len(position) == 3 and moved is not None and moved.shape == position.shape:
        return plane_at(model, float(position[1, np.argmax(np.linalg.norm(moved, axis=0))]))
    return plane_at(model, middle(model))


def middle(model: GridModel) -> float:
    """Half way along y (m); 0 in a section."""
    shape = model.campaign.site.shape
    return shape.corner[1] + shape.extent[1] / 2 if len(shape.extent) == 3 else 0.0


def plane_at(model: GridModel, centre: float) -> np.ndarray:
    """Particles (N,) of the section at y = centre (m): all of them in 2D."""
    position = np.asarray(model.scene.particles.position)
    if len(position) == 2:
        return np.ones(position.shape[1], bool)
    nearest = position[1, np.argmin(np.abs(position[1] - centre))]
    return np.abs(position[1] - nearest) < model.half_size[1]


def section_of(model: GridModel, plane: np.ndarray) -> plots.Section:
    """Positions (2, n) of a section's particles and half their spacing (2,) m."""
    return np.asarray(model.scene.particles.position, float)[[0, -1]][:, plane], model.half_size[[0, -1]]
