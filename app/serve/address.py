"""Where the page listens: its address and port, who holds a port that is taken, and the certificate."""

import errno
import ipaddress
import os
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from hrc.errors import HrcError

LOOPBACK = frozenset({"localhost", "127.0.0.1", "[::1]"})
PORT = 8080
"""Where `auto` begins to look."""
TRIES = 20
"""Ports that `auto` tries before it takes any that is free."""
LISTENING = "0A"
"""State of a listening socket in the kernel's table of TCP sockets."""


class PageError(HrcError):
    """The page cannot be served as asked."""


def is_loopback(host: str) -> bool:
    """Whether nothing but this machine reaches an address of that name."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_number(host: str) -> bool:
    """Whether it is an IP address, which no name server can turn into another."""
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True


def hostname(host: str) -> str:
    """`name` of `name:port`, in lower case; an IPv6 address keeps its brackets."""
    return (host if host.endswith("]") else host.rsplit(":", 1)[0]).lower()


def bind(host: str, port: int | Literal["auto"]) -> socket.socket:
    """A listening socket. `auto` takes 8080 or the next port that is free, 0 any.

    Raises PageError if the port is taken, with the process that holds it where that can be known, or the address is not
    this machine's.
    """
    if port != "auto":
        return _bind(host, port)
    for candidate in range(PORT, PORT + TRIES):
        try:
            return _bind(host, candidate)
        except _BusyError:
            continue
    return _bind(host, 0)


class _BusyError(PageError):
    pass


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            holder = owner(port)
            by = f" by {holder}" if holder else ""
            raise _BusyError(f"port {port} of {host} is in use{by}; choose another with --port, or --port auto") from None
        raise PageError(f"cannot serve on {host} port {port} ({error.strerror})") from None
    except OverflowError:
        raise PageError(f'a port is "auto" or a number from 0 to 65535, not {port}') from None


def owner(port: int) -> str:
    """The process that listens on a port, as `process 1234 (python)`; empty where the system does not tell (it needs
    Linux, and the right to look into that process)."""
    inodes = set(_listening(port))
    for folder in Path("/proc").glob("[0-9]*") if inodes else ():
        try:
            if any(_inode(link) in inodes for link in (folder / "fd").iterdir()):
                return f"process {folder.name} ({(folder / 'comm').read_text().strip()})"
        except OSError:  # it has ended, or belongs to somebody else
            continue
    return ""


def _listening(port: int) -> Iterator[str]:
    """Inodes of the sockets that listen on a port."""
    for table in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")):
        for line in table.read_text().splitlines()[1:] if table.exists() else ():
            _, local, _, state, *rest = line.split()
            if state == LISTENING and int(local.rpartition(":")[2], 16) == port:
                yield rest[5]


def _inode(link: Path) -> str:
    try:
        return os.readlink(link).removeprefix("socket:[").removesuffix("]")
    except FileNotFoundError:  # closed in the meantime
        return ""


def certificate(cert: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """What HTTPS needs, from PEM files; None for plain HTTP. Raises PageError if they cannot be used."""
    if cert is None and key is None:
        return None
    if cert is None or key is None:
        raise PageError("HTTPS needs both --tls-cert and --tls-key")
    for file in (cert, key):
        if not file.is_file():
            raise PageError(f"no such file: {file}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(cert, key, password="")  # never ask on the terminal for the password of a key
    except (ssl.SSLError, OSError) as error:
        raise PageError(f"{cert} and {key} are not a certificate in PEM and its unencrypted key ({error})") from None
    return context
