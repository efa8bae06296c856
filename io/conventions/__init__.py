"""Columns of a topic to canonical records: axes, frames, units, time of validity, selection of fixes."""
