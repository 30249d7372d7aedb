"""LightTree's renderer: a path tracer for very many lights. It knows nothing of Blender."""

from .film import Film
from .render import render
from .scene import Scene, SceneError
from .settings import Settings

__all__ = ["Film", "Scene", "SceneError", "Settings", "render"]
