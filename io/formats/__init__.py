"""The format of a log, recognised by its content; folders, compressed files, and several recordings in one file."""
