"""Result files of evo, with evo itself as the oracle."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.sim.io.truth import tum_poses_text

evo_ape = pytest.importorskip("evo.main_ape")
from evo.core import sync  # noqa: E402
from evo.core.metrics import PoseRelation  # noqa: E402
from evo.tools import file_interface  # noqa: E402

from dslab.experiments.evaluation.evo_result import read_evo_result  # noqa: E402

COUNT = 40


@pytest.fixture
def run(tmp_path) -> Path:
    """A result folder: the truth bent, scaled and turned, with a gap."""
    home = tmp_path / "mine"
    home.mkdir()
    stamps_s = 100 + np.arange(COUNT) / 20
    rng = np.random.default_rng(1)
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, 3] = np.cumsum(rng.normal(0, 0.1, (COUNT, 3)), axis=0)
    (home / "groundtruth.txt").write_text(tum_poses_text(stamps_s, T))
    R = Rotation.random(rng=rng).as_matrix()
    T[:, :3, 3] = 0.3 * (T[:, :3, 3] + rng.normal(0, 0.02, (COUNT, 3))) @ R.T + [5, 6, 7]
    T[:, :3, :3] = R
    T[10:15] = np.nan
    (home / "trajectory.txt").write_text(tum_poses_text(stamps_s, T))
    figures = dict.fromkeys(("breakages", "path_share", "ate_m", "rpe_m", "cpu_ms_median", "audit"))
    about = {"sequence": "walk", "system": "dual", "frames": COUNT, "declares": "events"}
    summary = figures | about | {"stages": {}, "breakage_list": [], "segments": [], "config": {}}
    (home / "summary.json").write_text(json.dumps(summary))
    return home


def of_evo(run: Path):
    """What evo_ape -as finds, and the file that it writes."""
    truth, estimate = (
        file_interface.read_tum_trajectory_file(str(path))
        for path in (run / "groundtruth.txt", run / "trajectory.txt")
    )
    truth, estimate = sync.associate_trajectories(truth, estimate)
    relation = PoseRelation.translation_part
    result = evo_ape.ape(truth, estimate, relation, align=True, correct_scale=True)
    path = run.parent / "theirs.zip"
    file_interface.save_res_file(str(path), result)
    return result, path


def test_a_file_of_evo_is_read(run):
    theirs, path = of_evo(run)
    read = read_evo_result(path)
    np.testing.assert_array_equal(read.errors, theirs.np_arrays["error_array"])
    assert read.stats == pytest.approx(theirs.stats)
    assert read.info["title"] == theirs.info["title"]


def test_ours_is_read_by_evo_and_has_its_figures(dslab, run):
    theirs, path = of_evo(run)
    zips = run.parent / "zips"
    code, text, err = dslab("evo", run, path, "--out", zips)
    assert code == 0, err
    assert "mine" in text and "theirs" in text and "APE (m)" in text
    ours = file_interface.load_res_file(str(zips / "mine.zip"))
    assert ours.stats == pytest.approx(theirs.stats, rel=1e-6)
    assert ours.info["title"] == theirs.info["title"] and ours.info["label"] == theirs.info["label"]
    for name, array in theirs.np_arrays.items():
        np.testing.assert_allclose(ours.np_arrays[name], array, atol=1e-6, err_msg=name)


def test_the_figures_as_json(dslab, run):
    theirs, path = of_evo(run)
    code, text, _ = dslab("evo", path, "--json")
    assert code == 0
    assert json.loads(text)["theirs"]["rmse"] == pytest.approx(theirs.stats["rmse"])


def test_names_are_as_long_as_tells_them_apart(dslab, run):
    for place in ("a/dual", "b/dual"):
        shutil.copytree(run, run.parent / place)
    code, text, err = dslab("evo", run.parent / "a", run.parent / "b", "--json")
    assert code == 0, err
    assert list(json.loads(text)) == ["a-dual", "b-dual"]


def test_bad_input_is_one_line(dslab, run, tmp_path):
    _, path = of_evo(run)

    def refused(*arguments: object) -> str:
        code, _, err = dslab("evo", *arguments)
        assert code == 2 and err.count("\n") == 1, err
        return err

    assert "no such file" in refused(tmp_path / "none.zip")
    assert "given twice" in refused(path, path)
    assert "holds no summary.json" in refused(tmp_path / "none")
    assert "name a folder" in refused(path, "--out", tmp_path / "out")
    (tmp_path / "bad.zip").write_bytes(b"PK no archive")
    assert "no readable zip" in refused(tmp_path / "bad.zip")
    (run / "trajectory.txt").write_text("# stamp_s\n")
    assert "has no ATE: 0 poses" in refused(run)


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
def test_a_fault_of_a_file_names_the_part(run, name, content, says):
    _, path = of_evo(run)
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
