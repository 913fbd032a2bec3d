"""ROS 2 messages in MCAP files, without a ROS installation (extra `ros`)."""
