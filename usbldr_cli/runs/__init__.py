"""Many runs at once: jobs in processes, the store of finished jobs, statistics over seeds."""
