"""Results in the form of evo's zip files: what ``evo_ape --save_results`` writes and ``evo_res`` reads.

    info.json         title, label, ref_name, est_name
    stats.json        rmse, mean, median, std, min, max, sse
    error_array.npy   error of each pose; more arrays may lie beside it, .npz of older versions too

Source: the documentation of evo, github.com/MichaelGrupp/evo.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs, ate, rms
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import open_file

_INFO, _STATS, _ERRORS = "info.json", "stats.json", "error_array"
_TITLE = "APE w.r.t. translation part (m)\n(with Sim(3) Umeyama alignment)"
_MOST_TEXT_BYTES, _MOST_ARRAY_BYTES = 10**6, 256 * 10**6
_REMEDY = "give a file that evo_ape or evo_rpe wrote with --save_results"


@dataclass(frozen=True)
class EvoResult:
    """Errors of one estimate, and their figures.

    Attributes:
        info: words about it; ``est_name``, ``ref_name``, ``title`` and ``label`` of evo's own.
        stats: figures of the errors, in their unit.
        errors: (n,) float64 error of each pose.
        arrays: more arrays by name, such as ``timestamps`` (n,).
    """

    info: dict[str, Any]
    stats: dict[str, float]
    errors: np.ndarray
    arrays: dict[str, np.ndarray] = field(default_factory=dict)


def ate_result(
    pairs: PosePairs, stamps_s: np.ndarray, name: str, reference: str = "ground truth"
) -> EvoResult | Undefined:
    """ATE after Sim(3) alignment, as ``evo_ape tum -as`` finds it.

    Args:
        pairs: estimate and truth of the same frames.
        stamps_s: (n,) float64 their times.
        name: of the estimate.
        reference: name of the truth.

    Returns:
        The result; Undefined as :func:`experiments.evaluation.metrics.ate`.
    """
    found = ate(pairs)
    if isinstance(found, Undefined):
        return found
    errors = found.errors_m
    similarity = np.eye(4)
    similarity[:3, :3] = found.alignment.scale * found.alignment.R_world_map
    similarity[:3, 3] = found.alignment.t_world_map
    aligned = found.alignment.points(pairs.T_map_cam[:, :3, 3])
    return EvoResult(
        info={"title": _TITLE, "label": "APE (m)", "ref_name": reference, "est_name": name},
        stats=statistics(errors),
        errors=errors,
        arrays={
            "seconds_from_start": stamps_s - stamps_s[0],
            "timestamps": stamps_s,
            "distances_from_start": _distances_m(pairs.T_world_cam[:, :3, 3]),
            "distances": _distances_m(aligned),
            "alignment_transformation_sim3": similarity,
        },
    )


def statistics(errors: np.ndarray) -> dict[str, float]:
    """The figures of ``stats.json`` of (n,) errors, n at least 1; ``sse`` is their sum of squares."""
    whole = {name: getattr(np, name)(errors) for name in ("mean", "median", "std", "min", "max")}
    return {"rmse": rms(errors), **{k: float(v) for k, v in whole.items()}, "sse": float((errors**2).sum())}


def write_evo_result(path: Path, result: EvoResult) -> None:
    """Write the zip file."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(_INFO, json.dumps(result.info))
        archive.writestr(_STATS, json.dumps(result.stats))
        for name, array in {_ERRORS: result.errors, **result.arrays}.items():
            data = io.BytesIO()
            np.save(data, array)
            archive.writestr(f"{name}.npy", data.getvalue())


def read_evo_result(path: Path) -> EvoResult:
    """Read the zip file; figures that it lacks are taken from its errors.

    Raises:
        InputError: it cannot be read, or is no such file.
    """
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            info, stats = (_json(path, archive, name) for name in (_INFO, _STATS))
            errors = _errors(path, archive)
    except (OSError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error):
        raise InputError(str(path), "is no readable zip archive", "copy it again") from None
    known = {**statistics(errors), **{name: _number(path, name, value) for name, value in stats.items()}}
    return EvoResult(info, known, errors)


def _member(path: Path, archive: zipfile.ZipFile, names: Iterable[str], most_bytes: int) -> tuple[str, bytes]:
    """The first of some names that the archive has: where it stands, and its content."""
    found = [name for name in names if name in archive.namelist()]
    where = f"{path}: {(found or list(names))[0]}"
    if not found:
        raise InputError(where, "is missing", _REMEDY)
    if archive.getinfo(found[0]).file_size > most_bytes:
        raise InputError(where, "is too long", _REMEDY)
    return where, archive.read(found[0])


def _json(path: Path, archive: zipfile.ZipFile, name: str) -> dict[str, Any]:
    where, data = _member(path, archive, (name,), _MOST_TEXT_BYTES)
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise InputError(where, "is no valid JSON", _REMEDY) from None
    if not isinstance(content, dict):
        raise InputError(where, "holds no object", _REMEDY)
    return content


def _number(path: Path, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        where = f"{path}: {_STATS}: {name}"
        raise InputError(where, f"{value!r} is no finite number", "write the file again")
    return float(value)


def _errors(path: Path, archive: zipfile.ZipFile) -> np.ndarray:
    """(n,) float64 errors, n at least 1."""
    where, data = _member(path, archive, (f"{_ERRORS}.npy", f"{_ERRORS}.npz"), _MOST_ARRAY_BYTES)
    try:
        errors = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, SyntaxError):
        raise InputError(where, "is no readable array", _REMEDY) from None
    if not isinstance(errors, np.ndarray) or errors.ndim != 1 or errors.dtype.kind not in "fiu":
        raise InputError(where, "is no list of errors", _REMEDY)
    if not len(errors) or not np.isfinite(errors).all():
        raise InputError(where, "holds no finite errors", "write the file again")
    return errors.astype(float)


def _distances_m(positions: np.ndarray) -> np.ndarray:
    """(n,) length of the path up to each of (n, 3) positions."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
