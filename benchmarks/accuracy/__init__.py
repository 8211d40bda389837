"""Error against run time, beside closed forms and published values."""
