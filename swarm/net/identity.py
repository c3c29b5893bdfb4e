"""Who a process is on the network: the certificate it shows, and the authority whose certificates it believes."""

from pathlib import Path
from typing import NamedTuple

from meanflock.swarm.errors import BadInput

WORLD, LEADER, STATION = "world", "leader", "station"


class Identity(NamedTuple):
    """A name and the folder its certificate is in, as `meanflock certs init` makes it."""

    folder: Path
    name: str

    @property
    def authority(self) -> Path:
        """The certificate that signs all others."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """What others see; its common name is `name`."""
        return self.folder / f"{self.name}.pem"

    @property
    def key(self) -> Path:
        """What nobody else sees."""
        return self.folder / f"{self.name}.key"

    def check(self) -> "Identity":
        """`self`, if the files are there, can be read and belong together. Expiry is the other side's to check.

        Raises:
            BadInput: something is amiss; the message names the file.
        """
        import ssl  # only here: a swarm without certificates does not load it

        mend = "`meanflock certs init DIR --uavs N` makes them, `meanflock doctor --tls DIR` looks at them"
        for path in (self.authority, self.certificate, self.key):
            try:
                path.open("rb").close()
            except OSError as error:
                raise BadInput(f"{path}: {error.strerror}; {mend}") from error
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            context.load_verify_locations(self.authority)
        except ssl.SSLError as error:
            raise BadInput(f"{self.authority}: no certificate in it; {mend}") from error
        try:
            context.load_cert_chain(self.certificate, self.key)
        except ssl.SSLError as error:
            raise BadInput(f"{self.certificate}: does not fit {self.key}; {mend}") from error
        return self


def only_agent(folder: Path) -> int:
    """The UAV of the one agent whose key is in `folder`.

    Raises:
        BadInput: there is none, or more than one.
    """
    found = sorted(path.stem for path in folder.glob("agent-*.key"))
    if len(found) == 1 and (number := found[0].removeprefix("agent-")).isdigit():
        return int(number)
    what = f"{len(found)} keys of agents" if found else "no key of an agent"
    raise BadInput(f"{folder}: {what}; with --tls an agent says which UAV it is: --uav K")
