"""Estimation of random fields from values at points: mean, trend, variation, correlation lengths, with intervals."""

from kl.estimation._fit import Draws, FieldFit, Interval, fit_field, interval_of
from kl.estimation._prediction import predicted
from kl.estimation._variogram import Variogram, VariogramFit, fit_variogram, variogram

__all__ = [
    "Draws",
    "FieldFit",
    "Interval",
    "Variogram",
    "VariogramFit",
    "fit_field",
    "fit_variogram",
    "interval_of",
    "predicted",
    "variogram",
]
