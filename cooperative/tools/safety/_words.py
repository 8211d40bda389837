"""Factors of safety in words, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cooperative.tools.safety._factor import Safety

METHODS = {
    "spencer": "Spencer's method",
    "bishop": "Bishop's simplified method",
    "janbu": "Janbu's simplified method with his correction",
}
"""Methods of slices in words."""


def lines_of_equilibrium(name: str, result: Safety) -> Iterator[str]:
    """What limit equilibrium gives, before the solver begins.

    Args:
        name: of the scene.
        result: of `factor_of_safety`.
    """
    yield f"{name} ({', '.join([result.soil, *result.loads])})"
    if result.equilibrium is None:
        yield f"  limit equilibrium  none: {result.notes[0]}"
        return
    slip, circle = result.equilibrium.slip, result.equilibrium.circle
    if slip.circle:
        shape = "the critical circle"
    else:
        beside = "no circle has a factor" if circle is None else f"critical circle {circle.factor:.3f}"
        shape = f"a surface of another shape ({beside})"
    (x0, _), (x1, _) = slip.points[[0, -1]]
    yield (
        f"  limit equilibrium  {slip.factor:.3f}  {METHODS[slip.method]}, {shape}, from x = {x0:.3g} to {x1:.3g} m, "
        f"{slip.thickness:.3g} m deep, {slip.area:.3g} m2; {result.seconds:.1f} s"
    )
    if slip.pulled:
        yield "    part of this surface would be in tension: a crack at the crest may lower the factor further"
    if slip.method != "spencer" and result.frictional:
        yield f"    Spencer's method has no admissible answer on this surface: {METHODS[slip.method]} stands in for it"


def lines_of_solver(result: Safety) -> Iterator[str]:
    """What the solver gives, and why that differs.

    Args:
        result: of `factor_of_safety`.
    """
    answer = result.solver
    if answer is not None and answer.kink is not None:
        yield (
            f"  solver             {answer.kink:.3f}  limit load, {result.grid}; stands at R = {answer.stable:.4g}, "
            f"fails at R = {answer.fails:.4g}"
        )
        if answer.volume is not None and answer.sharpness is not None:
            yield (
                f"                            {answer.volume:.3g} {result.unit} "
                f"moves there, and {float(f'{answer.sharpness:.2g}'):g} times as fast with R as below"
            )
    for doubt in result.doubts:
        yield f"    {doubt}"
    for note in result.notes[int(result.equilibrium is None) :]:
        yield f"  solver             none: {note}"
    if result.difference is not None:
        yield f"  difference         {100 * result.difference:+.1f} % of limit equilibrium"
    for reason in result.reasons:
        yield f"    {reason}"


def progress_line(factors: Sequence[float], displacements: Sequence[float], seconds: float) -> str:
    """A round of the limit load in a line.

    Args:
        factors: by which strength was divided.
        displacements: of the slope (m).
        seconds: since the solver began.
    """
    tried = ", ".join(f"{factor:.3g}: {metres:.2g} m" for factor, metres in zip(factors, displacements, strict=True))
    return f"limit load, {seconds:.0f} s: displacement at R = {tried}"
