"""Pictures of chosen samples: the field that both grids see, the slide at several times, from the side and above."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.colors import Normalize
from scipy.spatial import cKDTree

from cooperative.reporting import _plots as plots
from cooperative.reporting import _turn as turn
from cooperative.reporting._plots import Drawn
from cooperative.runs import Frames, GridModel, SampleSoil, StoredGrid, StoredGround
from cooperative.store import Sample
from jaxmpm import Midway, solve_each

FACES = 10_000
"""Of a body on the page: a slide has several, and the page is to stay below 5 MB."""

SHARES = (0.1, 0.3, 0.6)
"""Shares of the largest displacement at which a slide that is run again is drawn, and at its end."""


def fields(ground: StoredGround, sample: Sample, soils: Mapping[str, SampleSoil]) -> Iterator[Drawn]:
    """The random fields of one sample on both grids, a picture for each parameter.

    ground: of the campaign. soils: of the sample, by grid.
    """
    planes = {grid: _plane(ground, grid, sample) for grid in soils}
    sections = {grid: section_of(ground.grids[grid], plane) for grid, plane in planes.items()}
    for place, name in enumerate(ground.random):
        seen = {grid: soil.values[name][planes[grid]] for grid, soil in soils.items()}
        figure = plots.parameter_fields(name, sections, seen)
        caption = f"Sample {sample.number}: the same random field of {_word(name)} on both grids."
        yield Drawn(f"field-{name}" if place else "field", caption, figure)


def before_and_after(ground: StoredGround, grid: str, sample: Sample) -> Drawn:
    """One sample's section before and after, by the plastic strain that was kept."""
    plane = _plane(ground, grid, sample)
    section, half = section_of(ground.grids[grid], plane)
    figure = plots.before_and_after(
        section, sample.fields["displacement"][[0, -1]][:, plane], sample.fields["plastic_strain"][plane], half
    )
    return Drawn("slope", f"Sample {sample.number} before and after its slide, by plastic strain.", figure)


def slide(ground: StoredGround, grid: str, sample: Sample, soil: SampleSoil, shown: Frames) -> Iterator[Drawn]:
    """A sample's strength and slide at several times, in 3D from above too; nothing where no moment is known."""
    if not shown.times:
        return
    displacement = np.stack(shown.displacement)
    mode = f", {sample.row['mode']}" if sample.row.get("mode") not in (None, "none") else ""
    plane, name, of = _plane(ground, grid, sample), ground.random[0], ground.grids[grid]
    figure = plots.slide(
        section_of(of, plane), name, soil.values[name][plane], displacement[:, [0, -1]][:, :, plane], shown.times
    )
    where = " Section where it moved farthest." if ground.dimension == 3 else ""
    yield Drawn(f"slide-{sample.number:06d}", f"Sample {sample.number}{mode}: {_word(name)} and slide.{where}", figure)
    if ground.dimension == 3:
        position = np.asarray(of.position, float)
        toe = None if ground.face is None else ground.face.toe_x
        figure = plots.plan(position, displacement, shown.times, of.half_size, toe=toe)
        caption = f"Sample {sample.number}{mode}, by how far the soil on top has moved"
        body = turn.turning(bodies(position, displacement, shown.times, of.half_size), f"{caption}.")
        yield Drawn(f"plan-{sample.number:06d}", f"{caption}, from above.", figure, body)


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


def kept_moments(sample: Sample, soil: SampleSoil) -> Frames:
    """A sample's frames in single precision, and its end; nothing where its fields were not kept."""
    if "displacement" not in sample.fields:
        return Frames()
    frames = Frames.of(sample.fields)
    earlier = (each.astype(np.float32) for each in frames.displacement)
    end = sample.steps * soil.time_step
    return Frames((*frames.times, end), (*earlier, sample.fields["displacement"]))


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


def _word(name: str) -> str:
    return "strength" if name == "strength" else plots.quantity(name).word


def _plane(ground: StoredGround, grid: str, sample: Sample) -> np.ndarray:
    """Particles (N,) of the section to draw: all of them in 2D, in 3D the slice that moved farthest."""
    of, moved = ground.grids[grid], sample.fields.get("displacement")
    if ground.dimension == 3 and moved is not None and moved.shape == of.position.shape:
        return plane_at(of, float(of.position[1, np.argmax(np.linalg.norm(moved, axis=0))]))
    return plane_at(of, ground.middle)


def plane_at(grid: StoredGrid, centre: float) -> np.ndarray:
    """Particles (N,) of the section at y = centre (m): all of them in 2D."""
    if len(grid.position) == 2:
        return np.ones(grid.position.shape[1], bool)
    nearest = grid.position[1, np.argmin(np.abs(grid.position[1] - centre))]
    return np.abs(grid.position[1] - nearest) < grid.half_size[1]


def section_of(grid: StoredGrid, plane: np.ndarray) -> plots.Section:
    """Positions (2, n) of a section's particles and half their spacing (2,) m."""
    return np.asarray(grid.position, float)[[0, -1]][:, plane], grid.half_size[[0, -1]]
