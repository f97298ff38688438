"""What highway-env's environments share, under highway-env's names."""
