"""A degradation of your own: dead pixels, which stay black wherever the camera looks."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from dslab import experiments, scenarios, sim


class DeadPixels(scenarios.ImageSegment):
    """Pixels of the sensor that stay black."""

    kind: Literal["dead_pixels"]
    share: float = Field(ge=0, le=1, description="share of the pixels")


class DeadPixelsDegradation(sim.ImageDegradation[DeadPixels]):
    """Sets a random share of the pixels to 0, the same ones in every frame."""

    kind: ClassVar[str] = "dead_pixels"
    stage: ClassVar[sim.Stage] = sim.Stage.SENSOR
    measure_name: ClassVar[str] = "dead_share"

    def sample(self, rng: np.random.Generator) -> dict[str, float | str]:
        """Draw a severity from harmless to fatal."""
        return {"share": float(rng.uniform(0.001, 0.8))}

    def prepare(self, segment: DeadPixels, camera: sim.Intrinsics, streams) -> sim.Filter:
        """Choose the pixels once; on a ramp they die one after the other."""
        order = streams("pixels").random((camera.height_px, camera.width_px))

        def kill(image: np.ndarray, view: sim.View) -> tuple[np.ndarray, float]:
            share = view.strength * segment.share
            return np.where(order < share, 0, image).astype(np.uint8), share

        return kill

    def threshold(self, segment: DeadPixels) -> float:
        """The segment acts from half of its share on."""
        return segment.share / 2


sim.register_degradation(DeadPixels, DeadPixelsDegradation())

if __name__ == "__main__":
    calm = scenarios.load("clean-room", seed=1).model_dump() | {"duration_s": 6.0}
    for share in (0.1, 0.5):
        stress = {"kind": "dead_pixels", "start_s": 3, "duration_s": 2, "share": share}
        sequence = sim.render(scenarios.Scenario.model_validate(calm | {"segments": [stress]}))
        metrics = experiments.run(sequence, "base").metrics
        print(f"{share:.0%} dead: {metrics['breakages']} breakages, ATE {metrics['ate_m']} m")
