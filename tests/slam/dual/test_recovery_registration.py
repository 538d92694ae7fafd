"""Recovery threads of one's own."""

import pytest

from dslab import slam
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS, build_thread, parse_threads

CAMERA = slam.PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5, 30.0)


class StrictOrb(slam.OrbRecovery):
    name = "strict_orb"


def test_a_registered_thread_is_built_by_name(monkeypatch):
    with pytest.raises(ValueError, match="unknown recovery thread 'strict_orb'"):
        parse_threads("strict_orb")
    monkeypatch.setattr("dslab.slam.dual.recovery.registry.RECOVERY_KINDS", RECOVERY_KINDS.copy())
    slam.register_recovery_thread("strict_orb", StrictOrb)
    (spec,) = parse_threads("strict_orb")
    assert isinstance(build_thread(spec), StrictOrb)
    slam.DualSlam(CAMERA, dual=slam.DualConfig(recovery_threads=(spec,)))


@pytest.mark.parametrize(
    ("kind", "said"), [("orb", "already"), ("Orb", "small letters"), ("my orb", "small")]
)
def test_a_name_that_is_taken_or_no_name_is_refused(kind, said):
    with pytest.raises(ValueError, match=said):
        slam.register_recovery_thread(kind, StrictOrb)
