"""The definitions of IMC messages that lie beside a log, IMC.xml or IMC.xml.gz, and messages decoded by them.

Source: LSTS, Inter-Module Communication (github.com/LSTS/imc): headers, types and their serialization.
"""

import gzip
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from xml.etree import ElementTree

from usbldr.filters.errors import LogError, UsageError
from usbldr.io.file_access.open_file import opened
from usbldr.io.limits import RAISE, limit, original_of

FILES = ("IMC.xml", "IMC.xml.gz")
XML_BYTES = 1 << 21  # [bytes] of the definitions; those of IMC 5.4 are half a megabyte
NUMBERS = {f"{sign}int{8 * size}_t": code for size, codes in ((1, "bB"), (2, "hH"), (4, "iI"), (8, "qQ"))
           for sign, code in zip(("", "u"), codes, strict=True)} | {"fp32_t": "f", "fp64_t": "d"}  # fmt: skip
TEXTS = ("plaintext", "rawdata")  # a length of two bytes, and as many bytes


@dataclass(frozen=True, slots=True)
class Member:
    """A field of a message."""

    name: str
    kind: str  # "fp64_t"
    flags: Mapping[str, int]  # of a bit field: name of a bit -> mask


@dataclass(frozen=True, slots=True)
class Definition:
    """A message: its fields up to the first that is a message itself."""

    name: str
    members: Sequence[Member]

    @property
    def layout(self) -> str:
        """The layout of the module struct if all fields are numbers, else empty."""
        codes = [NUMBERS.get(member.kind, "") for member in self.members]
        return "<" + "".join(codes) if all(codes) else ""

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of fields, and those of flags behind theirs: "validity.VALID_POS"."""
        own = [m.name for m in self.members if m.kind != "rawdata"]
        return (*own, *(f"{m.name}.{flag}" for m in self.members for flag in m.flags))

    def values(self, payload: bytes, order: str) -> Iterator[tuple[str, float | str]]:
        """Yield the fields of a message; raise struct.error if it is too short."""
        at = 0
        for member in self.members:
            if member.kind in TEXTS:
                (length,) = struct.unpack_from(f"{order}H", payload, at)
                at += 2 + length
                if at > len(payload):
                    raise struct.error
                yield member.name, payload[at - length : at].decode(errors="replace")
            else:
                code = order + NUMBERS[member.kind]
                yield member.name, struct.unpack_from(code, payload, at)[0]
                at += struct.calcsize(code)


def definitions_beside(log: Path) -> Mapping[int, Definition]:
    """Return the definitions beside a log by number; raise UsageError without any, LogError if they are broken."""
    folder = original_of(log)[0].parent
    file = next((folder / name for name in FILES if (folder / name).is_file()), None)
    if file is None:
        text = (
            f"its messages are defined by {FILES[0]}, which is not beside it; copy it from where the log was recorded"
        )
        raise UsageError(text, path=log)
    try:
        with opened(file) as content:
            most = limit(XML_BYTES) + 1
            text = gzip.GzipFile(fileobj=content).read(most) if file.suffix == ".gz" else content.read(most)
        if len(text) > limit(XML_BYTES):
            raise LogError(f"is larger than {limit(XML_BYTES) >> 20} MB, too large for definitions; {RAISE}", path=file)
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_Builder()))
        return {int(one.get("id", "")): _definition(one) for one in root.iter("message") if one.get("id")}
    except (EOFError, OSError, ValueError, SyntaxError, zlib.error) as err:
        raise LogError(f"holds no definitions of IMC ({err})", path=file) from err


class _Builder(ElementTree.TreeBuilder):
    """Builds the elements of a text without entities of its own, which could multiply."""

    def doctype(self, *_: object) -> None:
        raise ValueError("it declares a document type")


def _definition(message: ElementTree.Element) -> Definition:
    def values(field: ElementTree.Element) -> Iterator[tuple[str, int]]:
        return ((value.get("abbrev", ""), int(value.get("id", ""), 0)) for value in field.iter("value"))

    members = (
        Member(
            field.get("abbrev", ""),
            field.get("type", ""),
            {name: bit for name, bit in values(field) if bit} if field.get("unit") == "Bitfield" else {},
        )
        for field in message.iter("field")
    )
    known = takewhile(lambda member: member.kind in TEXTS or member.kind in NUMBERS, members)
    return Definition(message.get("abbrev", ""), tuple(known))
