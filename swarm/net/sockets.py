"""The sockets of this process: Zenoh opens them, and has no call that tells of one or ends it."""

import fcntl
import ipaddress
import os
import socket
import stat
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress

_FOLDERS = ("/proc/self/fd", "/dev/fd")  # Linux; other systems
_RECEIVED_AT = 128  # bytes_received in Linux' struct tcp_info, since 4.1
_FIONREAD = 0x541B

Address = tuple[str, int]  # host and port


def shut_down(locator: str) -> bool:
    """Shuts down the socket of this process whose other end is at `locator`; whether there was one."""
    for link in _with_peer(locator):
        with suppress(OSError):
            link.shutdown(socket.SHUT_RDWR)
            _discard(link)
            return True
    return False


def close_without_waiting(locator: str) -> None:
    """Lets the socket of this process whose other end is at `locator` close at once; the system sends what is left.

    Zenoh's sockets wait for up to ten seconds when they are closed before the other end has taken everything, and the
    router's only thread waits with them.
    """
    for link in _with_peer(locator):
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))


def _with_peer(locator: str) -> Iterator[socket.socket]:
    """The socket of this process whose other end is at `locator`, if there is one; only until the iterator goes on."""
    wanted = address_of(locator)
    for _, link in open_sockets() if wanted is not None else ():
        if peer_of(link) == wanted:
            yield link
            return


def _discard(link: socket.socket) -> None:
    """Throws away what came and waits to be read; it would be, though the socket is shut down."""
    with suppress(OSError):
        while link.recv(2**16, socket.MSG_DONTWAIT):
            pass


def open_sockets() -> Iterator[tuple[int, socket.socket]]:
    """The sockets of this process by the numbers of their files; each only until the next one."""
    folder = next((path for path in _FOLDERS if os.path.isdir(path)), None)
    for number in sorted(map(int, os.listdir(folder) if folder else ()), reverse=True):  # the newest first, as a rule
        try:
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue
            copy = os.dup(number)
        except OSError:  # closed meanwhile
            continue
        with socket.socket(fileno=copy) as link:
            yield number, link


def peer_of(link: socket.socket) -> Address | None:
    """Host and port of the other end of a socket; None where it has none."""
    try:
        return _normal(link.getpeername())
    except OSError:
        return None


def address_of(locator: str) -> Address | None:
    """Host and port in tls/HOST:PORT; None for another text."""
    host, _, port = locator.partition("/")[2].rpartition(":")
    try:
        return _normal((host.strip("[]"), int(port)))
    except ValueError:
        return None


def _normal(address: object) -> Address | None:
    """Host and port, an IPv4 address in IPv6 as itself; None for what is no address on a network."""
    if not isinstance(address, tuple):
        return None
    host = ipaddress.ip_address(address[0].partition("%")[0])
    mapped = host.ipv4_mapped if isinstance(host, ipaddress.IPv6Address) else None
    return str(mapped or host), address[1]


def can_count() -> bool:
    """Whether this system says how many bytes came over a socket."""
    return sys.platform == "linux" and hasattr(socket, "TCP_INFO")


def received(link: socket.socket) -> int:
    """Bytes that came over a socket so far and were taken from it."""
    info = link.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RECEIVED_AT + 8)
    waiting = struct.unpack("i", fcntl.ioctl(link, _FIONREAD, bytes(4)))[0]
    return int(struct.unpack_from("<Q", info, _RECEIVED_AT)[0]) - int(waiting)
