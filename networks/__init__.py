"""Roads as data: highway-env's lanes, and the SUMO networks that equal them."""
