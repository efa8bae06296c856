"""Tracks against the truth: alignment, metrics, consistency, statistics over seeds, influence of single fixes."""
