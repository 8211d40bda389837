"""Table of an earthquake's record: `[motion]`."""

from __future__ import annotations

from typing import Annotated

from cooperative.scene.tables._key import AboveZero, Record, Table, key, one_of
from jaxmpm.soil import STANDARD_GRAVITY

UNITS = {"m/s2": 1.0, "cm/s2": 0.01, "g": STANDARD_GRAVITY}
"""Units of a record, in m/s2."""


class Motion(Table):
    """Record of an earthquake that shakes the rigid base, from the stress at rest on.

    The scene is solved in the frame of its base: displacements are relative to it, and run-out with them. No run
    settles before the record ends. A limit load, and factors of safety of a calibration, are those without the motion.
    """

    record_unit: Annotated[float, one_of(UNITS)] = key("Unit of the record's acceleration.", "g")
    record: Record = key(
        "File of the acceleration: a CSV or a file of PEER (.AT2), whose component is along x. The first row of a CSV "
        "names the columns: `time` (s), even, and some of `x`, `z` and in 3D `y`. Without names they are `time` and "
        "`x`.",
        "record.csv",
    )
    scale: AboveZero = key("Factor on the acceleration.", 1.5, 1.0)
