"""Learned evidence: the points of a person's body in the pictures of a film, and whose points they are."""
