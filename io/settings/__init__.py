"""usbldr.toml and baseline files: typed sections with units and limits; edits preserve the author's comments."""
