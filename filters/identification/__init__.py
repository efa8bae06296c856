"""Identify sensor errors and noise from the log itself, before a filter runs and without truth.

Likelihoods of the fixes given dead reckoning, and of the DVL records given each other, are compared: the noise is the
maximum of likelihood and prior, and a sensor error exists if the evidence for it is strong (evidence.py).
"""
