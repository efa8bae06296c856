"""What the log itself settles about its sensors' errors and noise, before a filter runs and without any truth.

Likelihoods of the fixes given dead reckoning, and of the DVL records given each other, are compared between noise
models; states whose sigma the readings reduce are observable.
"""
