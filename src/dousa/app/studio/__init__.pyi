from .core.workspace import Settings
from .server import create_app, serve

__all__ = ["Settings", "create_app", "serve"]
