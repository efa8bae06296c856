"""A track against the truth: alignment, errors, consistency, statistics over seeds, influence of single fixes."""
