"""Pictures of a scene, and what is painted of a road."""

from sumo_env.rendering.pictures import draw

__all__ = ["draw"]
