"""Zenoh's own protocol, as far as an attacker needs it who does without Zenoh's library and its good manners."""

import os
import socket
import ssl
import struct
from pathlib import Path

_INIT, _OPEN, _FRAME, _FRAGMENT = 0x01, 0x02, 0x05, 0x06  # transport messages
_ACK, _SIZES, _RELIABLE, _MORE, _EXTENDED = 0x20, 0x40, 0x20, 0x40, 0x80  # flags
_VERSION, _CLIENT, _RESOLUTION = 9, 2, 0b1010
_INTEREST, _CURRENT_FUTURE = 0x19, 0x60  # a network message, its mode
_KEYS_NAMED = 0x01 | 0x10 | 0x20  # interest in keys, restricted to one that is spelt out


def number(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    spelt = bytearray()
    while value >= 0x80:
        spelt.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*spelt, value])


def fragments(reliable: bool, start: int, count: int) -> bytes:
    """Batches of one fragment each, of one byte, of a message of which more is to come."""
    head = bytes([_FRAGMENT | _MORE | (_RELIABLE if reliable else 0)])
    return b"".join(_batch(head + number(start + k) + b"\0") for k in range(count))


def interests(start: int, count: int, length: int) -> bytes:
    """Batches of one declaration each: that this session wants to know of a key, which nobody else has."""
    batches = []
    for k in range(start, start + count):
        key = f"{k}/".encode().ljust(length, b"x")
        declared = bytes([_INTEREST | _CURRENT_FUTURE]) + number(k + 1) + bytes([_KEYS_NAMED])
        declared += number(0) + number(len(key)) + key
        batches.append(_batch(bytes([_FRAME | _RELIABLE]) + number(k) + declared))
    return b"".join(batches)


def _batch(content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + content


class Session:
    """A client's session over TLS; whatever is sent after its handshake is the caller's."""

    def __init__(self, endpoint: str, folder: Path, name: str, priorities: bool = False) -> None:
        """`priorities`: asks for a channel a priority. Raises OSError where it is not let in."""
        host, _, port = endpoint.partition("/")[2].rpartition(":")
        context = ssl.create_default_context(cafile=folder / "ca.pem")
        context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
        plain = socket.create_connection((host, int(port)), 10.0)
        self._link = context.wrap_socket(plain, server_hostname=host)
        identity = os.urandom(8)
        init = bytes([_INIT | _SIZES | (_EXTENDED if priorities else 0), _VERSION, len(identity) - 1 << 4 | _CLIENT])
        init += identity + bytes([_RESOLUTION]) + struct.pack("<H", 2**16 - 1) + (b"\x01" if priorities else b"")
        self.send(_batch(init))
        answer = self._receive()
        at = 3 + (answer[2] >> 4) + 1
        if answer[0] & _SIZES:
            self.batch_bytes = struct.unpack_from("<H", answer, at + 1)[0]
            at += 3
        size, at = self._number(answer, at)
        cookie = answer[at : at + size]
        self.priorities = bool(answer[0] & _EXTENDED) and answer[at + size] & 0x1F == 0x01
        self.send(_batch(bytes([_OPEN]) + number(600_000) + number(0) + number(len(cookie)) + cookie))
        opened = self._receive()
        assert opened[0] & 0x1F == _OPEN, opened
        assert opened[0] & _ACK, opened

    def send(self, raw: bytes) -> None:
        """Raises OSError where the link is gone."""
        self._link.sendall(raw)

    def close(self) -> None:
        """Hangs up."""
        self._link.close()

    def _receive(self) -> bytes:
        return self._exactly(struct.unpack("<H", self._exactly(2))[0])

    def _exactly(self, size: int) -> bytes:
        read = b""
        while len(read) < size:
            if not (more := self._link.recv(size - len(read))):
                raise ConnectionResetError("the other side hung up")
            read += more
        return read

    @staticmethod
    def _number(raw: bytes, at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (raw[at] & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if raw[at - 1] < 0x80:
                return value, at
