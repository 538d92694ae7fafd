"""What a tracker meets in footage, as distributions: real and rendered sequences beside each other."""
