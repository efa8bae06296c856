"""Columns of a topic to canonical records: axes, frames, units, times of validity, selection of fixes."""
