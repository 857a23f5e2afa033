"""The paper's tables and figures, computed again: what `tricycle reproduce` shows."""
