"""The analysis on tidy frames."""
