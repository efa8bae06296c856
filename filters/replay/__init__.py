"""A Timeline through a filter: steps of measurements, late fixes, the start, and the run itself."""
