"""A performance judged while it goes on."""
