"""usbldr.toml and baseline files: typed sections with units and limits, and edits that keep the author's comments."""
