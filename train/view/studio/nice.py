"""The package that makes the page, or the name of the extra that brings it."""

from torchds.errors import MissingPackageError

try:
    from nicegui import app as app
    from nicegui import events as events
    from nicegui import ui as ui
    from nicegui.element import Element as Element
except ImportError as error:
    raise MissingPackageError("nicegui", "studio", "the studio") from error
