"""What surrounds an object: bodies that do not move, and the arm that holds it, as values."""
