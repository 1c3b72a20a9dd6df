"""The operator's seat: one drives, the others watch.

An empty seat is taken by the first who acts. Whoever sits there gives it up by leaving, by Release, by consent when
somebody asks, or by silence. Only integers here: a visitor is the number that viser gave its connection.
"""

from collections.abc import Callable

from app.serve.keys import Role


class Seat:
    """role: of a visitor, None when it is gone. operator: who drives, or None. asking: who has asked to, and waits."""

    def __init__(self, role: Callable[[int], Role | None]) -> None:
        self._role = role
        self.operator: int | None = None
        self.asking: int | None = None
        self._left: list[Callable[[int], None]] = []
        self._changed: list[Callable[[], None]] = []

    def on_left(self, act: Callable[[int], None]) -> None:
        """To be told of each visitor that drives no longer: whatever it still holds must be let go."""
        self._left.append(act)

    def on_change(self, act: Callable[[], None]) -> None:
        """To be told that somebody sits down, gets up or asks."""
        self._changed.append(act)

    def admits(self, visitor: int) -> bool:
        """Whether this visitor may change something now; the first to try takes an empty seat."""
        self._clear_away()
        if self.operator is None and self._role(visitor) is Role.OPERATOR:
            self._sit(visitor)
        return self.operator == visitor

    def take(self, visitor: int) -> bool:
        """Sit down if the seat is empty, else ask for it. Whether there is somebody whose answer must be awaited."""
        self._clear_away()
        if self._role(visitor) is not Role.OPERATOR or visitor == self.operator:
            return False
        if self.operator is None:
            self._sit(visitor)
            return False
        if self.asking is not None:  # one asks at a time
            return False
        self.asking = visitor
        self._tell()
        return True

    def answer(self, visitor: int, *, consent: bool) -> None:
        """What the operator says to whoever asks; anybody else's word does not count."""
        if visitor != self.operator or self.asking is None:
            return
        if consent:
            self._sit(self.asking)
        else:
            self.asking = None
            self._tell()

    def yield_to(self, visitor: int) -> None:
        """The operator has not answered this visitor's question in time."""
        if self.asking == visitor:
            self._sit(visitor)

    def release(self, visitor: int) -> None:
        """Get up; whoever has asked sits down."""
        if visitor == self.operator:
            self._sit(self.asking)

    def leave(self, visitor: int) -> None:
        """This visitor is gone."""
        if visitor == self.asking:
            self.asking = None
            self._tell()
        self.release(visitor)

    def _clear_away(self) -> None:
        """A visitor may have acted with its last breath: of those who are gone nobody sits or asks."""
        for visitor in (self.asking, self.operator):
            if visitor is not None and self._role(visitor) is None:
                self.leave(visitor)

    def _sit(self, visitor: int | None) -> None:
        left, self.operator, self.asking = self.operator, visitor, None
        if left is not None:
            for act in self._left:
                act(left)
        self._tell()

    def _tell(self) -> None:
        for act in self._changed:
            act()
