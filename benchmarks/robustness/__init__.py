"""Interrupted campaigns, damaged files and hostile scenes."""
