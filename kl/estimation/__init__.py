"""Estimation of random fields from values at points: mean, trend, variation, correlation lengths, with intervals."""

from kl.estimation._fit import Draws, FieldFit, Interval, fit_field, interval_of
from kl.estimation._prediction import predicted

__all__ = ["Draws", "FieldFit", "Interval", "fit_field", "interval_of", "predicted"]
