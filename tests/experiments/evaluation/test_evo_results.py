"""Result files of evo, with evo itself as the oracle."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenarios.errors import InputError
from sim.io.truth import tum_poses_text

evo_ape = pytest.importorskip("evo.main_ape")
from evo.core import sync  # noqa: E402
from evo.core.metrics import PoseRelation  # noqa: E402
from evo.tools import file_interface  # noqa: E402

from experiments.evaluation.evo_result import STATISTICS, read_evo_result  # noqa: E402

CAMERA = "fx: 80\nfy: 80\ncx: 47.5\ncy: 31.5\nwidth: 96\nheight: 64\nfps: 20\n"
COUNT = 40


@pytest.fixture
def sequence(tmp_path) -> Path:
    """A sequence with truth, and beside it the result of a run: bent, scaled and turned, with a gap."""
    import cv2

    home, run = tmp_path / "seq", tmp_path / "mine"
    (home / "rgb").mkdir(parents=True)
    run.mkdir()
    cv2.imwrite(str(home / "rgb/0.png"), np.zeros((64, 96), np.uint8))
    stamps_s = 100 + np.arange(COUNT) / 20
    (home / "rgb.txt").write_text("".join(f"{stamp_s:.6f} rgb/0.png\n" for stamp_s in stamps_s))
    (home / "camera.yaml").write_text(CAMERA)
    rng = np.random.default_rng(1)
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, 3] = np.cumsum(rng.normal(0, 0.1, (COUNT, 3)), axis=0)
    (home / "groundtruth.txt").write_text(tum_poses_text(stamps_s, T))
    R = Rotation.random(rng=rng).as_matrix()
    T[:, :3, 3] = 0.3 * (T[:, :3, 3] + rng.normal(0, 0.02, (COUNT, 3))) @ R.T + [5, 6, 7]
    T[:, :3, :3] = R
    T[10:15] = np.nan
    (run / "trajectory.txt").write_text(tum_poses_text(stamps_s, T))
    return home


def of_evo(sequence: Path):
    """What evo_ape -as finds, and the file that it writes."""
    truth, estimate = (
        file_interface.read_tum_trajectory_file(str(path))
        for path in (sequence / "groundtruth.txt", sequence.parent / "mine/trajectory.txt")
    )
    truth, estimate = sync.associate_trajectories(truth, estimate)
    relation = PoseRelation.translation_part
    result = evo_ape.ape(truth, estimate, relation, align=True, correct_scale=True)
    path = sequence.parent / "theirs.zip"
    file_interface.save_res_file(str(path), result)
    return result, path


def test_a_file_of_evo_is_read(sequence):
    theirs, path = of_evo(sequence)
    read = read_evo_result(path)
    np.testing.assert_array_equal(read.errors, theirs.np_arrays["error_array"])
    assert read.stats == pytest.approx(theirs.stats) and set(STATISTICS) == set(theirs.stats)
    assert read.info["title"] == theirs.info["title"]


def test_ours_is_read_by_evo_and_has_its_figures(dslab, sequence):
    theirs, path = of_evo(sequence)
    folder = sequence.parent
    code, text, err = dslab("evo", folder / "mine", path, "--truth", sequence, "--out", folder / "zips")
    assert code == 0, err
    assert "mine" in text and "theirs" in text and "APE (m)" in text
    ours = file_interface.load_res_file(str(folder / "zips/mine.zip"))
    assert ours.stats == pytest.approx(theirs.stats, rel=1e-6)
    assert ours.info["title"] == theirs.info["title"] and ours.info["label"] == theirs.info["label"]
    for name, array in theirs.np_arrays.items():
        np.testing.assert_allclose(ours.np_arrays[name], array, atol=1e-6, err_msg=name)


def test_the_figures_as_json(dslab, sequence):
    theirs, path = of_evo(sequence)
    code, text, _ = dslab("evo", path, "--json")
    assert code == 0
    assert json.loads(text)["theirs"]["rmse"] == pytest.approx(theirs.stats["rmse"])


def test_bad_input_is_one_line(dslab, sequence, tmp_path):
    _, path = of_evo(sequence)

    def refused(*arguments: object) -> str:
        code, _, err = dslab("evo", *arguments)
        assert code == 2 and err.count("\n") == 1, err
        return err

    assert "--truth" in refused(tmp_path / "mine")
    assert "no such file" in refused(tmp_path / "none.zip")
    assert "called theirs" in refused(path, path)
    assert "no such file" in refused(tmp_path / "none", "--truth", sequence)
    (tmp_path / "bad.zip").write_bytes(b"PK no archive")
    assert "no readable zip" in refused(tmp_path / "bad.zip")


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("stats.json", None, "stats.json: is missing"),
        ("stats.json", b"[1", "stats.json: is no valid JSON"),
        ("stats.json", b'{"rmse": "low"}', "stats.json: rmse: 'low' is no finite number"),
        ("error_array.npy", None, "error_array.npy: is missing"),
        ("error_array.npy", b"text", "error_array.npy: is no readable array"),
    ],
)
def test_a_fault_of_a_file_names_the_part(sequence, name, content, says):
    _, path = of_evo(sequence)
    with zipfile.ZipFile(path) as archive:
        parts = {part: archive.read(part) for part in archive.namelist()}
    parts |= {name: content} if content is not None else {}
    with zipfile.ZipFile(path, "w") as archive:
        for part, data in parts.items():
            if part != name or content is not None:
                archive.writestr(part, data)
    with pytest.raises(InputError) as caught:
        read_evo_result(path)
    assert says in str(caught.value)
