"""The maps of a run as COLMAP models with point clouds."""

from dataclasses import replace
from pathlib import Path

from dslab.experiments.runs.execution import SlamSystem, slam_camera
from dslab.sim.sequence import Sequence
from dslab.slam.map.export import colmap_model, write_colmap


def write_maps(folder: Path, system: SlamSystem, sequence: Sequence) -> None:
    """Write the map into a folder, or several maps into sub-folders named by map id.

    Args:
        folder: created if there is a map.
        system: finished.
        sequence: the frames it was fed; images are named by their files if those are known, and give the
            points their grey value.

    Raises:
        InputError: a frame cannot be read.
        OSError: a file cannot be written.
    """
    names = sequence.image_names
    name = names.__getitem__ if names else "{:06d}.png".format
    map_ids = system.maps()
    for map_id in map_ids:
        model = colmap_model(
            system.map(map_id),
            replace(slam_camera(sequence.camera), residual=system.camera.residual),
            image_name=name,
            image=sequence.frames.__getitem__,
        )
        write_colmap(model, folder if len(map_ids) == 1 else folder / str(map_id))
