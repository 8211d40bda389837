"""Answers that others found: codes, experiments and closed forms."""
