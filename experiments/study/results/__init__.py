"""Finished cells on disk, and the working folders of those that are not."""
