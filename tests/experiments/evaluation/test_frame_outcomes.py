"""Which frames a recovery has posed."""

from dataclasses import replace

import numpy as np
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes
from dslab.experiments.runs.execution import execute


def with_posed(record, first, last):
    """The record with final poses of these frames, which were not tracked live."""
    main = record.trajectories[-1]
    frames = np.arange(first, last + 1)
    more = replace(
        main,
        frames=np.concatenate([main.frames, frames]),
        stamps_s=np.concatenate([main.stamps_s, frames / 30]),
        T_map_cam=np.concatenate([main.T_map_cam, np.tile(np.eye(4), (len(frames), 1, 1))]),
    )
    return replace(record, trajectories=(*record.trajectories[:-1], more))


def test_without_a_fusion_no_frame_counts_as_recovered():
    """Re-initialization poses the frames between its two views, too."""
    sequence = make_sequence()
    for recovers, outcome in ((True, FrameOutcome.RECOVERED), (False, FrameOutcome.TRACKED)):
        build = fake_factory(sequence, breaks_at=160, recovers=recovers)
        record = with_posed(execute(sequence, "dual", 0, build=build), 176, 179)
        assert set(frame_outcomes(record)[176:180]) == {outcome}
