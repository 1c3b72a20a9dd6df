"""How the page can be reached, and by whom: what the command line is told, checked and completed."""

import os
import socket
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from app.serve.address import PORT, certificate, is_loopback
from app.serve.keys import Keys

ANYWHERE = ("0.0.0.0", "::")


@dataclass(frozen=True)
class Access:
    """host, port: where to listen. keys: the tokens. names: further host names of the page. tls: for HTTPS."""

    host: str = "127.0.0.1"
    port: int | Literal["auto"] = PORT
    keys: Keys = field(default_factory=Keys)
    names: tuple[str, ...] = ()
    tls: ssl.SSLContext | None = None

    @classmethod
    def of(cls, host: str = "127.0.0.1", port: int | Literal["auto"] = PORT, *, token: str | None = None,
           view_token: str | None = None, names: Sequence[str] = (), tls_cert: Path | None = None,
           tls_key: Path | None = None) -> "Access":
        """From the command line; the environment's ELBOWROOM_TOKEN and ELBOWROOM_VIEW_TOKEN stand in for the tokens.

        Where others than this machine may come, a token that is not given is made; with one there is always one to watch.
        Raises PageError for a token or certificate that cannot be used.
        """
        token = token or os.environ.get("ELBOWROOM_TOKEN") or None
        view_token = view_token or os.environ.get("ELBOWROOM_VIEW_TOKEN") or None
        needed = not is_loopback(host) or bool(names) or token is not None or view_token is not None
        keys = Keys.make(token, view_token) if needed else Keys()
        known = (socket.gethostname(), socket.getfqdn()) if not is_loopback(host) else ()
        return cls(host, port, keys, (*names, *known), certificate(tls_cert, tls_key))

    def urls(self, port: int) -> tuple[str, str | None]:
        """The address to open, and the one to hand to those who are to watch only (None without tokens)."""
        name = socket.gethostname() if self.host in ANYWHERE else f"[{self.host}]" if ":" in self.host else self.host
        base = f"{'https' if self.tls is not None else 'http'}://{name}:{port}/"
        if self.keys.operate is None:
            return base, None
        return f"{base}?token={self.keys.operate}", f"{base}?token={self.keys.watch}"
