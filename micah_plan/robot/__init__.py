"""The arm: kinematics by Pinocchio, clearances by Coal, and joint paths that follow a path of the tool."""
