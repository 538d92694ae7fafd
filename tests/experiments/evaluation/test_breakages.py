"""Breakages are assigned to their segment and their repair."""

import numpy as np
import pytest
from slam_fakes import make_sequence

from dslab.experiments.evaluation.breakages import breakage_outcomes, segment_of_frame
from dslab.slam.core import events as ev

SEQUENCE = make_sequence()
STAMPS = list(SEQUENCE.stamps_s)


def outcomes(*events):
    return breakage_outcomes(events, SEQUENCE.segments, STAMPS)


def at(frame: int) -> dict:
    return {"frame": frame, "stamp_s": frame / 30}


def broke(frame: int, map_id: int = 0) -> ev.Breakage:
    return ev.Breakage(**at(frame), map_id=map_id, reason="few_inliers", inliers=3)


def fused(
    frame: int, old: int = 0, accepted: bool = True, by: str = "recovery", new: int | None = None
) -> ev.Fusion:
    return ev.Fusion(
        **at(frame),
        map_id=old,
        old_map_id=old,
        new_map_id=old + 1 if new is None else new,
        by=by,
        accepted=accepted,
        scale=1.0,
        inliers=9,
        reason="why",
    )


@pytest.mark.parametrize(
    ("frame", "segment"), [(149, None), (150, 0), (180, 0), (195, 0), (196, None), (299, None)]
)
def test_a_frame_belongs_to_a_segment_until_half_a_second_after_it(frame, segment):
    assert segment_of_frame(frame, frame / 30, SEQUENCE.segments, STAMPS) == segment


def test_a_fusion_repairs_the_breakage_of_its_old_map():
    (one,) = outcomes(broke(160), fused(220))
    assert one.recovered and one.failure_reason == ""
    assert one.segment == 0


def test_a_map_merged_by_place_is_healed_but_not_recovered():
    (one,) = outcomes(broke(160), fused(280, by="place"))
    assert one.joined is not None and one.healed and not one.recovered and one.failure_reason == ""


def test_a_fusion_belongs_to_the_last_breakage_before_it():
    first, second = outcomes(broke(160), fused(220), broke(240), fused(280))
    assert first.fusion.frame == 220 and second.fusion.frame == 280
    assert first.until_frame == 240 and second.until_frame is None


def test_a_fusion_of_another_map_repairs_nothing():
    (one,) = outcomes(broke(160), fused(220, old=3))
    assert not one.recovered


def test_a_map_that_a_recovery_went_past_is_bridged():
    """If a map started in a blur breaks at once, the next recovery may reach the map before it."""
    first, second = outcomes(broke(160), broke(175, map_id=1), fused(220, new=2))
    assert first.recovered and first.bridged is None
    assert second.bridged.frame == 220 and not second.healed
    assert second.failure_reason == "a recovery went past it, to an older map"


@pytest.mark.parametrize("other", [{"accepted": False}, {"by": "place"}, {"old": 1}, {"new": 1}])
def test_nothing_else_bridges_a_map(other):
    assert outcomes(broke(175, map_id=1), fused(220, **({"new": 2} | other)))[0].bridged is None


def test_a_map_is_not_bridged_by_the_recovery_of_a_later_breakage():
    """The old map was relocalized in between and broke again, after the new one."""
    _, young, again = outcomes(broke(160), broke(175, map_id=1), found(200), broke(240), fused(280, new=2))
    assert young.bridged is None and again.recovered


def found(frame: int, map_id: int = 0) -> ev.Relocalized:
    return ev.Relocalized(
        **at(frame), map_id=map_id, keyframe=10, first_frame=frame, inliers=60, frames_lost=40, lost_s=1.3
    )


def test_a_relocalization_heals_the_breakage_of_its_map_and_is_no_recovery():
    (one,) = outcomes(broke(160), found(200))
    assert one.healed and not one.recovered and one.failure_reason == ""
    assert one.relocalized.frame == 200
    (other,) = outcomes(broke(160), found(200, map_id=1))
    assert not other.healed and other.relocalized is None


def test_a_relocalization_belongs_to_the_last_breakage_before_it():
    first, second = outcomes(broke(160), found(200), broke(220))
    assert first.healed and first.until_frame == 220
    assert not second.healed and second.failure_reason == "no_reinit"


def test_relocalizations_that_were_refused_are_told_where_none_was_confirmed():
    def refused(frame, reason="too_little_evidence", map_id=0):
        tried = {"keyframe": 9, "first_frame": frame, "frames": 1}
        return ev.RelocalizationWithdrawn(**at(frame), map_id=map_id, reason=reason, **tried)

    def reason(*events):
        return outcomes(broke(160), *events)[0].failure_reason

    assert reason(refused(170), refused(180, map_id=1)) == (
        "no_reinit; 1 relocalization refused: too_little_evidence"
    )
    many = (refused(170), refused(180), refused(190, "few_inliers"))
    assert reason(*many) == "no_reinit; 3 relocalizations refused: mostly too_little_evidence"
    assert reason(*many, found(200)) == ""


def test_a_refused_fusion_is_a_failure_with_its_reason():
    done = ev.ReinitDone(**at(200), map_id=1, frames_taken=40)
    (one,) = outcomes(broke(160), done, fused(220, accepted=False))
    assert not one.recovered
    assert one.failure_reason == "fusion: why"


def test_the_reason_of_a_dropped_map_is_reported():
    dropped = ev.MapDropped(**at(160), map_id=0, reason="too_few_keyframes", keyframes=3)
    (one,) = outcomes(broke(160), dropped)
    assert one.failure_reason == "map dropped: too_few_keyframes"


def test_a_breakage_without_a_new_map_is_no_reinit():
    (one,) = outcomes(broke(160))
    assert one.failure_reason == "no_reinit"
    done = ev.ReinitDone(**at(200), map_id=1, frames_taken=40)
    (one,) = outcomes(broke(160), done)
    assert one.reinit_frame == 200 and one.failure_reason == "no recovery was run"


def test_the_grace_time_belongs_to_the_later_segment():
    later = make_sequence(segment=(185, 190)).segments[0]
    assert segment_of_frame(187, 187 / 30, [*SEQUENCE.segments, later], np.arange(300) / 30) == 1


def test_a_breakage_belongs_to_all_overlapping_segments_and_is_named_after_the_last():
    fog, blur, early = (
        make_sequence(segment=span).segments[0] for span in ((100, 200), (150, 170), (20, 90))
    )
    segments, stamps = [early, fog, blur], np.arange(300) / 30
    found = {}
    for frame in (95, 103, 120, 160, 180, 190, 210):
        (one,) = breakage_outcomes([broke(frame)], segments, stamps)
        found[frame] = one.segment, one.segments
    assert found[120] == (1, (1,))
    assert found[160] == (2, (1, 2))
    # The blur has ended within the time that declaring takes.
    assert found[180] == (2, (1, 2)) and found[190] == (1, (1,)) and found[210] == (1, (1,))
    # A segment that ended before is not included.
    assert found[95] == (0, (0,)) and found[103] == (1, (1,))


def test_segments_that_start_at_one_frame_both_have_the_breakage():
    twins = [make_sequence(segment=span).segments[0] for span in ((150, 170), (150, 160))]
    (one,) = breakage_outcomes([broke(155)], twins, np.arange(300) / 30)
    assert (one.segment, one.segments) == (0, (0, 1))
