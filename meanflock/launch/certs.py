"""Certificates of a swarm: an authority and a certificate for every node, made with the library `cryptography`.

DIR/ca.pem, ca.key; world, leader, station, observer and agent-0 … agent-(N-1), each as .pem and .key. The common name
is the node's name, which the router's access-control list uses. Only the world's certificate is valid for a server,
and the others are valid for clients only, so a node cannot impersonate the world.
"""

import ipaddress
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from meanflock.net import keys
from meanflock.net.access import LEADER, OBSERVER, STATION, WORLD, Identity
from meanflock.swarm.errors import BadInput
from meanflock.swarm.paths import read

HOSTS = ("127.0.0.1", "::1", "localhost", "worldsim")  # names of the world: this machine, or its container
DAYS = 90
_HOST = re.compile(r"(\*\.)?[A-Za-z0-9_][A-Za-z0-9_-]{0,62}(\.[A-Za-z0-9_][A-Za-z0-9_-]{0,62})*")
COMPOSE = "compose.yaml"  # JSON, which is YAML too
SOON_DAYS = 7
IMAGE_USER = 1000  # user of the containers if root made the keys; as in the Dockerfile

_SKEW = timedelta(minutes=5)  # tolerated difference of two clocks


@dataclass(frozen=True)
class Problem:
    """Reason for which a certificate would be refused."""

    path: Path
    reason: str
    remedy: str


def names(uavs: int, uavs_per_process: int = 1) -> list[str]:
    """Names of all nodes that need a certificate; a flight needs no observer."""
    return [WORLD, LEADER, STATION, *(keys.requested_name("agent", uav) for uav in range(0, uavs, uavs_per_process))]


