"""Table of an earthquake's record: `[motion]`."""

from __future__ import annotations

from typing import Annotated

import jax.numpy as jnp
import numpy as np

from cooperative.scene.tables._key import AboveZero, Part, Record, key, one_of, table
from jaxmpm import BaseMotion
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support.check import Invalid

AXES = "xyz"

UNITS = {"m/s2": 1.0, "cm/s2": 0.01, "g": STANDARD_GRAVITY}
"""Units of a record, in m/s2."""


@table
class Motion(Part):
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

    @property
    def acceleration(self) -> np.ndarray:
        """Of the record, before its scale (axes, n) m/s2.

        Raises:
            ValueError: the record is the name of a file.
        """
        if not isinstance(self.record, BaseMotion):
            raise Invalid(("record",), repr(self.record), "", "give what jaxmpm.read_motion reads, or a scene in TOML")
        return np.asarray(self.record.acceleration, float) * self.record_unit

    def of_base(self, dimension: int) -> BaseMotion:
        """The motion of the base (m/s2), along the axes of the ground.

        Args:
            dimension: number of the ground's axes.

        Raises:
            Invalid: a record along other axes, or without any motion.
        """
        acceleration = self.acceleration
        if len(acceleration) == len(AXES) and dimension == 2:
            if np.any(acceleration[1]):
                rule = "has a column y, along which a section does not move"
                raise Invalid(("motion", "record"), None, rule, "name x and z alone")
            acceleration = acceleration[[0, 2]]
        if len(acceleration) != dimension:
            rule = f"has {len(acceleration)} axes, the ground {dimension}"
            raise Invalid(("motion", "record"), None, rule, "give an acceleration along each")
        if not np.abs(acceleration).max() > 0:
            raise Invalid(("motion", "record"), None, "has no acceleration but 0", "leave [motion] out")
        assert isinstance(self.record, BaseMotion)
        return BaseMotion(jnp.asarray(acceleration * self.scale, jnp.float32), jnp.asarray(self.record.interval))
