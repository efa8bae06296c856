"""Readers of the files that instruments, autopilots and vehicles write themselves."""
