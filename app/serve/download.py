"""A large file on its way to one visitor, a piece at a time: banner and STOP get through in between, for him and all others."""

import threading
import time
import uuid
from typing import BinaryIO

import viser
from viser import _messages

PIECE = 128 * 1024
"""Bytes of a piece. Some of them are on their way at once, and what comes next waits for them on a thin line."""
LOOK = 0.005
"""Between two looks at whether a piece has gone [s]."""


def send(server: viser.ViserServer, client: viser.ClientHandle, name: str, file: BinaryIO, size: int) -> None:
    """Send so many bytes of a file, from where it is, under this name, and close it; on a thread of its own.

    What viser has for this hands over the whole file at once.
    """
    threading.Thread(target=_work, args=(server, client, name, file, size), name="download", daemon=True).start()


def _work(server: viser.ViserServer, client: viser.ClientHandle, name: str, file: BinaryIO, size: int) -> None:
    connection, transfer = client._websock_connection, uuid.uuid4().hex
    waiting, pieces = connection.get_message_buffer().message_from_id, -(-size // PIECE)
    with file:
        connection.queue_message(_messages.FileTransferStartDownload(
            save_immediately=True, transfer_uuid=transfer, filename=name, mime_type="application/zip", part_count=pieces,
            size_bytes=size))
        for i in range(pieces):
            connection.queue_message(_messages.FileTransferPart(None, transfer, i, file.read(PIECE)))
            client.flush()
            while waiting:
                if client.client_id not in server.get_clients():
                    return
                time.sleep(LOOK)
