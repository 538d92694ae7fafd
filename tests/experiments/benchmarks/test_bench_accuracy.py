"""Accuracy beside a peer's over many sequences: on common frames, kept, resumed."""

import json

import numpy as np
import pandas as pd
import pytest
from slam_fakes import FakeSystem, make_sequence
from system_programs import program
from typer.testing import CliRunner

from dslab.experiments.benchmarks import accuracy
from dslab.experiments.cli.commands import app
from dslab.scenarios.errors import InputError
from dslab.sim.io.tum import write_tum

FRAMES = 60
# Places nothing of the first 20 frames, and the others with noise.
PEER = """
import random
noise = random.Random(0)
near = [(s, min(poses, key=lambda p: abs(float(p[0]) - float(s)))) for s in stamps[20:]]
rows = [[s, *(str(0.5 * float(x) + noise.gauss(0, 0.02)) for x in p[1:4]), *p[4:]] for s, p in near]
"""


@pytest.fixture
def sequence():
    return make_sequence(FRAMES, segment=None)


@pytest.fixture
def folder(sequence, tmp_path):
    write_tum(sequence, tmp_path / "sequence")
    return str(tmp_path / "sequence")


def test_errors_are_of_the_frames_that_both_have_placed_and_starts_differ(sequence, folder, tmp_path):
    """The fake drifts off over the first frames; the peer has placed none of them."""

    class OffAtFirst(FakeSystem):
        def trajectories(self):
            (path,) = super().trajectories()
            path.T_map_cam[path.frames < 20, 0, 3] += 5.0
            return [path]

    def build(kind, camera, seed):
        built.append(seed)
        return OffAtFirst(sequence.T_world_cam[(seed - 1) * 10 :], noise_m=0.01)

    built, table = [], tmp_path / "rows"
    given = ([folder], [1, 2], "base", table, program(tmp_path / "peer", sequence, PEER), 2, 10)
    rows = accuracy.measure_accuracy(*given, build=build)
    assert list(rows.system) == ["ours", "peer", "peer"] * 2 and built == [1, 2]
    assert list(rows.frames) == [60] * 3 + [50] * 3
    peer = rows[rows.system == "peer"]
    assert list(peer.common_poses) == [40, 40, 30, 30] and rows.cpu_s[0] > 0 and (peer.cpu_s > 0).all()
    assert rows[rows.system == "ours"].ate_m.min() > 1
    assert peer.ours_common_ate_m.to_numpy() == pytest.approx(np.full(4, np.sqrt(3) * 0.01), rel=0.3)
    assert peer.common_ate_m.to_numpy() == pytest.approx(np.full(4, np.sqrt(3) * 0.04), rel=0.3)
    (found,) = accuracy.sums(rows).to_dict("records")
    assert found["sequences"] == 2 and found["ratio"] == pytest.approx(0.25, rel=0.4)
    assert found["ours_posed"] > found["peer_posed"] == pytest.approx((40 / 60 + 30 / 50) / 2)
    pd.testing.assert_frame_equal(rows, accuracy.measure_accuracy(*given, build=build))
    assert built == [1, 2], "nothing is run again"


def test_a_start_behind_the_end_and_a_source_without_truth_are_one_line(folder, tmp_path):
    given = ["bench", "accuracy", folder, "--seeds", "9", "--out", str(tmp_path / "t")]
    result = CliRunner().invoke(app, given)
    assert isinstance(result.exception, InputError) and "leaves out 160 of 60 frames" in str(result.exception)
    write_tum(make_sequence(FRAMES, truth=False, segment=None), tmp_path / "blind")
    with pytest.raises(InputError, match="no ground truth"):
        accuracy.measure_accuracy([str(tmp_path / "blind")], [1], "base", tmp_path / "t")
    assert not (tmp_path / "t" / "rows.parquet").exists()


def test_the_command_prints_medians_over_sequences(tmp_path, monkeypatch):
    ours = {"source": "a", "system": "ours", "run": 0, "frames": 10, "posed": 9, "cpu_ms_median": 4.0}
    rows = [
        {**ours, "seed": s, "ate_m": 0.2, "first_over_last": f} for s, f in ((1, 0.9), (2, 1.2), (3, 1.3))
    ]
    monkeypatch.setattr(accuracy, "measure_accuracy", lambda *_: pd.DataFrame(rows))
    given = ["bench", "accuracy", "a", "--out", str(tmp_path / "t")]
    (printed,) = json.loads(CliRunner().invoke(app, [*given, "--json"]).stdout)
    assert printed["ours_scale_off"] == pytest.approx(0.2) and printed["ratio"] is None
    assert "0.900" in CliRunner().invoke(app, given).stdout
