"""Pictures of a run and of a comparison; matplotlib is imported here alone."""
