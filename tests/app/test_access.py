"""Where the page listens and to whom it opens: ports, tokens, HTTPS, host names."""

import os
import socket
import ssl
from pathlib import Path
from urllib.error import URLError
from urllib.request import Request, urlopen

import pytest

from app.serve.access import Access
from app.serve.address import PORT, PageError, bind, owner
from app.serve.guard import Guard
from app.serve.keys import Keys

TOKEN, WATCH = "operate-token", "watch-token"


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ELBOWROOM_TOKEN", "ELBOWROOM_VIEW_TOKEN"):
        monkeypatch.delenv(name, raising=False)


def test_busy_port_is_named_with_the_process_that_holds_it() -> None:
    with bind("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        with pytest.raises(PageError, match=f"port {port} of 127.0.0.1 is in use.*--port auto") as refusal:
            bind("127.0.0.1", port)
        if Path("/proc/net/tcp").exists():
            assert f"process {os.getpid()} (" in str(refusal.value)
    assert owner(port) == ""


def test_auto_takes_the_usual_port_or_the_next() -> None:
    with bind("127.0.0.1", "auto") as first, bind("127.0.0.1", "auto") as second:
        ports = [listener.getsockname()[1] for listener in (first, second)]
    assert PORT <= ports[0] < ports[1]
    with pytest.raises(PageError, match="0 to 65535"):
        bind("127.0.0.1", 70000)


def test_only_this_machine_by_default_and_tokens_are_made_where_others_may_come() -> None:
    own = Access.of()
    assert (own.host, own.keys, own.urls(8080)) == ("127.0.0.1", Keys(), ("http://127.0.0.1:8080/", None))
    far, again = Access.of("0.0.0.0"), Access.of("0.0.0.0")
    assert len({far.keys.operate, far.keys.watch, again.keys.operate, again.keys.watch}) == 4
    assert min(len(far.keys.operate or ""), len(far.keys.watch or "")) >= 16
    url, watch = far.urls(8080)
    assert url == f"http://{socket.gethostname()}:8080/?token={far.keys.operate}"
    assert watch is not None
    assert watch.endswith(f"?token={far.keys.watch}")
    assert Access.of(names=["arm.example"]).keys.operate is not None, "behind a proxy others come, too"


def test_tokens_come_from_the_command_line_or_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELBOWROOM_TOKEN", "of-environment")
    assert Access.of().keys.operate == "of-environment"
    assert Access.of(token=TOKEN, view_token=WATCH).keys == Keys(TOKEN, WATCH)


@pytest.mark.parametrize(("operate", "watch", "told"), [
    ("short", None, "8 to 128"), ("with space and more", None, "letters"), ("semi;colon=1", None, "letters"),
    ("schlüssel-lang", None, "letters"), (TOKEN, TOKEN, "differ"), (None, WATCH, "needs a token to operate")])
def test_tokens_that_cannot_serve_are_refused(operate: str | None, watch: str | None, told: str) -> None:
    with pytest.raises(PageError, match=told):
        Keys(operate, watch)


def test_https_with_a_certificate(pem: tuple[Path, Path]) -> None:
    access = Access.of("127.0.0.1", 0, token=TOKEN, view_token=WATCH, tls_cert=pem[0], tls_key=pem[1])
    guard = Guard(access.keys, names=access.names, tls=access.tls)
    server = guard.open(access.host, access.port, "test")
    try:
        port, trust = server.get_port(), ssl.create_default_context(cafile=str(pem[0]))
        assert access.urls(port)[0].startswith("https://")
        page = Request(f"https://127.0.0.1:{port}/", headers={"Authorization": f"Bearer {TOKEN}"})
        with urlopen(page, context=trust, timeout=5) as reply:
            assert b"<title>Elbowroom</title>" in reply.read()
        with socket.create_connection(("127.0.0.1", port)) as raw, trust.wrap_socket(raw, server_hostname="localhost") as line:
            line.sendall(f"GET /?token={TOKEN} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            assert "; Secure" in line.recv(4096).decode()
        with pytest.raises((URLError, ConnectionError)):
            urlopen(f"http://127.0.0.1:{port}/", timeout=2)
    finally:
        server.stop()


def test_certificates_that_cannot_be_used_are_one_clear_line(pem: tuple[Path, Path], tmp_path: Path) -> None:
    cert, key = pem
    with pytest.raises(PageError, match="both --tls-cert and --tls-key"):
        Access.of(tls_cert=cert)
    with pytest.raises(PageError, match="no such file"):
        Access.of(tls_cert=cert, tls_key=tmp_path / "missing.pem")
    with pytest.raises(PageError, match="not a certificate"):
        Access.of(tls_cert=key, tls_key=cert)
