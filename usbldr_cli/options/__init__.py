"""Options that several commands share, each spelt once."""
