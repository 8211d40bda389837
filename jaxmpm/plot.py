"""Pictures of a state: its particles as boxes where they are, with a colour each. Neither shows nor saves one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxmpm import diagnostics, tensors
from jaxmpm.laws import declared, of_skeleton
from jaxmpm.run import Result
from jaxmpm.support import check
from jaxmpm.types import Scene, State

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

DPI = 144
"""Pixels per inch."""


def _pressure(scene: Scene, state: State) -> ArrayLike:
    return -tensors.mean(tensors.expand(diagnostics.effective_stress(scene, state), scene.grid.dimension)) / 1e3


def _water(scene: Scene, state: State) -> ArrayLike:
    return diagnostics.pore_pressure(scene, state) / 1e3


def _shear(scene: Scene, state: State) -> ArrayLike:
    stress = tensors.expand(state.stress, scene.grid.dimension)
    return tensors.safe_sqrt(jnp.asarray(tensors.second_invariant(tensors.deviator(stress)))) / 1e3


QUANTITIES: dict[str, tuple[str, Callable[[Scene, State], ArrayLike]]] = {
    "displacement": ("displacement (m)", lambda _, state: diagnostics.displacement(state)),
    "speed": ("speed (m/s)", lambda _, state: jnp.linalg.norm(state.velocity, axis=0)),
    "pressure": ("mean stress in compression (kPa)", _pressure),
    "pore_pressure": ("pore pressure (kPa)", _water),
    "shear_stress": ("sqrt(J2) (kPa)", _shear),
    "volume_ratio": ("current over initial volume", lambda _, state: state.volume_ratio),
}
"""Label and function of each quantity of a state."""


def state(scene: Scene, state: State, colour: str | ArrayLike = "displacement", *, y: float | None = None) -> Figure:
    """Draw the particles of a state, a section through those of a scene in 3D.

    Args:
        scene: of the state, in 2D or 3D.
        state: of one lane.
        colour: "displacement", "speed", "pressure", "pore_pressure", "shear_stress", "volume_ratio",
            "plastic_strain" of a law that has one as its history, a number that the law declares, or one value per
            particle (N,).
        y: position of the section (m), in 3D only; None for the middle of the ground.

    Returns:
        Figure.

    Raises:
        ValueError: If the scene is in 1D, the state is not of one lane, or the colour is unknown or of another shape.
    """
    figure, axes, shown, half = _start_of(scene, state, y)
    label, values = _values(scene, state, colour)
    boxes = _boxes(axes, _corners(scene, state, shown, half), values[shown])
    figure.colorbar(boxes, ax=axes, label=label)
    return figure


def animate(
    scene: Scene,
    run: Result | Sequence[State],
    colour: str = "displacement",
    *,
    y: float | None = None,
    times: Sequence[float] | None = None,
    interval: float = 100.0,
) -> FuncAnimation:
    """Draw the snapshots of a run one after the other, with one scale of colours.

    `.save("run.gif")` of the result writes it, and `.to_jshtml()` shows it in a notebook.

    Args:
        scene: of the run, in 2D or 3D.
        run: result of `solve` of one lane with snapshots, or states.
        colour: as for `state`.
        y: as for `state`.
        times: of states (s), to be shown; those of a result are known.
        interval: between two pictures (ms).

    Returns:
        Animation.

    Raises:
        ValueError: If there is no snapshot, or as for `state`.
    """
    from matplotlib.animation import FuncAnimation

    states = run.snapshots if isinstance(run, Result) else tuple(run)
    if not states:
        raise ValueError("the run has no snapshots: give solve(..., snapshots=times), or states")
    times = run.times if isinstance(run, Result) else times
    titles = [""] * len(states) if times is None else [f"{time:.3g} s" for time in times]
    figure, axes, shown, half = _start_of(scene, states[0], y)
    label, _ = _values(scene, states[0], colour)
    fields = [_values(scene, moment, colour)[1][shown] for moment in states]
    corners = [_corners(scene, moment, shown, half) for moment in states]
    boxes = _boxes(axes, corners[0], fields[0])
    boxes.set_clim(min(map(np.min, fields)), max(map(np.max, fields)))
    points = np.concatenate(corners).reshape(-1, 2)
    axes.set(xlim=(points[:, 0].min(), points[:, 0].max()), ylim=(points[:, 1].min(), points[:, 1].max()))
    figure.colorbar(boxes, ax=axes, label=label)

    def show(frame: int) -> list[PolyCollection]:
        boxes.set_verts(list(corners[frame]))
        boxes.set_array(fields[frame])
        axes.set_title(titles[frame])
        return [boxes]

    return FuncAnimation(figure, show, frames=len(states), interval=interval)


def _start_of(scene: Scene, state: State, y: float | None) -> tuple[Figure, Axes, np.ndarray, float]:
    """Figure and axes, the particles (n,) to draw, and half the edge of their boxes (m)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    start, d = np.asarray(scene.particles.position), scene.grid.dimension
    diagnostics.position(scene, state)  # refuses a state of lanes
    if d == 1:
        raise ValueError("a scene in 1D has no picture: plot its arrays against diagnostics.position")
    half = float(np.median(np.asarray(scene.particles.volume)) ** (1 / d)) / 2
    shown = np.arange(start.shape[1])
    if d == 3:
        middle = float(start[1].min() + start[1].max()) / 2 if y is None else y
        check.finite("y", middle, "m")
        nearest = start[1, np.argmin(np.abs(start[1] - middle))]
        shown = np.flatnonzero(np.abs(start[1] - nearest) < half)
    elif y is not None:
        raise ValueError(f"y = {y:g} m of a scene in 2D: leave it out")
    width, height = np.ptp(start[0]) + 2 * half, np.ptp(start[-1]) + 2 * half
    figure = Figure(figsize=(9, float(np.clip(7.2 * height / width + 0.9, 2.0, 8.0))), layout="constrained", dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.set(xlabel="x (m)", ylabel="z (m)", aspect="equal")
    return figure, axes, shown, half


def _values(scene: Scene, state: State, colour: str | ArrayLike) -> tuple[str, np.ndarray]:
    """Label, and a value (N,) per particle."""
    shape = np.shape(scene.particles.mass)
    if not isinstance(colour, str):
        check.require(np.shape(colour) == shape, f"colour has shape {np.shape(colour)}: give {shape}, one per particle")
        return "", np.asarray(colour)
    numbers = declared(scene.material)
    if colour in QUANTITIES:
        label, function = QUANTITIES[colour]
        return label, np.asarray(function(scene, state))
    if colour == "plastic_strain" and getattr(of_skeleton(state.history), "shape", None) == shape:
        return "plastic shear strain", np.asarray(of_skeleton(state.history))
    if colour not in numbers:
        raise ValueError(
            f"colour = {colour!r}: give one of {[*QUANTITIES, 'plastic_strain', *numbers]}, or values (N,)"
        )
    unit = numbers[colour].parameter.unit
    return f"{colour} ({unit})" if unit else colour, np.broadcast_to(np.asarray(numbers[colour].value), shape)


def _corners(scene: Scene, state: State, shown: np.ndarray, half: float) -> np.ndarray:
    """Corners (n, 4, 2) m of the particles' boxes."""
    x, *_, z = np.asarray(diagnostics.position(scene, state))[:, shown]
    corner = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.stack([x, z], axis=1)[:, None] + corner


def _boxes(axes: Axes, corners: np.ndarray, values: np.ndarray) -> PolyCollection:
    from matplotlib.collections import PolyCollection

    boxes = PolyCollection(list(corners), array=values, linewidths=0)
    axes.add_collection(boxes)
    axes.autoscale_view()
    return boxes
