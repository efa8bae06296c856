"""Threads of the linear algebra below NumPy. The arrays are small: more than one thread only wait for each other."""

import os

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment of a process that uses one; it is read when NumPy is imported."""


def use_one_thread() -> None:
    """Let this process use one thread, unless its environment says how many."""
    if not ONE_THREAD.keys() & os.environ.keys():
        os.environ.update(ONE_THREAD)
