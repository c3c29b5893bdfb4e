"""A link between two processes that can fail."""

import select
import socket
import struct
import threading


class Wire:
    """A TCP relay that can be cut: nothing passes, and neither side is told. Or reset: then both are."""

    def __init__(self, endpoint: str) -> None:
        self._to = ("127.0.0.1", int(endpoint.rpartition(":")[2]))
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._pairs: dict[socket.socket, socket.socket] = {}
        self._open = threading.Event()
        self._working = threading.Lock()
        self._open.set()
        self._over = False
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        self._open.clear()

    def reset(self) -> None:
        self.cut()
        with self._working:
            for end in self._pairs:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                end.close()
            self._pairs.clear()

    def heal(self) -> None:
        self._open.set()

    def close(self) -> None:
        self._over = True
        self._open.set()
        self._thread.join()
        for end in (self._server, *self._pairs):
            end.close()

    def _relay(self) -> None:
        while not self._over:
            self._open.wait()
            with self._working:
                for ready in select.select([self._server, *self._pairs], [], [], 0.05)[0]:
                    if not self._open.is_set():
                        break
                    if ready is self._server:
                        self._accept()
                    elif ready in self._pairs:
                        self._pass(ready)

    def _accept(self) -> None:
        near = self._server.accept()[0]
        try:
            far = socket.create_connection(self._to, 5.0)
        except OSError:
            near.close()
            return
        self._pairs.update({near: far, far: near})

    def _pass(self, ready: socket.socket) -> None:
        other = self._pairs[ready]
        try:
            if data := ready.recv(1 << 16):
                other.sendall(data)
                return
        except OSError:
            pass
        for end in (ready, other):
            self._pairs.pop(end, None)
            end.close()
