"""Roads as data: highway-env's lanes, and the SUMO networks that equal them.

Imported as `sumo_env.networks`, which is a link to this folder.
"""
