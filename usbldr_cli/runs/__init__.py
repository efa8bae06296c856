"""Many runs at once: jobs in processes, the store of finished ones, statistics over seeds."""
