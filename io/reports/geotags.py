"""Positions in photos: GPS tags in a copy of a JPEG whose other bytes stay as they are, or an XMP sidecar.

The tags, as Pillow writes them, go behind what the EXIF block holds, so that every offset in it still holds, also those
within maker notes: Pillow encodes a picture anew, and libraries that write EXIF again lose such notes. Sources: EXIF
2.32 (CIPA DC-008), section 4; TIFF 6.0; XMP specification part 2.
"""

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from usbldr.filters.errors import UsageError
from usbldr.io.reports.run_directory import write_atomically
from usbldr.io.writing import writing

JPEGS = (".jpg", ".jpeg")
START, APP1, SCAN, HEAD = b"\xff\xd8", 0xE1, 0xDA, b"Exif\0\0"  # fixed: of JPEG files
GPS_POINTER, LONG = 0x8825, 4  # fixed: by TIFF and EXIF
MAX_SEGMENT = 65_533  # [bytes] fixed: the length of a JPEG segment has 16 bits and counts itself
PARTS = 10**6  # of a second of arc and of a metre: 0.03 mm on the ground, and finer than any depth


class Place(NamedTuple):
    """Where a photo was taken; NaN is unknown."""

    lat_deg: float
    lon_deg: float
    depth_m: float
    radius95_m: float


def write_geotags(folder: Path, photos: Mapping[Path, Place], force: bool) -> tuple[int, int]:
    """Write a copy with GPS tags, or else a sidecar NAME.jpg.xmp, of each photo into a folder; return how many of each.

    Raises UsageError if the photos are in this folder, or a file exists already and is not to be replaced.
    """
    if any(photo.parent.resolve() == folder.resolve() for photo in photos):
        raise UsageError(f"--geotag {folder}: the photos are there; name another folder for their copies")
    copies = 0
    with writing(folder, "choose another folder for --geotag"):
        folder.mkdir(parents=True, exist_ok=True)
        for photo, place in photos.items():
            tagged = tagged_jpeg(photo.read_bytes(), place) if photo.suffix.lower() in JPEGS else None
            file = folder / (f"{photo.name}.xmp" if tagged is None else photo.name)
            if file.exists() and not force:
                raise UsageError(f"{file} exists already: choose another --geotag, or --force to replace it")
            write_atomically(file, sidecar(place).encode() if tagged is None else tagged)
            copies += tagged is not None
    return copies, len(photos) - copies


def tagged_jpeg(content: bytes, place: Place) -> bytes | None:
    """Return a JPEG file with the place in its EXIF block; None if it has no such block, or one that is full."""
    at = len(START)
    while content[at : at + 1] == b"\xff" and at + 4 <= len(content) and content[at + 1] != SCAN:
        (length,) = struct.unpack_from(">H", content, at + 2)
        if content[at + 1] == APP1 and content[at + 4 : at + 4 + len(HEAD)] == HEAD:
            try:
                block = HEAD + _with_gps(content[at + 4 + len(HEAD) : at + 2 + length], place)
            except (struct.error, KeyError):  # no block of TIFF
                return None
            if len(block) > MAX_SEGMENT:
                return None
            return content[: at + 2] + struct.pack(">H", len(block) + 2) + block + content[at + 2 + length :]
        at += 2 + length
    return None


def _with_gps(tiff: bytes, place: Place) -> bytes:
    """Return a TIFF block with its first directory again at its end, there with GPS tags, which follow."""
    order = {b"II": "<", b"MM": ">"}[tiff[:2]]
    (first,) = struct.unpack_from(order + "I", tiff, 4)
    (count,) = struct.unpack_from(order + "H", tiff, first)
    end = first + 2 + 12 * count
    (following,) = struct.unpack_from(order + "I", tiff, end)
    entries = {tiff[at : at + 2]: tiff[at : at + 12] for at in range(first + 2, end, 12)}
    tag = struct.pack(order + "H", GPS_POINTER)
    made = tiff + b"\0" * (len(tiff) % 2)
    gps_at = len(made) + 2 + 12 * len({*entries, tag}) + 4
    entries[tag] = tag + struct.pack(order + "HII", LONG, 1, gps_at)
    ascending = sorted(entries, key=lambda one: struct.unpack(order + "H", one))
    directory = struct.pack(order + "H", len(entries)) + b"".join(entries[one] for one in ascending)
    header = tiff[:4] + struct.pack(order + "I", len(made))
    return header + made[8:] + directory + struct.pack(order + "I", following) + _gps_directory(tiff[:2], gps_at, place)


def _gps_directory(order: bytes, at: int, place: Place) -> bytes:
    """Return the directory of GPS tags that begins at an offset of its TIFF block, with its values behind it."""
    from PIL.TiffImagePlugin import IFDRational, ImageFileDirectory_v2

    def ratio(value: float) -> IFDRational:
        return IFDRational(round(value * PARTS), PARTS)

    def angle(degrees: float) -> tuple[IFDRational, ...]:
        minutes, seconds = divmod(round(abs(degrees) * 3600 * PARTS), 60 * PARTS)  # whole, so that no part is 60
        return IFDRational(minutes // 60), IFDRational(minutes % 60), IFDRational(seconds, PARTS)

    tags: dict[int, object] = {0: b"\2\3\0\0", 18: "WGS-84"}  # version 2.3
    tags |= {1: "S" if place.lat_deg < 0 else "N", 2: angle(place.lat_deg)}
    tags |= {3: "W" if place.lon_deg < 0 else "E", 4: angle(place.lon_deg)}
    if math.isfinite(place.depth_m):
        tags |= {5: bytes([place.depth_m > 0]), 6: ratio(abs(place.depth_m))}  # 1: below sea level
    if math.isfinite(place.radius95_m):
        tags[31] = ratio(place.radius95_m)  # GPSHPositioningError
    directory = ImageFileDirectory_v2(prefix=order)
    for tag, value in tags.items():
        directory[tag] = value
    return directory.tobytes(at)


def sidecar(place: Place) -> str:
    """Return the place as an XMP sidecar: degrees and minutes, and metres as ratios."""

    def angle(degrees: float, positive: str, negative: str) -> str:
        whole, minutes = divmod(round(abs(degrees) * 60 * 10**7), 60 * 10**7)
        return f"{whole},{minutes / 10**7:.7f}{negative if degrees < 0 else positive}"

    tags = {
        "GPSVersionID": "2.3.0.0",
        "GPSMapDatum": "WGS-84",
        "GPSLatitude": angle(place.lat_deg, "N", "S"),
        "GPSLongitude": angle(place.lon_deg, "E", "W"),
    }
    if math.isfinite(place.depth_m):
        tags["GPSAltitudeRef"] = str(int(place.depth_m > 0))
        tags["GPSAltitude"] = f"{round(abs(place.depth_m) * 1000)}/1000"
    if math.isfinite(place.radius95_m):
        tags["GPSHPositioningError"] = f"{round(place.radius95_m * 1000)}/1000"
    held = "".join(f'\n    exif:{name}="{value}"' for name, value in tags.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
        f'  <rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/"{held}/>\n'
        ' </rdf:RDF>\n</x:xmpmeta>\n<?xpacket end="w"?>\n'
    )
