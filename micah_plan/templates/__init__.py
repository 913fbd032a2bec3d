"""Template files: they work unchanged, and their comments explain what to edit."""
