"""glTF 2.0 and GLB, VRM and VRM animations: a tree of nodes, turned by an animation."""

from __future__ import annotations

from dousa.formats.gltf.reading import GltfLayout, read_gltf, read_gltf_character
from dousa.formats.gltf.writing import write_glb

__all__ = ["GltfLayout", "read_gltf", "read_gltf_character", "write_glb"]
