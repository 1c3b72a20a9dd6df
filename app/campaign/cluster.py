"""Where the workers of a campaign are."""

from dataclasses import dataclass
from pathlib import Path

from app.campaign.plan import CampaignError


@dataclass(frozen=True)
class Cluster:
    """Where to play. address: of a scheduler; None for `workers` processes on this machine, by default one for each core."""

    address: str | None = None
    workers: int | None = None
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    def check(self) -> None:
        """Raises CampaignError for what cannot be."""
        files = {"--tls-ca": self.tls_ca, "--tls-cert": self.tls_cert, "--tls-key": self.tls_key}
        given = [option for option, path in files.items() if path is not None]
        if self.workers is not None and self.workers < 1:
            raise CampaignError(f"there must be at least one worker, not {self.workers}")
        if self.address is None:
            if given:
                raise CampaignError(f"{given[0]} is for a scheduler elsewhere; name it with --address tls://host:8786")
            return
        if self.workers is not None:
            raise CampaignError("--workers is for this machine; a scheduler at --address has its own")
        scheme, colon, rest = self.address.partition("://")
        if scheme not in ("tcp", "tls") or not colon or not rest:
            raise CampaignError(f'the address must be tcp://host:port or tls://host:port, not "{self.address}"')
        if given and scheme == "tcp":
            raise CampaignError(f"{self.address} is not encrypted, but {given[0]} was given; write tls://{rest}")
        if scheme == "tls" and len(given) < len(files):
            raise CampaignError(f"{self.address} needs {', '.join(files)}; given: {', '.join(given) or 'none'}")
        for option, path in files.items():
            if path is not None and not path.is_file():
                raise CampaignError(f"{option}: there is no file {path}")
