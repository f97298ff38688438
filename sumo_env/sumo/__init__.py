"""SUMO: the session with libsumo, an episode driven in it, and a process of its own for each further environment."""
