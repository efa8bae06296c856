"""Simulated dives: the scenario, the true motion, and the random and systematic errors of each sensor."""
