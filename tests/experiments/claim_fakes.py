"""A kind of experiment on a claim that measures nothing: its rows follow from the draws alone."""

import os
from typing import Literal

from matplotlib.figure import Figure

from dslab.experiments.claims.kinds import Kind
from dslab.experiments.claims.spec import ClaimSpec
from dslab.experiments.statistics.world_intervals import median_interval

SPEC = """
kind: fake
name: made-up
claim: Rooms are long.
section: II
root_seed: 5
worlds: {worlds}
bases:
  room:
    world: {{kind: room, length_m: {{uniform: [12, 18]}}}}
    camera: {{width_px: 320, height_px: 240, fx_px: 250, fy_px: 250, cx_px: 159.5, cy_px: 119.5, fps: 20}}
degradations:
  - {{kind: motion_blur, dose: exposure_s, doses: [0.05]}}
"""
FAILS = "CLAIM_FAKE_FAILS"


class FakeSpec(ClaimSpec):
    kind: Literal["fake"]


def units(spec):
    return [{"condition": name, "world": w} for w in range(spec.worlds) for name in spec.cells]


def measure(spec, unit):
    if str(unit["world"]) in os.environ.get(FAILS, "").split(","):
        raise RuntimeError("no length today")
    scenario = spec.scenario(unit["condition"], unit["world"])
    return [{"length_m": scenario.world.length_m, "place": place, "note": None} for place in range(2)]


def figures(spec, table):
    length = median_interval(table.groupby("world")["length_m"].median().to_numpy())
    return {"length_m": vars(length), "answer": [f"rooms are {length.value:.1f} m long"]}


def draw(spec, figures, width_in):
    figure = Figure(figsize=(width_in, 2))
    figure.subplots().plot([0, figures["length_m"]["value"]])
    return figure


KIND = Kind(FakeSpec, units, measure, figures, draw)
