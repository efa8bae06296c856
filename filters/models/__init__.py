"""What the filters assume about the vehicle and its sensors::

    states       names and rows of the states: psi, u, v, r, x, y, then calibration states
    motion       x_k = f(x_{k-1}) + w: eq. (4) of the paper, as increments of a few rows
    usual_motion velocity in a gap of the DVL, turn rate in one of the compass, learnt from the records so far
    sensors      z = h(x) + v for DVL, compass and position fixes, with Jacobians; one Measurement of k scalars
    quantities   key with unit and limits of each number of the model, and the sensor error that it belongs to
    noise        v as a mixture of Gaussian modes: the families and their modes
    sigma_points moments of a function of a Gaussian: linearised, cubature, unscented
    parameters   process noise, noise families, lever arms, start: the inputs of a run
    calibration  the sensor errors that can be states, with units and signs for users

A model is a StateFunction: predict (n, N) -> (k, N), jacobian, residual. This package imports no filter, log or grid.
"""
