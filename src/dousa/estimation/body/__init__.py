"""The body: a tree of rigid parts, its poses, and its construction from stature, skeletons or files."""
