"""Pictures: sheets, timelines, overlays."""
