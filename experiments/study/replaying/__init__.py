"""Stored episodes again, crashes that could have been avoided, and agents for others."""
