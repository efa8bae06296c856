"""A file format, its message types and a filter for usbldr."""
