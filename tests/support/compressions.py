"""What compresses files, by their endings; the libraries owe nothing to usbldr."""

import bz2
import gzip
import lzma
from collections.abc import Callable, Mapping

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard

PACK: Mapping[str, Callable[[bytes], bytes]] = {
    "zst": lambda data: zstandard.ZstdCompressor(write_checksum=True).compress(data),
    "zstd": zstandard.compress,
    "gz": gzip.compress,
    "bz2": bz2.compress,
    "xz": lzma.compress,
    "lz4": lz4.frame.compress,
}
