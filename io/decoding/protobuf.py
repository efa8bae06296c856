"""Protocol buffers to values by field path, by the descriptors that an MCAP file carries (a FileDescriptorSet).

Google's library reads the descriptors and decodes. A field that is not set is NaN if the definition marks
that (`optional`, or inside a message that is not set), else proto3's zero.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

from usbldr.io.decoding.columns import DefinitionError, Extractor, arrays_within, extractor, limited
from usbldr.io.reader import listed_field

TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
LEVELS = 8  # of messages in messages; definitions may be recursive


class ProtobufDecoder:
    """The messages of one type."""

    def __init__(self, name: str, definition: bytes) -> None:
        """Read the descriptors; raise DefinitionError if that fails."""
        try:
            pool = _pool(FileDescriptorSet.FromString(definition))
            descriptor = pool.FindMessageTypeByName(name)
        except (DecodeError, TypeError, KeyError, ValueError, RecursionError) as err:
            raise DefinitionError(" ".join(str(err).split())[:80]) from err
        self._class = GetMessageClass(descriptor)
        self._kinds = limited(_leaves(descriptor))
        self.fields = tuple(self._kinds)
        repeated = {path for path, field in self._kinds.items() if field.is_repeated}
        self.arrays = arrays_within(self.fields) | repeated

    def extractor(self, paths: Sequence[str]) -> Extractor:
        """Return a function from a message's bytes to the values at the paths; to None if the bytes do not match."""
        getters = [_getter(path, self._kinds[listed_field(path, self._kinds, self.arrays) or path]) for path in paths]
        return extractor(self._class.FromString, getters, (DecodeError,))


def _pool(files: FileDescriptorSet) -> DescriptorPool:
    """Return the types of the files, each file after those that it imports."""
    pool, waiting = DescriptorPool(), {file.name: file for file in files.file}

    def add(file: FileDescriptorProto) -> None:
        for name in file.dependency:
            if name in waiting:
                add(waiting.pop(name))
        pool.AddSerializedFile(file.SerializeToString())

    while waiting:
        add(waiting.pop(next(iter(waiting))))
    return pool


def _leaves(descriptor: Descriptor, prefix: str = "", level: int = 0) -> Iterator[tuple[str, FieldDescriptor | None]]:
    """Yield the fields below a message by path, None for a message; of repeated messages those of the first."""
    for field in descriptor.fields:
        path, inner = prefix + field.name, field.message_type
        if inner is None:
            if field.type != FieldDescriptor.TYPE_BYTES:
                yield path, field
        elif inner.full_name in TIMES and not field.is_repeated:
            yield path, field
        elif level < LEVELS and not inner.GetOptions().map_entry:
            yield path, None
            yield from _leaves(inner, f"{path}.0." if field.is_repeated else f"{path}.", level + 1)


def _getter(path: str, field: FieldDescriptor) -> Callable[[Message], Any]:
    """Return a function from a message to the value at the path; times become integer nanoseconds."""
    parts = path.split(".")
    is_text, is_time = field.type == FieldDescriptor.TYPE_STRING, field.message_type is not None
    unset: Any = "" if is_text else 0 if is_time else float("nan")

    def get(message: Any) -> Any:
        for part in parts:
            if part.isdecimal():
                if int(part) >= len(message):
                    return unset
                message = message[int(part)]
            else:
                known = message.DESCRIPTOR.fields_by_name[part]
                if known.has_presence and not message.HasField(part):
                    return unset
                message = getattr(message, part)
        return message.seconds * 1_000_000_000 + message.nanos if is_time else message

    return get
