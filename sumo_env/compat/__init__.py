"""What scripts that were written for highway-env read of an environment: its names, for what is here."""
