"""Estimators, hazard maps and rare events: error, coverage and cost."""
