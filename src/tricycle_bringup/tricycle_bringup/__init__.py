"""Launch files, configuration, the tricycle command and the demo."""
