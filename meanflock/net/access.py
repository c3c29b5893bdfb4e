"""Identity of a process on the network, addresses at which processes listen, and the access rules of the router.

A process shows a certificate whose common name is the node's name. The router has an access-control list with default
deny: it matches the name on the certificate of each link, and only the holder of the key can show that certificate. The
router's own session, the world's, is trusted and not filtered.
"""

import socket
from pathlib import Path
from typing import Any, NamedTuple

from meanflock.net import keys
from meanflock.swarm.errors import BadInput

WORLD = "world"
LEADER = "leader"
STATION = "station"
OBSERVER = "observer"

Rule = tuple[str, list[str], list[str]]  # direction as the router sees it, messages, keys


class Identity(NamedTuple):
    """The name of a process and the folder of its certificate, as `meanflock certs init` makes it."""

    folder: Path
    name: str

    @property
    def authority(self) -> Path:
        """Path of the certificate that signs all others."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """Path of the certificate; its common name is `name`."""
        return self.folder / f"{self.name}.pem"

    @property
    def key(self) -> Path:
        """Path of the private key."""
        return self.folder / f"{self.name}.key"

    def check(self) -> "Identity":
        """`self`, if the files exist, can be read and belong together. The other side checks the expiry.

        Raises:
            BadInput: something is wrong; the message names the file.
        """
        import ssl  # only here: a swarm without certificates does not load it

        remedy = "`meanflock certs init DIR --uavs N` makes them, `meanflock doctor --tls DIR` checks them"
        for path in (self.authority, self.certificate, self.key):
            try:
                path.open("rb").close()
            except OSError as error:
                raise BadInput(f"{path}: {error.strerror}; {remedy}") from error
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            context.load_verify_locations(self.authority)
        except ssl.SSLError as error:
            raise BadInput(f"{self.authority}: no certificate in it; {remedy}") from error
        try:
            context.load_cert_chain(self.certificate, self.key)
        except ssl.SSLError as error:
            raise BadInput(f"{self.certificate}: does not fit {self.key}; {remedy}") from error
        return self


def only_agent(folder: Path) -> int:
    """The UAV of the one agent whose key is in `folder`.

    Raises:
        BadInput: there is none, or more than one.
    """
    found = sorted(path.stem for path in folder.glob("agent-*.key"))
    if len(found) == 1 and (number := found[0].removeprefix("agent-")).isdigit():
        return int(number)
    keys_found = f"{len(found)} keys of agents" if found else "no key of an agent"
    raise BadInput(f"{folder}: {keys_found}; with --tls name the agent's UAV: --uav K")


def rules(run: str, uavs: int, uavs_per_process: int) -> dict[str, Any]:
    """Zenoh's `access_control` for a run: each agent, the leader and the station may use their own keys only."""
    rules_of_node = {LEADER: _node(run, LEADER, LEADER), STATION: _station(run), OBSERVER: _observer(run)}
    for uav in range(0, uavs, uavs_per_process):
        name = keys.requested_name("agent", uav)
        rules_of_node[name] = _node(run, "agent", name)
    numbered = {
        name: [
            {"id": f"{name}/{number}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": under}
            for number, (flow, messages, under) in enumerate(allowed)
        ]
        for name, allowed in rules_of_node.items()
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for allowed in numbered.values() for rule in allowed],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in numbered],
        "policies": [
            {"rules": [rule["id"] for rule in allowed], "subjects": [name]} for name, allowed in numbered.items()
        ],
    }


def _node(run: str, role: str, name: str) -> list[Rule]:
    return [
        *_member(run, role, name),
        ("ingress", ["put"], [keys.act(run, life) for life in _lives(name)]),
        ("ingress", ["declare_subscriber"], [keys.sense(run, life) for life in _lives(name)]),
        ("egress", ["put"], [keys.sense(run, life) for life in _lives(name)]),
        # Without the world's subscription, the node's publisher would match nobody and send nothing.
        ("egress", ["declare_subscriber"], [keys.act(run, "*")]),
    ]


def _station(run: str) -> list[Rule]:
    return [
        *_member(run, STATION, STATION),
        ("ingress", ["put"], [keys.received(run)]),
        ("ingress", ["declare_subscriber"], [keys.telemetry(run)]),
        ("egress", ["put"], [keys.telemetry(run)]),
        ("egress", ["declare_subscriber"], [keys.received(run)]),
    ]


def _observer(run: str) -> list[Rule]:
    """Rules of an observer: it may find the flight, ask what is flown, and read. It may put nothing."""
    return [
        *_asking(run, OBSERVER),
        ("ingress", ["liveliness_query", "declare_liveliness_subscriber"], [keys.alive("*", WORLD, WORLD)]),
        ("egress", ["liveliness_token"], [keys.alive(run, WORLD, WORLD)]),
        ("ingress", ["declare_subscriber"], [keys.observed(run)]),
        ("egress", ["put"], [keys.observed(run)]),
    ]


def _member(run: str, role: str, name: str) -> list[Rule]:
    """Rules of every node: it may ask to join and be alive under its own name, and watch the world's token."""
    world = keys.alive(run, WORLD, WORLD)
    return [
        *_asking(run, name),
        ("ingress", ["liveliness_token"], [keys.alive(run, role, life) for life in _lives(name)]),
        ("ingress", ["liveliness_query", "declare_liveliness_subscriber"], [world]),
        ("egress", ["liveliness_token"], [world]),
    ]


