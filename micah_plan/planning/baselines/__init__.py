"""What POMDP-HD is compared with: direct planning over a mixture of modes, and RRT."""
