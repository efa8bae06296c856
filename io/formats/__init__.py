"""One reader per file format, all behind usbldr.io.reader.Reader; detect.FORMATS lists them."""
