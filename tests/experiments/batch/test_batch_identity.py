"""A sequence of a batch is its content, whatever name or place it has."""

import json
import os
import re
from pathlib import Path

import batch_fakes
import pytest
from pool_fakes import open_local_pool
from slam_fakes import make_sequence

from dslab.experiments.batch import run as batch_run
from dslab.experiments.batch.run import run_batch
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.evaluation.hypotheses import HYPOTHESES_FILE
from dslab.experiments.runs.identity import sequence_digest
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import load_family
from dslab.sim.io.tum import write_tum

EXAMPLE = f"{Path(__file__).parents[3] / 'examples' / 'own_slam.py'}:ConstantVelocity"
FRAMES = 60


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    monkeypatch.setattr(batch_run, "open_pool", open_local_pool)


@pytest.fixture
def folder(tmp_path):
    write_tum(make_sequence(FRAMES, segment=None), tmp_path / "drive")
    return tmp_path / "drive"


def spec_of(systems=("base",)):
    return BatchSpec(sequences=("drive",), systems=systems, runs=1)


def summaries(batch):
    return {path: path.read_text() for path in batch.rglob("summary.json")}


def test_a_sequence_that_sorts_before_one_of_the_same_name_leaves_its_results(tmp_path):
    for name, frames in (("hard", FRAMES), ("easy", FRAMES - 10)):
        write_tum(make_sequence(frames, segment=None), tmp_path / name / "P000")
    easy, hard = (str(tmp_path / name / "P000") for name in ("easy", "hard"))
    spec = spec_of(systems=(EXAMPLE,))
    run_batch(spec, [hard], tmp_path / "b")
    before = summaries(tmp_path / "b")
    rows = run_batch(spec, [easy, hard], tmp_path / "b")
    after = summaries(tmp_path / "b")
    assert rows.frames.tolist() == [FRAMES - 10, FRAMES] and rows.folder.nunique() == len(after) == 2
    assert len(before) == 1 and before.items() <= after.items()


@pytest.mark.parametrize("changed", ["rgb/000009.png", "groundtruth.txt", "camera.yaml", "own.yaml"])
def test_a_sequence_is_run_again_when_its_content_has_changed(folder, tmp_path, monkeypatch, changed):
    """An image, the truth, the camera or a scenario; another spelling or a new date changes nothing."""
    monkeypatch.setattr(batch_run, "_render", lambda *_: None)
    (tmp_path / "own.yaml").write_text(load_family("clean-room").as_yaml())
    source = tmp_path / "own.yaml" if changed == "own.yaml" else folder
    path = source if source.is_file() else folder / changed

    def made(named):
        rows = run_batch(spec_of(), [named], tmp_path / "b", task=batch_fakes.leaving_a_note)
        assert rows.source.tolist() == [named]
        return len((tmp_path / "made").read_text().splitlines())

    assert made(str(source)) == 1
    os.utime(path, (1, 1))
    assert made(f"{tmp_path}/../{tmp_path.name}/{source.name}") == 1
    content = path.read_bytes()
    other = (folder / "rgb" / "000030.png").read_bytes()
    path.write_bytes(other if path.suffix == ".png" else re.sub(rb"\d(?=\D*$)", b"1", content))
    assert made(str(source)) == 2 and len(list((tmp_path / "b" / "runs").rglob("note"))) == 1


def test_an_image_counts_with_spaces_in_its_name(folder):
    (folder / "rgb" / "000009.png").rename(folder / "rgb" / "of the door.png")
    listed = (folder / "rgb.txt").read_text().replace("000009.png", "of the door.png")
    (folder / "rgb.txt").write_text(listed)
    before = sequence_digest(str(folder))
    (folder / "rgb" / "of the door.png").write_bytes((folder / "rgb" / "000030.png").read_bytes())
    assert sequence_digest(str(folder)) != before


def test_runs_that_begin_at_other_frames_have_one_input(folder, tmp_path):
    spec = BatchSpec(sequences=("drive",), systems=(EXAMPLE,), runs=2, vary="start", skip_frames=7)
    rows = run_batch(spec, [str(folder)], tmp_path / "b")
    inputs = [
        json.loads((tmp_path / "b" / place / "summary.json").read_text())["input"] for place in rows.folder
    ]
    assert rows.frames.tolist() == [FRAMES, FRAMES - 7] and inputs[0] == inputs[1]


def test_one_folder_or_class_by_two_spellings_is_refused(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = EXAMPLE.replace("examples/", "./examples/")
    for spec, sources, says in (
        (spec_of(), ["drive", str(folder)], f"sequences: {folder} is the same as drive; name each once"),
        (spec_of(systems=(EXAMPLE, other)), ["drive"], "name each once"),
    ):
        with pytest.raises(InputError, match=re.escape(says)):
            run_batch(spec, sources, tmp_path / "b", task=batch_fakes.made_up)
    assert not (tmp_path / "b").exists()


def test_hypotheses_are_logged_if_they_are_asked_for(folder, tmp_path):
    asked = BatchSpec(sequences=("drive",), systems=("base",), runs=1, hypotheses=True)
    run_batch(asked, [str(folder)], tmp_path / "b")
    (place,) = (tmp_path / "b" / "runs").glob("*/base/000")
    assert (place / HYPOTHESES_FILE).exists() and asked.row_key != spec_of().row_key
