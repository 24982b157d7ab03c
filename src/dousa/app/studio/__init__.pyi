from .core.workspace import Settings
from .server import create_app, serve
from .shared import find_share_address

__all__ = ["Settings", "create_app", "find_share_address", "serve"]
