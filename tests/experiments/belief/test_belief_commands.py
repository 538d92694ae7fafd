"""``dslab belief``: logs in, parameters, a table and a plot out; what is wrong is one line."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from belief_scenes import seen

from dslab.experiments.belief.fit import fit
from dslab.experiments.belief.logs import read_logs
from dslab.experiments.evaluation.hypotheses import HYPOTHESES_FILE, write_hypotheses
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.result_folder import SUMMARY_FILE
from dslab.scenarios.errors import InputError
from dslab.slam.belief.log import LoggedView
from dslab.slam.belief.model import Sight, Unseen
from dslab.slam.core.relation import PlacedFrames, Relation


def nothing():
    """What is shown where nothing was looked at."""
    return Sight(*np.empty((len(Sight._fields) - 1, 0)), np.zeros(3))


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """A folder of a batch whose camera goes straight: half of the hypotheses are 5 m off."""
    folder, rng = tmp_path_factory.mktemp("batch"), np.random.default_rng(0)
    n = 60
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = 0.1 * np.arange(n)
    around = PlacedFrames(np.arange(0, 40, 4), np.arange(0, 40, 4) / 10, T[0:40:4])
    views = []
    for i in range(40):
        false = i % 2 == 1
        for frame in (50, 51):
            own = T[frame].copy()
            own[2, 3] += 5.0 * false
            supposed = Relation(
                around, PlacedFrames(np.array([frame]), np.array([frame / 10]), own[None]), 2.0
            )
            views.append(
                LoggedView(
                    "join", (0, 45 + i, 0), supposed, seen(rng, float(not false)), "x" * false, Unseen(3.0)
                )
            )
    views.append(replace(views[-1], sight=nothing(), torn=0.25))
    run = folder / "runs" / "drive-1" / "dual" / "000"
    run.mkdir(parents=True)
    write_hypotheses(run, views, Truth(np.arange(n) / 10, T))
    return folder


def test_what_is_fitted_is_judged_and_drawn(dslab, batch, tmp_path):
    fitted, plot = tmp_path / "fitted.json", tmp_path / "plot.png"
    code, said, _ = dslab("belief", "fit", batch, "--out", fitted)
    assert code == 0 and "20 right and 20 false" in said
    kept = json.loads(fitted.read_text())
    assert kept["fitted_to"]["false"] == 20 and len(kept["parameters"]["alike"]) == 2
    code, said, _ = dslab("belief", "judge", batch, "--fitted", fitted, "--plot", plot)
    assert code == 0 and "log loss" in said and plot.stat().st_size > 5000


def test_collected_logs_are_read_as_their_batch_is(dslab, batch, tmp_path):
    file = tmp_path / "logs.parquet"
    code, said, _ = dslab("belief", "collect", batch, "--out", file, "--views", "1", "--right-joins", "5")
    assert code == 0 and "25 hypotheses with 26 rows" in said
    own = {one.run: 0 for one in read_logs([file])}
    assert list(own) == [f"{batch.name}/runs/drive-1/dual/000"]
    whole, thin = read_logs([batch]), read_logs([file])
    assert sum(one.false for one in thin) == sum(one.false for one in whole) == 20
    assert np.allclose(thin[0].sights[0].shown, whole[0].sights[0].shown, rtol=0.06, atol=1e-3)
    for logs in (whole, thin):  # what was torn is no view
        assert [one.torn for one in logs if np.isfinite(one.torn)] == [0.25] and len(logs[-1].sights) < 3
    other = tmp_path / "other.parquet"
    other.write_text("no table")
    code, _, error = dslab("belief", "collect", other, "--out", file)
    assert code == 2 and "no table of hypotheses" in error


def test_what_a_loop_tears_of_a_map_that_is_wrong_already_is_left_out(batch, tmp_path):
    run = tmp_path / "runs" / "drive-1" / "dual" / "000"
    shutil.copytree(next(batch.glob("runs/*/*/*")), run)
    for frame, left in ((60, [0.25]), (40, [])):
        declared = {
            "loops": [],
            "joins": [{"frame": frame, "false": True}],
            "fusions": [],
            "relocalizations": [],
        }
        (run / SUMMARY_FILE).write_text(json.dumps({"audit": declared}))
        assert [one.torn for one in read_logs([tmp_path]) if np.isfinite(one.torn)] == left


@pytest.mark.parametrize(
    ("text", "says"),
    [(None, "cannot be read"), ("{", "invalid JSON"), ('{"fitted_to": {}}', "parameters: field required")],
)
def test_a_file_that_is_none_is_one_line(dslab, batch, tmp_path, text, says):
    file = tmp_path / "fitted.json"
    if text is not None:
        file.write_text(text)
    code, _, error = dslab("belief", "judge", batch, "--fitted", file)
    assert code == 2 and says in error and len(error.splitlines()) == 1


def test_only_the_runs_that_are_asked_for_are_read(dslab, batch, tmp_path):
    out = ("--out", tmp_path / "f.json")
    code, said, _ = dslab("belief", "fit", batch, "--runs", "0", "3", *out)
    assert code == 0 and "20 right and 20 false" in said
    code, _, error = dslab("belief", "fit", batch, "--runs", "1", "3", *out)
    assert code == 2 and "give other --runs" in error and len(error.splitlines()) == 1


def test_a_log_of_an_older_release_is_one_line(dslab, batch, tmp_path):
    run = tmp_path / "runs" / "drive-1" / "dual" / "000"
    run.mkdir(parents=True)
    log = next(batch.glob(f"runs/*/*/*/{HYPOTHESES_FILE}"))
    pd.read_parquet(log).drop(columns="centre").to_parquet(run / HYPOTHESES_FILE)
    code, _, error = dslab("belief", "fit", tmp_path, "--out", tmp_path / "f.json")
    assert code == 2 and "has no centre" in error and len(error.splitlines()) == 1


def test_a_batch_without_logs_is_one_line(dslab, tmp_path):
    code, _, error = dslab("belief", "fit", tmp_path, "--out", tmp_path / "f.json")
    assert code == 2 and HYPOTHESES_FILE in error and "hypotheses: true" in error


def test_logs_without_a_hypothesis_are_one_line(dslab, tmp_path):
    run = tmp_path / "runs" / "drive-1" / "dual" / "000"
    run.mkdir(parents=True)
    write_hypotheses(run, [], Truth(np.arange(2.0), np.tile(np.eye(4), (2, 1, 1))))
    code, _, error = dslab("belief", "fit", tmp_path, "--out", tmp_path / "f.json")
    assert code == 2 and "no hypothesis" in error and len(error.splitlines()) == 1


def test_right_hypotheses_alone_cannot_be_fitted(batch):
    right = [one for one in read_logs([batch]) if not one.false]
    with pytest.raises(InputError, match="no wrong hypothesis"):
        fit(right)