def init(folder: Path, uavs: int, days: int = DAYS, hosts: Sequence[str] = ()) -> list[Path]:
    """Makes an authority and a certificate for every node, and returns the files.

    `hosts`: further names or addresses of the world.

    Raises:
        BadInput: `folder` has something in it, or cannot be written, or a host has no name. Nothing was written.
    """
    for host in hosts:
        if not _HOST.fullmatch(host) and not _is_address(host):
            raise BadInput(f"--host {host}: no name or address of a machine; write it as base.example.org or 10.0.0.1")
    new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise BadInput(f"{folder}: not empty, and keys are not overwritten; name a new folder or remove this one")
        folder.chmod(0o700)
        authority = Authority(f"meanflock {os.urandom(4).hex()}", days)
        written = authority.write(folder)
        for name in (*names(uavs), OBSERVER):
            issued = authority.issue(folder, name, days, (*HOSTS, *hosts) if name == WORLD else ())
            if os.getuid() == 0:  # so that containers need not run as root; others cannot enter the folder
                _give(issued, IMAGE_USER)
            written += issued
        written.append(folder / COMPOSE)
        owner = (folder / f"{WORLD}.key").stat()
        overlay = compose(folder.resolve(), uavs, f"{owner.st_uid}:{owner.st_gid}")
        written[-1].write_text(json.dumps(overlay, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        _empty(folder, new)
        raise BadInput(f"{error.filename or folder}: {error.strerror}; name a folder that can be written") from error
    return written


def _empty(folder: Path, new: bool) -> None:
    """Delete an incomplete set of certificates, and the folder if it is new."""
    with suppress(OSError):
        for path in folder.iterdir():
            path.unlink()
        if new:
            folder.rmdir()


def compose(folder: Path, uavs: int, user: str) -> dict[str, Any]:
    """Overlay for docker-compose.yml with the profile `secure`, in which each container gets its own key only.

    `user`: uid:gid of the owner of the keys, as which all containers run.
    """

    def mount(file: str) -> dict[str, Any]:
        where = {"source": str(folder / file), "target": f"/certs/{file}", "read_only": True}
        must = {"create_host_path": False}  # so that a missing key is an error
        return {"type": "bind", **where, "bind": must}

    def service(name: str, **more: Any) -> dict[str, Any]:
        return {
            "user": user,
            "environment": {"MEANFLOCK_TLS": "/certs", **more.pop("environment", {})},
            "volumes": [mount(file) for file in ("ca.pem", f"{name}.pem", f"{name}.key")],
            **more,
        }

    return {
        "services": {
            "worldsim": service(WORLD, environment={"MEANFLOCK_SET": f"uavs={uavs} ${{MEANFLOCK_SET:-}}"}),
            "leader": service(LEADER),
            "groundstation": service(STATION),
            "runs": {"environment": {"RUNS_OWNER": user}},
            "agent": {"deploy": {"replicas": 0}},  # the world refuses agents without a name
            **{
                name: service(
                    name,
                    extends={"file": "docker-compose.yml", "service": "agent"},
                    profiles=["secure"],
                    deploy={"replicas": 1},
                )
                for name in names(uavs)
                if name not in (WORLD, LEADER, STATION)
            },
        }
    }


class Authority:
    """Certificate authority, which signs all certificates."""

    def __init__(self, name: str, days: float = DAYS) -> None:
        """Makes a new key and a self-signed certificate, valid for `days`."""
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = _common_name(name)
        usage = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
        self._certificate = (
            self._valid(days)
            .subject_name(self._name)
            .public_key(self._key.public_key())
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )

    def write(self, folder: Path) -> list[Path]:
        """Write ca.pem and ca.key."""
        return _write(folder, "ca", self._certificate, self._key)

    def issue(self, folder: Path, name: str, days: float = DAYS, hosts: Sequence[str] = ()) -> list[Path]:
        """Issue a certificate and a key for `name`: for a server at `hosts`, or for a client without hosts.

        Negative `days`: the certificate expired so long ago.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        purpose = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
        usage = x509.KeyUsage(True, False, False, False, False, False, False, False, False)
        certificate = (
            self._valid(days)
            .subject_name(_common_name(name))
            .public_key(key.public_key())
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
            .add_extension(
                x509.SubjectAlternativeName([_alternative(host) for host in hosts or (name,)]), critical=False
            )
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        return _write(folder, name, certificate, key)

    def _valid(self, days: float) -> x509.CertificateBuilder:
        end = datetime.now(UTC) + timedelta(days=days)
        begin = min(datetime.now(UTC), end) - _SKEW
        return (
            x509.CertificateBuilder()
            .issuer_name(self._name)
            .serial_number(x509.random_serial_number())
            .not_valid_before(begin)
            .not_valid_after(end)
        )


def check(folder: Path, uavs: int, uavs_per_process: int) -> None:
    """Check that a swarm of that size can fly with the certificates in `folder`.

    Raises:
        BadInput: it cannot; the message names the first invalid file.
    """
    for problem in problems(folder, names(uavs, uavs_per_process)):
        raise BadInput(f"{problem.path}: {problem.reason}; {problem.remedy}")


def problems(folder: Path, wanted: Sequence[str], at: datetime | None = None) -> Iterator[Problem]:
    """Problems of the certificates in `folder`, at a time (default: now)."""
    at = at or datetime.now(UTC)
    again = "make new ones: meanflock certs init DIR --uavs N"
    authority = _read(folder / "ca.pem")
    if isinstance(authority, str):
        yield Problem(folder / "ca.pem", authority, again)
        return
    if not authority.not_valid_before_utc <= at <= authority.not_valid_after_utc:
        yield Problem(folder / "ca.pem", _not_valid(authority, at), again)
    if (signing := folder / "ca.key").exists() and signing.stat().st_mode & 0o077:
        yield Problem(signing, "others on this machine can read it", f"chmod 600 {signing}")
    for name in wanted:
        identity = Identity(folder, name)
        certificate = _read(identity.certificate)
        if isinstance(certificate, str):
            yield Problem(identity.certificate, certificate, again)
            continue
        if not certificate.not_valid_before_utc <= at <= certificate.not_valid_after_utc:
            yield Problem(identity.certificate, _not_valid(certificate, at), again)
        if certificate.subject != _common_name(name):
            yield Problem(identity.certificate, f"is of {certificate.subject.rfc4514_string()}, not of {name}", again)
        try:
            certificate.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature):
            yield Problem(identity.certificate, f"not signed by {folder / 'ca.pem'}", again)
        try:
            identity.check()
        except BadInput as error:
            yield Problem(identity.key, str(error).partition("; ")[0].removeprefix(f"{identity.key}: "), again)
            continue
        if identity.key.stat().st_mode & 0o077:
            yield Problem(identity.key, "others on this machine can read it", f"chmod 600 {identity.key}")


def expires(folder: Path, wanted: Sequence[str]) -> datetime:
    """Time at which the first certificate of `folder` expires; all must be readable."""
    read = [_read(folder / f"{name}.pem") for name in ("ca", *wanted)]
    return min(certificate.not_valid_after_utc for certificate in read if not isinstance(certificate, str))


def _give(paths: Sequence[Path], user: int) -> None:
    with suppress(PermissionError):  # root in a container may lack the permission
        for path in paths:
            os.chown(path, user, user)


def _read(path: Path) -> x509.Certificate | str:
    """Read a certificate; returns a text if that fails."""
    try:
        return x509.load_pem_x509_certificate(read(path))
    except OSError as error:
        return str(error.strerror)
    except ValueError:
        return "not a certificate"


def _not_valid(certificate: x509.Certificate, at: datetime) -> str:
    if at < certificate.not_valid_before_utc:
        return f"not valid before {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC"
    return f"expired on {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC"


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _alternative(host: str) -> x509.GeneralName:
    return x509.IPAddress(ipaddress.ip_address(host)) if _is_address(host) else x509.DNSName(host)


def _write(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> list[Path]:
    public, private = folder / f"{name}.pem", folder / f"{name}.key"
    public.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    text = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    with open(os.open(private, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(text)
    return [public, private]
