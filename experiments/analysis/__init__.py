"""From stored cells to effects and verdicts: pure functions of frames, no files, no pictures, no sentences."""
