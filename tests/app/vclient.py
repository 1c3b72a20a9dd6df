"""The raw client under the name that the tests have for it."""

from app.client import Client as VClient
from app.client import decode, until

__all__ = ["VClient", "decode", "until"]
