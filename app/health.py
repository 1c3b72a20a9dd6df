"""Whether a page lives: python -m app.health [URL]; exit code 0 if it says so. For an image's health check."""

import ssl
import sys
import urllib.request

HERE = "http://127.0.0.1:8080/healthz"
PATIENCE = 3.0
"""How long to wait for an answer [s]."""


def main(url: str = HERE) -> int:
    """Ask, print the answer, and give the exit code."""
    # one bit from this very machine: neither a proxy nor the name on the certificate has a say in it
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    ask = urllib.request.build_opener(urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=trusting))
    try:
        with ask.open(url, timeout=PATIENCE) as reply:
            print(reply.read(100).decode())
    except (OSError, ValueError) as error:  # also an answer that is not 2xx
        print(error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:2]))
