"""Pictures of a scene, and what is painted of a road."""

from sumo_env.rendering.pictures import Renderer

__all__ = ["Renderer"]
