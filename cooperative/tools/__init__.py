"""What is no campaign: soundings and `site`, factors of safety by slices, sweeps, back-analysis, rare events.

The commands and users import these rooms; no campaign does.
"""
