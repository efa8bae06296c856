"""Figures of a run and of a comparison; matplotlib is imported in this room alone."""
