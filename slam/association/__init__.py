"""Which keypoint shows which point of the map: by what is known of pose, point, noise and descriptors."""
