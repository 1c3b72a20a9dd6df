"""A restless audience, in a process of its own: visitors come, push at random, stall, and leave well or badly."""

import contextlib
import random
import threading
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from app.client import Client, until

MOST = 3
"""Visitors at once."""
LINKS = tuple(f"/robot/link_{i}" for i in range(3, 8))
BALL = "/gizmos/ball"
PATIENCE = 15.0
"""How long a visitor waits for what it wants [s]."""


class Crowd:
    """Acts one after the other, at random from a seed. done: how often each; failed: each that did not work out, and why."""

    def __init__(self, port: int, seed: int) -> None:
        self._port, self._chance = port, random.Random(seed)
        self._clients: list[Client] = []
        self._frozen: dict[Client, tuple[threading.Event, float]] = {}
        self.done: Counter[str] = Counter()
        self.failed: Counter[str] = Counter()

    def act(self) -> None:
        """Do one thing that a visitor may do."""
        self._thaw()
        self._clients = [client for client in self._clients if not client.closed.is_set()]
        acts: tuple[tuple[Callable[[], None], int], ...] = (
            (self.join, 3), (self.leave, 1), (self.tear, 1), (self.stall, 1), (self.push, 6), (self.vanish_in_mid_push, 1),
            (self.obstacle, 2), (self.change, 1), (self.stop, 1))
        choices, weights = zip(*acts, strict=True)
        act = self._chance.choices(choices, weights)[0] if self._clients else self.join
        try:
            act()
            self.done[act.__name__] += 1
        except (TimeoutError, ConnectionError, KeyError) as error:
            self.failed[f"{act.__name__}: {type(error).__name__} {error}"] += 1

    def close(self) -> None:
        """Everybody leaves."""
        for thawed, _ in self._frozen.values():
            thawed.set()
        for client in self._clients:
            client.close()

    def join(self) -> None:
        """One more, if there is room."""
        if len(self._clients) < MOST:
            client = Client(self._port)
            self._clients.append(client)
            until(lambda: client.ready.is_set() and client.seat() and LINKS[0] in client.nodes, PATIENCE)

    def leave(self) -> None:
        """One closes its tab."""
        self._someone(gone=True).close()

    def tear(self) -> None:
        """One loses its line."""
        self._someone(gone=True).tear()

    def stall(self) -> None:
        """One reads and answers nothing for some seconds."""
        client, thawed = self._someone(), threading.Event()
        client.freeze(thawed)
        self._frozen[client] = thawed, time.monotonic() + self._chance.uniform(2.0, 8.0)

    def push(self) -> None:
        """Pull a link somewhere and let go."""
        client = self._driver()
        link, point = self._pull(client)
        client.drag(link, "end", point, point)

    def vanish_in_mid_push(self) -> None:
        """Pull a link, and lose the line."""
        client = self._driver()
        self._pull(client)
        self._clients.remove(client)
        client.tear()

    def obstacle(self) -> None:
        """Bring the ball somewhere, at times into the arm."""
        client = self._driver()
        client.gizmo(BALL, [self._chance.uniform(-0.7, 0.0), self._chance.uniform(-0.5, 0.5), self._chance.uniform(0.2, 0.7)])

    def change(self) -> None:
        """Move a slider, or begin anew."""
        client = self._driver()
        if self._chance.random() < 0.2:
            client.set("Simulation", "Reset")
        else:
            client.set("F_relax [N]", self._chance.choice((4.0, 5.0, 6.0)))

    def stop(self) -> None:
        """Anybody may stop the arm; the operator lets it go on."""
        self._someone().click("STOP (Esc)")
        client = self._driver()
        until(lambda: client.banner()["mode"] == "stop", PATIENCE)
        client.click("Resume")
        until(lambda: client.banner()["mode"] != "stop", PATIENCE)

    def _pull(self, client: Client) -> tuple[str, np.ndarray]:
        link = self._chance.choice(LINKS)
        point = client.position(link) + np.array([0.05, 0.0, 0.0])
        aim = np.array([self._chance.gauss(0.0, 0.15) for _ in range(3)])
        client.drag(link, "start", point, point)
        number = self._chance.randrange(10, 50)
        for i in range(1, number + 1):
            client.drag(link, "update", point, point + aim * min(1.0, 2.0 * i / number))
            time.sleep(0.05)
        return link, point

    def _driver(self) -> Client:
        """Somebody who drives now, after asking for the seat if need be."""
        client = self._someone()
        if client.drives():
            return client
        until(lambda: client.drives() or self._offered(client), PATIENCE)
        if not client.drives():
            client.click("Take control")
        agreed: set[Client] = set()
        until(lambda: client.drives() or self._agree(client, agreed), PATIENCE)
        return client

    def _offered(self, client: Client) -> bool:
        props = client.gui[client.widget("Take control")]["props"]
        return props["visible"] and not props["disabled"]

    def _agree(self, asker: Client, agreed: set[Client]) -> bool:
        """Whoever of the others is asked for the seat hands it over, once."""
        for client in self._clients:
            if client is not asker and client not in agreed and client not in self._frozen and not client.closed.is_set():
                with contextlib.suppress(KeyError, ConnectionError):
                    if client.gui[client.widget("Hand over")]["props"]["visible"]:
                        agreed.add(client)
                        client.click("Hand over")
        return False

    def _someone(self, *, gone: bool = False) -> Client:
        awake = [client for client in self._clients if client not in self._frozen]
        if not awake:
            self.join()
            awake = [client for client in self._clients if client not in self._frozen]
        if not awake:
            raise TimeoutError("everybody is frozen")
        client = self._chance.choice(awake)
        if gone:
            self._clients.remove(client)
        return client

    def _thaw(self) -> None:
        now = time.monotonic()
        for client, (thawed, due) in list(self._frozen.items()):
            if now > due:
                thawed.set()
                del self._frozen[client]


def riot(port: int, seed: int, over: threading.Event, seconds: float) -> tuple[dict[str, int], dict[str, int]]:
    """Act until it is over, or for so long at most; what was done, and what failed."""
    crowd, end = Crowd(port, seed), time.monotonic() + seconds
    try:
        while not over.is_set() and time.monotonic() < end:
            crowd.act()
            time.sleep(0.3)
    finally:
        crowd.close()
    return dict(crowd.done), dict(crowd.failed)
