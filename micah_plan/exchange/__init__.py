"""Plans and models in other formats, and conversion between files."""
