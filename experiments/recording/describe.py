"""Text and colour of events."""

from dslab.experiments.recording import palette
from dslab.experiments.recording.palette import Color
from dslab.slam.core.events import CANCELLED, Event

_TEXTS = {
    "initialized": "map {map_id} initialized with {points} points ({model})",
    "breakage": "breakage: map {map_id} lost, {reason}",
    "rescue_start": "features do not track ({reason}): frames are placed by intensities",
    "rescue_end": "features track again, after {frames} frames placed by intensities",
    "rescue_failed": "intensities place no more frames, after {frames}",
    "poses_withdrawn": "{frames} poses in map {map_id} withdrawn, from frame {first_frame} on: {reason}",
    "relocalized": "relocalized in map {map_id}, {lost_s:.2f} s after the breakage",
    "relocalization_withdrawn": "relocalization in map {map_id} withdrawn after {frames} frames: {reason}",
    "loop_refused": "loop in map {map_id} refused, {matches} matches: {reason}",
    "loop_closed": "loop closed in map {map_id}, scale corrected by {scale:.3f}",
    "map_adjusted": "map {map_id} adjusted as a whole: {keyframes} keyframes, {points} points",
    "camera_refined": "lens and shutter refined: keypoints moved by {shift_px:.1f} px rms",
    "map_dropped": "map {map_id} dropped: {reason}",
    "map_saved": "map {map_id} saved: {keyframes} keyframes, {points} points",
    "map_cut": "map {map_id} cut on request",
    "reinit_start": "initialization of map {map_id} begins",
    "reinit_done": "map {map_id} is in use after {frames_taken} frames",
    "recovery_start": "recovery thread {thread} ({method}) begins, back over {buffered_frames} frames",
    "recovery_end": "recovery thread {thread} ({method}) is back in map {old_map_id}",
    "recovery_failed": "recovery thread {thread} ({method}) failed, {stage}: {reason}",
    "recovery_cancelled": "recovery thread {thread} ({method}) cancelled: {reason}",
    "fusion": "map {new_map_id} fused into map {old_map_id} by {by}, at scale {scale:.3f}",
    "fusion_refused": "fusion of map {new_map_id} with map {old_map_id} refused: {reason}",
}


_COLORS = {
    palette.LOST: ("breakage",),
    palette.RECOVERY: ("recovery_start", "rescue_start"),
    palette.FUSED: ("fusion", "relocalized", "rescue_end"),
    palette.REFUSED: (
        "poses_withdrawn", "map_dropped", "relocalization_withdrawn", "loop_refused", "rescue_failed",
        "recovery_failed", "fusion_refused",
    ),
}  # fmt: skip


def describe_event(event: Event) -> tuple[str, Color]:
    """Describe an event in one short sentence, without its time; returns its colour too."""
    fields = event.record()
    kind = event.kind
    if fields.get("success") is False:
        kind = kind.replace("_end", "_cancelled" if fields.get("stage") == CANCELLED else "_failed")
    elif fields.get("accepted") is False:
        kind = "fusion_refused"
    words = {name: v.replace("_", " ") if isinstance(v, str) else v for name, v in fields.items()}
    color = next((color for color, kinds in _COLORS.items() if kind in kinds), palette.PLAIN)
    return _TEXTS.get(kind, kind.replace("_", " ")).format(**words), color
