"""The world and the camera of tests that render for real: a few frames of them take next to no time."""

CORRIDOR = {"kind": "corridor", "length_m": 10, "turns": 0}
CAMERA = {"width_px": 96, "height_px": 64, "fx_px": 70, "fy_px": 70, "cx_px": 47.5, "cy_px": 31.5, "fps": 10}
