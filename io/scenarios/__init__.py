"""Scenarios as TOML files, the shipped ones among them, and the logs simulated from them."""
