# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel shows: the connection, the last answer, and its pictures. One for the whole program."""

from __future__ import annotations

from collections.abc import Iterable

import bpy.utils.previews

from . import thumbnails
from .studio import Found, Studio


class Session:
    """studio: the connection, or None; found: the last answer, or None."""

    def __init__(self) -> None:
        self.studio: Studio | None = None
        self.found: Found | None = None
        self._pictures = None

    def require_studio(self) -> Studio:
        """The connection; it must be there."""
        assert self.studio is not None, "operators that need a studio poll for it"
        return self.studio

    def connect(self, studio: Studio) -> None:
        """Use another studio from now on."""
        self.close()
        self.studio = studio

    def show(self, found: Found) -> None:
        """Keep an answer, and draw its clips."""
        self.found = found
        self._forget_pictures()
        self._pictures = bpy.utils.previews.new()
        for clip, miniature in self._miniatures(found):
            picture = self._pictures.new(str(clip))
            picture.image_size = (thumbnails.SIZE, thumbnails.SIZE)
            picture.image_pixels_float.foreach_set(thumbnails.draw(miniature).ravel())

    def _miniatures(self, found: Found) -> Iterable[tuple[int, bytes]]:
        clips = list(dict.fromkeys(hit.clip_id for hit in found.hits))
        return zip(clips, self.require_studio().thumbnails(clips), strict=True)

    def icon(self, clip_id: int) -> int:
        """Number of the picture of a clip, for layouts."""
        return self._pictures[str(clip_id)].icon_id if self._pictures is not None else 0

    def _forget_pictures(self) -> None:
        if self._pictures is not None:
            bpy.utils.previews.remove(self._pictures)
            self._pictures = None

    def close(self) -> None:
        """Let everything go; a studio that was started here is stopped."""
        self._forget_pictures()
        self.found = None
        if self.studio is not None:
            self.studio.close()
            self.studio = None


SESSION = Session()
