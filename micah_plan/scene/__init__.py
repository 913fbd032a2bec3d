"""What surrounds an object: bodies, and the arm that holds it, as values."""
