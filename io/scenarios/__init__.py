"""Scenarios as TOML files, those that are shipped, and the logs that are simulated from them."""
