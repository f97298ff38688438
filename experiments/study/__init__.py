"""The experiment itself, from its description to stored cells; the first line of each module says what it is for."""
