"""Widgets made from parameters: range, unit, options and tooltip are those of the field, so that each stands once."""

import math
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import viser

from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import SetParameter
from hrc.parameters import field_of, keys

Widgets = tuple[viser.GuiInputHandle[Any], ...]


class Inputs:
    """What has been made so far. A change goes to the cell as an event; `show` follows what the cell then has.

    put: hands an event to the cell. refuse: told why one was not taken.
    """

    def __init__(self, server: viser.ViserServer, config: Config, put: Callable[[SetParameter], None],
                 refuse: Callable[[str], None]) -> None:
        self._gui, self._put, self._refuse = server.gui, put, refuse
        self._config = config
        self._made: list[tuple[str, Widgets]] = []

    def add(self, key: str, label: str = "") -> None:
        """A slider, checkbox or choice, in the present container; one slider for each number of several."""
        field, value = field_of(self._config, key), keys(self._config)[key]
        label, hint = label or key.rpartition(".")[2], self._hint(key)
        if options := field.metadata["options"]:
            widgets: Widgets = (self._gui.add_dropdown(label, options, initial_value=value, hint=hint),)
        elif isinstance(value, bool):
            widgets = (self._gui.add_checkbox(label, value, hint=hint),)
        elif isinstance(value, tuple):
            widgets = tuple(self._number(field.metadata, f"{label} {i}", x, hint) for i, x in enumerate(value, start=1))
        else:
            widgets = (self._number(field.metadata, label, value, hint),)
        self._connect(key, widgets, several=isinstance(value, tuple))
        self._made.append((key, widgets))

    def show(self, config: Config) -> None:
        """Set the widgets to what the cell has: after a start, a reset, or a change that it did not take."""
        self._config = config
        values = keys(config)
        for key, widgets in self._made:
            value = values[key]
            for widget, x in zip(widgets, value if isinstance(value, tuple) else (value,), strict=True):
                widget.value = x

    def _hint(self, key: str) -> str:
        owner: Any = self._config
        *groups, name = key.split(".")
        for group in groups:
            owner = getattr(owner, group)
        return owner.docs().get(name, "")

    def _number(self, meta: Any, label: str, value: float, hint: str) -> viser.GuiInputHandle[Any]:
        low, high = meta["low"], meta["high"]
        label += f" [{meta['unit']}]" if meta["unit"] else ""
        step = 1 if isinstance(value, int) else fine_step(low, high, value)
        return self._gui.add_slider(label, min=low, max=high, step=step, initial_value=value, hint=hint)

    def _connect(self, key: str, widgets: Widgets, *, several: bool) -> None:
        async def on_update(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:  # it was set by `show`
                return
            try:
                self._put(SetParameter(key, tuple(w.value for w in widgets) if several else event.target.value))
            except HrcError as error:
                self._refuse(str(error))

        for widget in widgets:
            widget.on_update(on_update)


def fine_step(low: float, high: float, value: float) -> float:
    """The largest power of ten that divides a range into a hundred parts or more, and of which its lower end and `value` are
    multiples: a slider counts its steps from there, and must not show another value than it holds."""
    digits = [math.floor(math.log10((high - low) / 100.0))]
    digits += [_last_digit(x) for x in (low, value) if x]
    return float(Decimal(1).scaleb(min(digits)))


def _last_digit(x: float) -> int:
    exponent = Decimal(repr(x)).normalize().as_tuple().exponent
    return exponent if isinstance(exponent, int) else 0  # a letter for what is not finite, which no range has
