"""Posterior Cramér-Rao lower bounds: the smallest rms error that any filter can have under the assumed model."""
