"""The body: a tree of rigid parts, its poses, and how it is made from stature, skeletons or files."""
