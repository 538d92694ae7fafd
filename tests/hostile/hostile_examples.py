"""Valid examples of all that the lab reads, as small as can be, and the commands that read them."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from hostile_results import batch, calibrations, write_batch
from hostile_sequences import (
    euroc,
    evo_results,
    images_and_video,
    images_with_poses,
    kitti,
    tartanair,
    tum,
    tum_mono,
    tum_mono_zip,
    tum_with_lens,
    vslam_lab,
)
from hostile_systems import long_program, own_class, program
from small_world import CAMERA, CORRIDOR

from dslab.experiments.campaign.folder import ERROR_COLUMNS, claim_folder, export, open_ledger, write_spec
from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import empty_record
from dslab.experiments.eq1.spec import ExperimentSpec, load_spec
from dslab.experiments.report.recordings import add_paths
from dslab.experiments.runs.slam_settings import settings_yaml
from dslab.scenarios.loading import load_scenario
from dslab.sim.sequence_rendering import render_sequence

SCENARIO = {
    "name": "tiny", "duration_s": 0.5, "seed": 3, "world": CORRIDOR,
    "camera": {**CAMERA, "distortion": {"model": "radtan", "k1": 0.05, "k2": -0.01}},
    "segments": [{"kind": "low_light", "start_s": 0.2, "duration_s": 0.2, "illumination": 0.5}],
}  # fmt: skip
SPEC = {
    "name": "tiny", "root_seed": 1, "worlds": 2, "sham": False,
    "lead_in_s": 1, "exposed_s": 0.5, "tail_s": 0.5,
    "bases": {"corridor": {"world": CORRIDOR, "camera": CAMERA}},
    "degradations": [{"kind": "low_texture", "dose": "contrast", "doses": [0.3, 0.02], "begins_s": 0.1,
                      "acts_s": 0.3}],
    "threads": ["orb"],
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Example:
    """A folder that the lab reads.

    Attributes:
        name: kind of input.
        write: writes it into a new folder.
        commands: command lines that read it and end soon, with the places ``{in}`` and ``{out}``, and
            ``{changed}`` for the file that was changed.
        ours: patterns of the lab's own files with checksums: no change of a bit may go unseen.
        optional: patterns of files that may be absent.
        sparse: patterns of files that may be absent, or lack some of their entries.
        free: patterns of files of which any content that can be read is as good as another.
        fixed: patterns of files that are left as they are.
        mended: patterns of files that a command may mend by itself.
        environment: variables, with the same places.
        kept: the result stays where what a system has left is refused.
        heavy: seconds go by before its commands read it.
    """

    name: str
    write: Callable[[Path], None]
    commands: tuple[str, ...]
    ours: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    sparse: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    mended: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)
    kept: bool = False
    heavy: bool = False


def _scenario(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO, sort_keys=False))


def _family(folder: Path) -> None:
    folder.mkdir()
    drawn = {**SCENARIO, "world": {**CORRIDOR, "length_m": {"uniform": [10, 20]}}}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(drawn, sort_keys=False))


def _settings(folder: Path) -> None:
    tum(folder)
    (folder / "slam.yaml").write_text(settings_yaml())


def _summary(folder: Path) -> None:
    tum(folder)
    summary = {"sequence": "trial", "system": "base", "config": yaml.safe_load(settings_yaml())}
    (folder / "summary.json").write_text(json.dumps(summary, indent=1))


def _units(folder: Path) -> ExperimentSpec:
    """The folder of an experiment whose units have all ended."""
    folder.mkdir(parents=True)
    (folder / "own.yaml").write_text(yaml.safe_dump(SPEC, sort_keys=False))
    spec = load_spec(folder / "own.yaml")
    (folder / "own.yaml").unlink()
    claim_folder(folder)
    with open_ledger(folder, spec) as ledger:
        write_spec(folder, spec)
        for number, cell in enumerate(spec.cell_names()):
            for index in range(spec.units):
                unit = spec.unit(cell, index)
                broke = bool(index)
                record = empty_record(unit) | {
                    "outcome": "completed", "breakage": broke, "d1": bool(broke and number), "code": "0",
                    "commit": "0", "base_ate_m": 0.25 + index, "wall_s": 2.0, "cross_r1_inliers": 17,
                }  # fmt: skip
                if broke:
                    record |= {"free_r1_failed": bool(number), "breakage_reason": "made up"}
                ledger.add(normalise(record, len(spec.threads)))
                if index == 0:
                    values = (unit.unit_id, unit.cell, unit.index, 1, "now", "1", "made up", "")
                    ledger.add(dict(zip(ERROR_COLUMNS, values, strict=True)), table="errors")
    return spec


def _experiment(folder: Path) -> None:
    _units(folder)
    (folder / "driver.lock").touch()


def _exported(folder: Path) -> None:
    spec = _units(folder)
    add_paths(folder, spec.unit(spec.cell_names()[0], 0).unit_id, {"truth": np.zeros((20, 3), np.float32)})
    export(folder)
    for path in folder.glob("ledger.sqlite*"):
        path.unlink()


def _spec(folder: Path) -> None:
    _experiment(folder / "experiment")
    (folder / "spec.yaml").write_text(yaml.safe_dump(SPEC, sort_keys=False))


def _result(folder: Path) -> None:
    (folder / "base").mkdir(parents=True)
    summary = {"breakage_list": [{"time_s": 1.5, "frame": 15}], "config": {}}
    for place in (folder, folder / "base"):
        (place / "summary.json").write_text(json.dumps(summary, indent=1))
    (folder / "recording.rrd").write_bytes(b"RRF2" + bytes(64))


def _everything(folder: Path) -> None:
    """One valid input of each command, and an occupied folder."""
    for name, write in (("tum", tum), ("scenario", _scenario), ("experiment", _spec), ("result", _result)):
        write(folder / name)
    write_batch(folder)
    long_program(folder / "systems")


def _cache(folder: Path) -> None:
    """A scenario with its frames in the cache."""
    _scenario(folder)
    render_sequence(load_scenario(str(folder / "scenario.yaml")), cache_dir=folder / "cache")


_EXPORTS = (
    "export {in} --format tum --out {out}",
    "degrade {in} --segment jpeg:start_s=0.1,duration_s=0.2,quality=8 --out {out}",
    "run {in} --out {out}",
)
_TRUTH = ("groundtruth.txt", "depth.txt", "segments.json")
_DRAWN = (
    "scenarios validate {in}/scenario.yaml",
    "scenarios show {in}/scenario.yaml --seed 3",
)

EXAMPLES: dict[str, Example] = {
    example.name: example
    for example in (
        Example("tum", tum, _EXPORTS, optional=("frame_truth.csv",), sparse=_TRUTH, free=("meta.json",)),
        Example(
            "tum with lens", tum_with_lens, _EXPORTS, optional=("*.csv",), sparse=_TRUTH, free=("meta.json",)
        ),
        Example(
            "kitti",
            kitti,
            _EXPORTS,
            optional=("*.csv",),
            sparse=("segments.json",),
            free=("meta.json", "poses/*"),  # the poses have no stamps
        ),
        Example(
            "euroc",
            euroc,
            ("export {in} --format euroc --out {out}", *_EXPORTS),
            optional=("frame_truth.csv",),
            sparse=("*/imu0/data.csv", "*/state_groundtruth_estimate0/data.csv", "segments.json"),
            free=("meta.json", "*/state_groundtruth_estimate0/sensor.yaml"),
        ),
        Example(
            "tum-mono",
            tum_mono,
            _EXPORTS,
            optional=("pcalib.txt", "vignette.png"),
            sparse=("groundtruthSync.txt",),
        ),
        Example(
            "tum-mono zip",
            tum_mono_zip,
            _EXPORTS,
            optional=("pcalib.txt", "vignette.png"),
            sparse=("groundtruthSync.txt",),
        ),
        Example(
            "vslam-lab",
            vslam_lab,
            ("export {in} --format vslam-lab --out {out}", *_EXPORTS),
            optional=("frame_truth.csv",),
            sparse=("groundtruth.csv", "segments.json"),
            free=("meta.json",),
        ),
        Example(
            "tartanair",
            tartanair,
            _EXPORTS,
            optional=("depth_left",),
            free=("pose_left.txt",),  # the poses have no stamps
        ),
        Example(
            "images and a video",
            images_and_video,
            (
                "export {in}/walk.avi --camera {in}/camera.yaml --format tum --out {out}",
                "run {in}/images --camera {in}/camera.yaml --out {out}",
            ),
            sparse=("images",),
            free=("walk.avi",),
        ),
        Example(
            "images with poses",
            images_with_poses,
            tuple(
                f"export {{in}}/{name} --format tum --out {{out}}"
                for name in ("scannet", "room/replica", "nerfstudio", "colmap")
            ),
            free=("*",),  # poses have no stamps, and a frame may be without one
        ),
        Example(
            "calibrations",
            calibrations,
            ("camera {changed} --fps 10 --size 96x64",),
            sparse=("*.json", "*.yaml", "*.xml"),
            free=("*.txt",),  # figures without names
        ),
        Example(
            "own class",
            own_class,
            ("run {in}/tum --system {in}/own.py:Own --out {out}",),
            free=("own.py",),
            kept=True,
            fixed=("tum/*",),
            heavy=True,
        ),
        Example(
            "program",
            program,
            ("run {in}/tum --system copy --systems {in}/systems --out {out}",),
            free=("systems/*",),
            kept=True,
            fixed=("tum/*",),
            heavy=True,
        ),
        Example(
            "batch",
            batch,
            ("batch {in}/batch.yaml --out {in}/batch --json", "compare {in}/batch --out {out} --json"),
            ours=("batch/ledger.sqlite", "batch/driver.lock"),
            free=("batch/*", "batch.yaml"),
            fixed=("tum/*",),
            mended=("batch/*",),
            heavy=True,
        ),
        Example("evo results", evo_results, ("evo {in}/mine.zip",)),
        Example("scenario", _scenario, _DRAWN, sparse=("*",)),
        Example(
            "rendered scenario",
            _scenario,
            ("export {in}/scenario.yaml --out {out}",),
            sparse=("*",),
            heavy=True,
        ),
        Example("family", _family, _DRAWN, sparse=("*",)),
        Example(
            "slam settings",
            _settings,
            ("run {in} --config {in}/slam.yaml --out {out}",),
            sparse=("*",),
            fixed=("[!s]*", "segments.json"),
        ),
        Example(
            "summary as settings",
            _summary,
            ("run {in} --config {in}/summary.json --out {out}",),
            sparse=("*",),
            fixed=("[!s]*", "segments.json"),
        ),
        Example(
            "spec of an experiment",
            _spec,
            ("experiment run {in}/spec.yaml --out {in}/experiment",),
            sparse=("spec.yaml",),
            fixed=("experiment/*",),
        ),
        Example(
            "folder of an experiment",
            _experiment,
            (
                "experiment status {in} --json",
                "experiment export {in} --csv",
                "experiment run {in}/spec.yaml --out {in}",
                "experiment replay {in} none",
            ),
            ours=("ledger.sqlite", "driver.lock"),
            sparse=("spec.yaml",),
            mended=("spec.yaml", "driver.lock"),
        ),
        Example(
            "table of an experiment",
            _exported,
            ("experiment report {in}", "experiment status {in} --json"),
            ours=("*",),
            optional=("trajectories.npz", "infrastructure_errors.parquet"),
            heavy=True,
        ),
        Example("result folder", _result, ("view {in}",), free=("*",), heavy=True),
        Example(
            "cache",
            _cache,
            ("export {in}/scenario.yaml --out {out}",),
            ours=("cache/*",),
            fixed=("scenario.yaml",),
            mended=("cache/*",),
            environment={"DSLAB_CACHE_DIR": "{in}/cache"},
            heavy=True,
        ),
    )
}
EVERYTHING = Example("everything", _everything, ())
