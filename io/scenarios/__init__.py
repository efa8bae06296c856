"""Scenarios as TOML files, those that are shipped, and the logs simulated from them."""
