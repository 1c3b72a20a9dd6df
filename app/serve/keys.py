"""Who is let in, and as what: a token opens the page to drive the arm, a second one to watch it."""

import hmac
import re
import secrets
import urllib.parse
from dataclasses import dataclass
from enum import StrEnum

from websockets import Headers
from websockets.http11 import Request, Response

from app.serve.address import PageError

LEAST = 8
"""Characters of the shortest token."""


class Role(StrEnum):
    """What a visitor may do at most. STOP is everybody's."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass(frozen=True)
class Keys:
    """The two tokens; without any, everybody who can reach the page may drive.

    Raises PageError for a token that an address or a cookie cannot carry, that is short, or that stands for both roles.
    """

    operate: str | None = None
    watch: str | None = None

    def __post_init__(self) -> None:
        for token in (self.operate, self.watch):
            if token is not None and not re.fullmatch(rf"[A-Za-z0-9._~-]{{{LEAST},128}}", token):
                raise PageError(f"a token has {LEAST} to 128 letters, digits or any of . _ ~ -")
        if self.watch is not None and self.operate is None:
            raise PageError("a token to watch needs a token to operate: without one everybody may operate")
        if self.watch is not None and self.watch == self.operate:
            raise PageError("the token to watch and the token to operate must differ")

    @classmethod
    def make(cls, operate: str | None = None, watch: str | None = None) -> "Keys":
        """Those that are given, and new ones for the others."""
        return cls(operate or secrets.token_urlsafe(16), watch or secrets.token_urlsafe(16))

    def role(self, request: Request, cookie: str) -> Role | None:
        """What the visitor behind a request may do; None: there is no valid token with it.

        A token that stands in the address goes before the cookie: a link decides, whatever was opened before.
        """
        if self.operate is None:
            return Role.OPERATOR
        pairs = (part.strip().partition("=") for part in request.headers.get("Cookie", "").split(";"))
        kept = {name: value for name, _, value in pairs}.get(cookie, "")
        asked = urllib.parse.parse_qs(urllib.parse.urlsplit(request.path).query).get("token", [""])[0]
        for presented in (asked, request.headers.get("Authorization", "").removeprefix("Bearer "), kept):
            for token, role in ((self.operate, Role.OPERATOR), (self.watch, Role.VIEWER)):
                if token is not None and hmac.compare_digest(presented.encode(errors="surrogateescape"), token.encode()):
                    return role
        return None

    def keep(self, request: Request, role: Role, cookie: str, *, secure: bool) -> Response | None:
        """Move the token from the address, which histories and logs keep, into a cookie that scripts cannot read.

        None if there is none in the address.
        """
        url = urllib.parse.urlsplit(request.path)
        pairs = urllib.parse.parse_qsl(url.query)
        token = self.operate if role is Role.OPERATOR else self.watch
        if token is None or all(name != "token" for name, _ in pairs):
            return None
        rest = urllib.parse.urlencode([pair for pair in pairs if pair[0] != "token"])
        location = "/" + url.path.lstrip("/") + (f"?{rest}" if rest else "")  # never "//host", which is another host
        return Response(302, "Found", Headers({
            "Location": location, "Content-Length": "0", "Cache-Control": "no-store",
            "Set-Cookie": f"{cookie}={token}; HttpOnly; SameSite=Lax; Path=/" + ("; Secure" if secure else "")}))
