"""What the filters assume about the vehicle and its sensors::

    states       which states there are and where each stands in the vector: psi, u, v, r, x, y, then calibration states
    motion       x_k = f(x_{k-1}) + w: eq. (4) of the paper, as increments of a few rows
    sensors      z = h(x) + v for DVL, compass and position fixes, with Jacobians; one Measurement of k scalars
    quantities   how each number of the model is stated: key with unit, limits, the sensor error it belongs to
    noise        v as a mixture of Gaussian modes: the families and their modes
    sigma_points how mean and covariance pass through a function: linearised, cubature, unscented
    parameters   process noise, noise families, lever arms, start: what a run is given
    calibration  the sensor errors that can be states, with their units and signs at the border

A model is a StateFunction: predict (n, N) -> (k, N), jacobian, residual. Nothing here knows a filter, a log or a grid.
"""