def _asking(run: str, name: str) -> list[Rule]:
    return [
        ("ingress", ["query"], [keys.join(run, name)]),
        ("egress", ["reply"], [keys.join(run, name)]),
        ("egress", ["declare_queryable"], [keys.join(run)]),
    ]


def _lives(name: str) -> tuple[str, str]:
    """Names of a node: after a rejoin its name ends in a number: agent-3, agent-3.2, agent-3.3 …"""
    return name, f"{name}.$*"


NOBODY = rules("-", 0, 1)  # no run has that name


LOOPBACK = "127.0.0.1"
DEFAULT_ENDPOINT = f"tcp/{LOOPBACK}:7447"
_UNIX = "unixsock-stream"  # a socket in the file system, as Zenoh calls it
_PROTOCOLS = ("tcp", "tls", _UNIX)  # that deliver all that is sent, in order


class Address(NamedTuple):
    """A host and a port; port 0 is any free one."""

    host: str
    port: int

    @classmethod
    def read(cls, text: str) -> "Address | None":
        """The address in a text `[HOST:]PORT`; None if the text is written otherwise."""
        host, colon, port = text.rpartition(":")
        if not (port.isascii() and port.isdigit() and int(port) < 2**16) or (colon and not host):
            return None
        return cls(host.strip("[]") or LOOPBACK, int(port))

    @classmethod
    def parse(cls, flag: str, text: str) -> "Address":
        """The address in a text `[HOST:]PORT` that was given to `flag`.

        Raises:
            BadInput: the text is written otherwise.
        """
        if (address := cls.read(text)) is None:
            raise BadInput(f"{flag} {text}: write it as PORT or HOST:PORT, for example {flag}={LOOPBACK}:9464")
        return address

    @property
    def _family(self) -> socket.AddressFamily:
        return socket.AF_INET6 if ":" in self.host else socket.AF_INET

    def listen(self) -> socket.socket:
        """A socket that listens there; raises OSError if none can."""
        return socket.create_server(self, family=self._family)

    def bind(self) -> socket.socket:
        """A socket that gets the datagrams sent there; raises OSError if none can."""
        link = socket.socket(self._family, socket.SOCK_DGRAM)
        try:
            link.bind(self)
        except OSError:
            link.close()
            raise
        return link

    def free(self, flag: str, *, datagrams: bool = False) -> "Address":
        """This address if no process listens there, or gets its `datagrams`; port 0 becomes a free one.

        Raises:
            BadInput: a process listens there, or the host is not this machine.
        """
        try:
            with self.bind() if datagrams else self.listen() as server:
                return Address(self.host, server.getsockname()[1])
        except OSError as error:
            raise self.refused(flag, error) from error

    def refused(self, flag: str, error: OSError) -> BadInput:
        """The error for an address at which no process can listen."""
        reason = str(error.strerror).partition(" (while ")[0]  # the text has the address already
        return BadInput(f"{flag} {self}: {reason}; choose a free port of this machine, or 0 for any")

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class _Unix(NamedTuple):
    """The path of a socket of this machine; the methods of `Address` that an endpoint needs."""

    path: str

    def free(self, flag: str) -> "_Unix":
        """This path, if no file is there.

        Raises:
            BadInput: a socket cannot be made there.
        """
        try:
            with socket.socket(socket.AF_UNIX) as server:
                server.bind(self.path)
            Path(self.path).unlink()
        except OSError as error:
            raise BadInput(f"{flag} {self}: {error.strerror or error}; choose a free path") from error
        return self

    def __str__(self) -> str:
        return self.path


def secured(endpoint: str, identity: Identity | None) -> str:
    """`endpoint`, with `tls/` in place of `tcp/` for a process with an identity.

    Raises:
        BadInput: the endpoint is malformed, or its protocol does not fit.
    """
    protocol, address = _parts(endpoint)
    if identity is None:
        if protocol == "tls":
            raise BadInput(f"endpoint {endpoint}: needs certificates, name their folder: --tls DIR")
        return endpoint
    if protocol == _UNIX:
        raise BadInput(f"endpoint {endpoint}: with --tls it must be tls/HOST:PORT")
    return f"tls/{address}"


def connectable(endpoint: str, identity: Identity | None) -> str:
    """The `secured` endpoint of a process that connects to it.

    Raises:
        BadInput: also if it has no port, because only a process that listens can take any free one.
    """
    _, address = _parts(endpoint)
    if isinstance(address, Address) and not address.port:
        raise BadInput(f"endpoint {endpoint}: write the port at which the world listens; it says which it took")
    return secured(endpoint, identity)


def free(endpoint: str) -> str:
    """An endpoint at which a process can listen; port 0 becomes a free one. Zenoh's error would not name the port.

    Raises:
        BadInput: no process can listen there.
    """
    protocol, address = _parts(endpoint)
    return f"{protocol}/{address.free('endpoint')}"


def _parts(endpoint: str) -> tuple[str, Address | _Unix]:
    """Protocol and address of an endpoint.

    Raises:
        BadInput: the endpoint is malformed, or its protocol may lose messages or is unknown.
    """
    protocol, slash, text = endpoint.partition("/")
    if slash and protocol not in _PROTOCOLS:
        raise BadInput(
            f"endpoint {endpoint}: the protocol must be one of {', '.join(_PROTOCOLS)}; for example {DEFAULT_ENDPOINT}"
        )
    if protocol == _UNIX and text:
        return protocol, _Unix(text)
    if ":" not in text or (address := Address.read(text)) is None:
        raise BadInput(f"endpoint {endpoint}: write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    return protocol, address
