"""Images of your own through Dual-SLAM: python own_images.py FOLDER FX FY CX CY FPS

FOLDER holds one image per frame, in the order of their names. Without arguments a few seconds are rendered.
"""

import sys
from pathlib import Path

import cv2

from dslab import scenarios, sim, slam


def main(folder: Path, fx: float, fy: float, cx: float, cy: float, fps: float) -> None:
    """Print the state of the tracker as it changes, the events, and the number of posed frames."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg"))
    height, width = cv2.imread(str(files[0]), cv2.IMREAD_GRAYSCALE).shape
    camera = slam.PinholeCamera(width, height, fx, fy, cx, cy, fps)
    system = slam.build_system("dual", camera)
    state = None
    for index, file in enumerate(files):
        result = system.process(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), index / fps)
        if result.state is not state:
            state = result.state
            print(f"{file.name}: {state.value} {result.reason}")
    system.finish()
    for event in system.events:
        print(f"frame {event.frame}: {event.kind}")
    for trajectory in system.trajectories():
        print(f"map {trajectory.map_id}: {len(trajectory.frames)} of {len(files)} frames have a pose")


def rendered() -> tuple:
    """Render four seconds of a room and return the arguments of :func:`main` for its frames."""
    scenario = scenarios.load("clean-room", seed=1).model_copy(update={"duration_s": 4.0})
    if not Path("rendered").exists():
        sim.render(scenario, out_dir=Path("rendered"))
    camera = scenario.camera
    return Path("rendered/rgb"), camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, camera.fps


if __name__ == "__main__":
    given = sys.argv[1:]
    main(*((Path(given[0]), *map(float, given[1:6])) if given else rendered()))
