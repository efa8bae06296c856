"""Posterior Cramer-Rao lower bounds: how good any filter could be."""
