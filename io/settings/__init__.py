"""usbldr.toml and baseline files: sections, limits, and edits that keep what the user wrote."""
