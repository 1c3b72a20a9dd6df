"""The raw client under the name that the tests have for it."""

from app.client import PATIENCE, decode, until
from app.client import Client as VClient

__all__ = ["PATIENCE", "VClient", "decode", "until"]
