"""Direct sparse odometry: poses and inverse depths that explain intensities, over a window of keyframes.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018.
"""
