"""Traffic as values: who drives (`drivers`), what risk adds (`risk`), and a whole episode of it (`scenario`)."""
