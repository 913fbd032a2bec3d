"""Plans and models in the formats of others, and the way from one file to another."""
