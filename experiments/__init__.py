"""The study: grid -> train -> evaluate -> analyse -> report. Every command a user types lives here."""
