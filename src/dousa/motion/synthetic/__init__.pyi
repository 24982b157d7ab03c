from .dance import Dance, DanceFigure, Mistake, make_dance, make_mistakes
from .performers import CATEGORIES, Performer, draw_performer, make_library, make_motion, make_skeleton

__all__ = [
    "CATEGORIES",
    "Dance",
    "DanceFigure",
    "Mistake",
    "Performer",
    "draw_performer",
    "make_dance",
    "make_library",
    "make_mistakes",
    "make_motion",
    "make_skeleton",
]
