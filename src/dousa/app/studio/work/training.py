"""Training the forest of the library."""

from __future__ import annotations

from typing import Any

from dousa.app.studio.work import Context

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Train; ``request``: feature_set, n_trees, random_state."""
    with context.open_library() as library:
        report = library.train(
            feature_set=request.get("feature_set"),
            n_trees=request.get("n_trees", 100),
            random_state=request.get("random_state", 0),
            progress=context.progress,
        )
        return report.to_json()
