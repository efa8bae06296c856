"""Dives that never were: scenarios, true motion, and the errors of the simulated sensors."""
