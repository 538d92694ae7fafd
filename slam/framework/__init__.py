"""Dual-SLAM over any odometry: Algorithm 1 of the paper by trajectories alone."""
