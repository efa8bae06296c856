"""Drills: a log with faults put into its records, to see what filters make of them."""
