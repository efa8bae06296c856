"""Open files, look at their bytes in pieces, and decompress them: what every format uses."""
