"""Columns of a time series as a message of Protocol Buffers, with their names."""

import re
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

_PACKAGE = "meanflock"


def message_class(title: str, columns: Sequence[pa.Field]) -> Any:
    """Class of messages with a field for each column; a list is a repeated field."""
    file = FileDescriptorProto(name=f"{_PACKAGE}/{title}.proto", package=_PACKAGE, syntax="proto3")
    message = file.message_type.add(name=title)
    for number, column in enumerate(columns, 1):
        is_list = pa.types.is_list(column.type)
        message.field.add(
            name=field_name(column.name),
            number=number,
            type=_kind(column.type.value_type if is_list else column.type),
            label=FieldDescriptorProto.LABEL_REPEATED if is_list else FieldDescriptorProto.LABEL_OPTIONAL,
        )
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{title}"))


def field_name(column: str) -> str:
    """The name of a column in ASCII, which these messages need: `φ` becomes `u03c6`."""
    return re.sub(r"[^A-Za-z0-9_]", lambda letter: f"u{ord(letter[0]):04x}", column)


def _kind(number: pa.DataType) -> Any:
    if number == pa.float32():
        return FieldDescriptorProto.TYPE_FLOAT
    if number == pa.float64():
        return FieldDescriptorProto.TYPE_DOUBLE
    return FieldDescriptorProto.TYPE_INT64 if number.bit_width == 64 else FieldDescriptorProto.TYPE_INT32
