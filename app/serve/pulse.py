"""Whether a visitor's browser gives a sign of life: viser's own question for it waits by a clock that may be set."""

import threading
import time
import uuid

import viser
from viser import _messages


def answers(server: viser.ViserServer, client: viser.ClientHandle, patience: float) -> bool:
    """Whether it answers within so long [s], be it that it has no storage; False at once for one that has left."""
    question, heard = uuid.uuid4().hex, threading.Event()

    def on_answer(_: int, message: _messages.LocalStorageGetItemResponseMessage) -> None:
        if message.request_uuid == question:
            heard.set()

    connection, end = client._websock_connection, time.monotonic() + patience
    connection.register_handler(_messages.LocalStorageGetItemResponseMessage, on_answer)
    try:
        connection.queue_message(_messages.LocalStorageGetItemRequestMessage(key="pulse", request_uuid=question))
        client.flush()
        while not heard.wait(0.1):
            if time.monotonic() > end or client.client_id not in server.get_clients():
                return False
        return True
    finally:
        connection.unregister_handler(_messages.LocalStorageGetItemResponseMessage, on_answer)
