"""Invariants of a map and their check."""

import numpy as np

from dslab.slam.map.map import Map

ROTATION_TOLERANCE = 1e-6


class InvariantError(AssertionError):
    """A violated invariant, named by the message."""


def require(holds: object, text: str) -> None:
    """Raise an InvariantError unless ``holds`` is true."""
    if not holds:
        raise InvariantError(text)


def require_rigid(T: np.ndarray, of: str) -> None:
    """Raise an InvariantError unless all transforms (n, 4, 4) are finite and rigid."""
    require(np.isfinite(T).all(), f"{of} is not finite")
    R = T[:, :3, :3]
    apart = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
    require(apart < ROTATION_TOLERANCE and (np.linalg.det(R) > 0).all(), f"{of} is no rotation")
    require((T[:, 3] == (0, 0, 0, 1)).all(), f"{of} has another last row than 0 0 0 1")


def check_map(m: Map) -> None:
    """Check the invariants of one map.

    Raises:
        InvariantError: the first violated one.
    """
    _check_keyframes(m)
    _check_points(m)
    _check_observations(m)
    _check_covisibility(m)
    _check_tree(m)


def _check_keyframes(m: Map) -> None:
    a, K = m.arrays, m.n_keyframes
    require(len(m._features) == len(m._parent) == K, "keyframes without features or place in the tree")
    require_rigid(a.kf_T_cam_map[:K], "a keyframe pose")
    require(a.kf_bad[K:].all(), "a keyframe beyond the last")
    lengths = np.diff(a.kf_start[: K + 1])
    live = m.keyframes()
    require((lengths >= 0).all(), "a keypoint slice ends before it begins")
    same = (lengths[live] == [len(m._features[k]) for k in live]).all()
    require(same, "keypoint slices and features disagree")
    require(
        not any(len(m._features[k]) for k in np.flatnonzero(a.kf_bad[:K])), "a culled keyframe has features"
    )
    owners = np.repeat(np.arange(K), lengths)
    require((a.kp_keyframe[: len(owners)] == owners).all(), "a keypoint of another keyframe's slice")
    for k in live:
        features = m._features[k]
        same = (a.kp_descriptor[m.keypoints(k)] == features.descriptors).all()
        require(same and (a.kf_cells[k] == features.cell_start).all(), "a keyframe's features have changed")
    for i, j in m.loop_edges:
        require(0 <= i < K and 0 <= j < K and i != j, "a loop edge of a keyframe that does not exist")


def _check_points(m: Map) -> None:
    a, K, P = m.arrays, m.n_keyframes, m.n_points
    good = np.flatnonzero(~a.pt_bad[:P])
    require(a.pt_bad[P:].all(), "a map point beyond the last")
    require(np.isfinite(a.pt_xyz[good]).all(), "a map point is not finite")
    require(np.isfinite(a.pt_normal[good]).all(), "a viewing direction is not finite")
    distance = a.pt_max_distance[good]
    require((np.isfinite(distance) & (distance > 0)).all(), "a point's largest distance is no length")
    for name in ("pt_reference", "pt_first_keyframe"):
        values = getattr(a, name)[good]
        require(((values >= 0) & (values < K)).all(), f"{name} of a keyframe that does not exist")
    replaced = a.pt_replaced[:P]
    require((replaced[good] < 0).all(), "a replaced point is not dropped")
    heirs = np.flatnonzero(replaced >= 0)
    require((replaced < P).all(), "a point replaced by one that does not exist")
    at, steps = replaced[heirs], 0
    while len(at):
        steps += 1
        require(steps <= len(heirs), "points replace one another in a circle")
        at = replaced[at]
        at = at[at >= 0]


def _check_observations(m: Map) -> None:
    """Check that associations, counts and observer lists agree."""
    a, P = m.arrays, m.n_points
    N = int(a.kf_start[m.n_keyframes])
    owned, good = a.kp_point[:N], ~a.pt_bad[:P]
    require((owned < P).all(), "an observation of a point that does not exist")
    taken = np.flatnonzero(owned >= 0)
    require(good[owned[taken]].all(), "an observation of a dropped point")
    counts = np.bincount(owned[taken], minlength=P)
    require((counts == np.where(good, a.pt_observations[:P], 0)).all(), "observation counts disagree")
    require((counts[good] > 0).all(), "a point that no keyframe observes")
    require(not a.kf_bad[a.kp_keyframe[taken]].any(), "a culled keyframe observes")
    pairs = a.kp_keyframe[taken].astype(np.int64) * P + owned[taken]
    require(len(np.unique(pairs)) == len(pairs), "a keyframe observes a point twice")
    references = a.pt_reference[:P].astype(np.int64) * P + np.arange(P)
    require(np.isin(references[good], pairs).all(), "a point's reference keyframe does not observe it")
    at, of = a.pt_head[:P][good], np.flatnonzero(good)
    length = np.zeros(P, np.int64)
    for _ in range(int(counts.max(initial=0)) + 1):
        at, of = at[at >= 0], of[at >= 0]
        require((at < N).all() and (owned[at] == of).all(), "an observer list runs into another point")
        length[of] += 1
        at = a.kp_next[at]
    require((length == counts).all(), "an observer list is incomplete")


def _check_covisibility(m: Map) -> None:
    a, K = m.arrays, m.n_keyframes
    N = int(a.kf_start[K])
    taken = np.flatnonzero(a.kp_point[:N] >= 0)
    # A float32 product is fast, and exact since no two keyframes share 2^24 points.
    observes = np.zeros((K, m.n_points), np.float32)
    observes[a.kp_keyframe[taken], a.kp_point[taken]] = 1
    shared = observes @ observes.T
    np.fill_diagonal(shared, 0)
    require((shared == a.covisibility[:K, :K]).all(), "covisibility disagrees with the observations")


def _check_tree(m: Map) -> None:
    """Check that every keyframe leads to a root, and live ones over live ones only."""
    bad, parent = m.arrays.kf_bad, m._parent
    culled = set(np.flatnonzero(bad[: m.n_keyframes]).tolist())
    require(set(m._T_cam_parent) == culled, "culled keyframes and poses kept for them disagree")
    require_rigid(np.array(list(m._T_cam_parent.values())).reshape(-1, 4, 4), "a culled keyframe's pose")
    for k in range(m.n_keyframes):
        q = parent[k]
        require(-1 <= q < m.n_keyframes, "a parent that does not exist")
        require(q >= 0 or not bad[k], "a root keyframe is culled")
        require(q < 0 or bad[k] or not bad[q], "a keyframe has a culled parent")
        steps = 0
        while q >= 0:
            q, steps = parent[q], steps + 1
            require(steps <= m.n_keyframes, "the spanning tree has a cycle")
