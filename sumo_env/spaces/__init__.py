"""What an agent sees and does: highway-env's types of observation and of action, and ours."""
