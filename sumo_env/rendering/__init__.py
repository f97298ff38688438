"""Pictures of a scene: what is to be seen of it, and what they say."""

from sumo_env.rendering.notes import notes
from sumo_env.rendering.pictures import draw

__all__ = ["draw", "notes"]
