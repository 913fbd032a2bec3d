"""From a recorded demonstration of an articulated object to a manipulation plan that holds under uncertainty."""

__version__ = "0.1.0"
