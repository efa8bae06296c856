"""One reader for each file format, all behind usbldr.io.reader.Reader."""
