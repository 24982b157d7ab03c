from .core.workspace import Settings as Settings
from .server import create_app as create_app
from .server import serve as serve
from .shared import find_share_address as find_share_address
