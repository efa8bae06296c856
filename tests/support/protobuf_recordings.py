"""Types of protobuf that are defined at run time, by Google's own library."""

from collections.abc import Callable
from typing import Any

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass


def defined(file: FileDescriptorProto, imports_first: bool) -> tuple[FileDescriptorSet, Callable[[str], Any]]:
    """Return the definitions of a file that imports times, and a function from the name of a type to its class."""
    file.dependency.append("google/protobuf/timestamp.proto")
    stamps = FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool = DescriptorPool()
    for one in (stamps, file):
        pool.AddSerializedFile(one.SerializeToString())
    found = FileDescriptorSet(file=[stamps, file] if imports_first else [file, stamps])
    return found, lambda name: GetMessageClass(pool.FindMessageTypeByName(f"{file.package}.{name}"))
