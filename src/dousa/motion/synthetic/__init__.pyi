from .dance import Dance, DanceFigure, make_dance
from .performers import CATEGORIES, Performer, draw_performer, make_library, make_motion, make_skeleton

__all__ = [
    "CATEGORIES",
    "Dance",
    "DanceFigure",
    "Performer",
    "draw_performer",
    "make_dance",
    "make_library",
    "make_motion",
    "make_skeleton",
]
