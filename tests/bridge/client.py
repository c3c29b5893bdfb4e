"""A client of MAVLink over UDP, with the parser and writer of pymavlink and nothing of ours."""

import socket
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from tests.polling import until

GROUND_STATION = 250  # its system id


class Client:
    """A socket and the messages that came to it."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**22)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self._parser = mavlink.MAVLink(None)
        self._writer = mavlink.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=190)
        self.port = self._socket.getsockname()[1]
        self.messages: list[Any] = []

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def receive(self) -> None:
        """Take all that has come, or wait a moment for something."""
        try:
            while True:
                self.messages += self._parser.parse_buffer(self._socket.recv(2**16)) or ()
                self._socket.settimeout(0.0)
        except (TimeoutError, BlockingIOError):
            self._socket.settimeout(0.05)

    def messages_of(self, kind: str, system: int | None = None) -> Iterator[Any]:
        """The messages of a kind so far, of one system or of all."""
        return (
            message
            for message in self.messages
            if message.get_type() == kind and system in (None, message.get_srcSystem())
        )

    def systems(self) -> set[int]:
        return {message.get_srcSystem() for message in self.messages_of("HEARTBEAT")}

    def until_found(self, uavs: int) -> None:
        def found() -> bool:
            self.receive()
            return len(self.systems()) >= uavs

        until(found, f"{uavs} vehicles", seen=self.systems)

    def send(self, port: int, message: Any) -> None:
        frame = message if isinstance(message, bytes) else message.pack(self._writer)
        self._socket.sendto(frame, ("127.0.0.1", port))


def heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)


def setpoint(system: int, north: float = 0.0, east: float = 0.0, *, frame: int = 1, mask: int = 0x0C3F) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED with an acceleration."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, north, east, 0.0, 0.0, 0.0
    )
