"""Tables that scenes of several tests share."""


def tables(cell: float = 2.0, run: str = "t_end = 4.0") -> str:
    """Both grids, the refined one of half the cell (m) and each of two particles a cell along an axis, the lines of the
    run, and a campaign of ten samples."""
    grids = "".join(
        f"[{name}]\ncell = {size}\nspacing = [{size / 2}, {size / 2}]\n"
        for name, size in (("rough", cell), ("refined", cell / 2))
    )
    return f"{grids}[run]\n{run}\n[campaign]\nsamples = 10\nseed = 3\nrefined_runs = 10\n"
