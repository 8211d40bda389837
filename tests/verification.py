"""What several verification tests share."""

import numpy as np


def order(cells, errors):
    """Slope of log error against log cell size, by least squares."""
    return np.polyfit(np.log(cells), np.log(errors), 1)[0]
