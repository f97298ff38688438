"""What is asked for: traffic, arms, sheets of the tasks, cells and their names, presets; nothing is computed here."""
