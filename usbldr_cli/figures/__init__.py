"""Figures of a run, a comparison, a drill and a check; matplotlib is imported in this room alone."""

import contextlib
import sys

with contextlib.chdir(sys.prefix):  # matplotlib reads settings from a file of the current folder when it is imported
    import matplotlib as matplotlib
