"""Estimate sensor errors and noise from the log itself, before a filter runs and without truth.

Likelihoods of the fixes given dead reckoning, and of the DVL records given each other, are compared between noise
models; a state is observable if the measurements reduce its sigma.
"""
