"""The filters: each turns a belief and the measurements of one step into the next belief.

A filter is a frozen value with three functions (protocol.Filter)::

    belief = filter.start(prior)
    belief = filter.step(belief, step, make_rng)
    estimate = filter.estimate(belief)

Beliefs are immutable, so a driver may keep them, go back and run forward again. Most filters compose four functions on
a bank of N Gaussians, means (n, N) and covariances (n, n, N)::

    predict(bank, motion, transform, t0, t1)   m- = f(m), P- = F P F' + Q
    project(bank, measurement, transform)      e = z - h(m-), H P- H', P- H'
    mode_update(bank, projection, noise)       which noise modes explain e: matched, gated, collapsed, or drawn
    update(bank, projection, R)                K = P- H' S^-1, m = m- + K e, P = P- - K S K'

``ekf``, ``ckf``, ``ukf`` differ in the transform alone; ``adf`` collapses the noise mixture; ``cpf`` and ``upf`` draw
a mode for each of N members. A new filter is one file here and one row in the catalogue (replay/methods.py).
"""
