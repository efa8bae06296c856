"""Many runs at once: one run scored, jobs, the store of finished ones, statistics over seeds."""
