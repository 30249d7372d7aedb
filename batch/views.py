"""What of a .blend is rendered. Imports nothing that takes long."""

from __future__ import annotations

from typing import NamedTuple

AUTO_CAMERA = "auto"


class View(NamedTuple):
    """What of a .blend is rendered; None for what it was saved with.

    camera: AUTO_CAMERA for one that looks at everything. view_layer: its name; None for all that
    are used for rendering, or where there is one image, for the first of them.
    """

    camera: str | None = None
    frame: int | None = None
    scene: str | None = None
    view_layer: str | None = None


AS_SAVED = View()
