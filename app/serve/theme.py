"""Light and dark: each visitor's own choice."""

import viser
from viser.theme import TitlebarConfig, TitlebarImage

LOGO = TitlebarConfig(buttons=None, image=TitlebarImage(
    image_url_light="/app/logo.svg", image_url_dark=None, image_alt="Elbowroom", href=None))
BRAND = (224, 108, 30)


class Theme:
    """The page is dark until its visitor asks for the other."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._light: set[int] = set()
        _configure(server.gui, dark=True)

        async def on_leave(client: viser.ClientHandle) -> None:
            self._light.discard(client.client_id)

        server.on_client_disconnect(on_leave)

    def toggle(self, client: viser.ClientHandle) -> None:
        """Show one visitor the page the other way."""
        self._light ^= {client.client_id}
        _configure(client.gui, dark=client.client_id not in self._light)


def _configure(gui: viser.GuiApi, *, dark: bool) -> None:
    gui.configure_theme(titlebar_content=LOGO, dark_mode=dark, brand_color=BRAND, show_logo=False, show_share_button=False)
