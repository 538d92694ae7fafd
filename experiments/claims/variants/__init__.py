"""Systems with other settings on the same frames: what a setting changes, by paired differences of worlds."""
