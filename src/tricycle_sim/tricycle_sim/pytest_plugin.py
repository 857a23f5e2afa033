"""The pytest fixtures that this suite ships."""
