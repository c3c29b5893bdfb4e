"""A link between two processes that can fail."""

import socket
import struct
import threading
from contextlib import suppress

ABORT = struct.pack("ii", 1, 0)  # SO_LINGER: a close sends an RST


class Wire:
    """A TCP relay that can be cut: nothing passes, and neither side is told. Or reset: then both are."""

    def __init__(self, endpoint: str) -> None:
        self._to = ("127.0.0.1", int(endpoint.rpartition(":")[2]))
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        self._open = threading.Event()
        self._open.set()
        self.cut, self.heal = self._open.clear, self._open.set
        threading.Thread(target=self._accept, daemon=True).start()

    def reset(self) -> None:
        """Ends every connection, and lets none through until it is healed."""
        self.cut()
        for end in self._ends:
            with suppress(OSError):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
                end.shutdown(socket.SHUT_RD)  # wakes the thread that reads
                end.close()
        self._ends.clear()

    def close(self) -> None:
        self._server.close()
        self.reset()
        self.heal()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near = self._server.accept()[0]
                self._open.wait()
                try:
                    far = socket.create_connection(self._to, 5.0)
                except OSError:
                    near.close()
                    continue
                far.settimeout(None)
                self._ends += (near, far)
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass, args=ends, daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                self._open.wait()
                target.sendall(data)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
