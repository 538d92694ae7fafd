"""The source of a commit of this lab, and the versions that it locks."""

import subprocess
import tarfile
import tomllib
from pathlib import Path

from dslab.experiments.runs.provenance import checkout
from dslab.scenarios.errors import InputError, MachineError

_TIME_S = 1800.0


def release_source(commit: str, repository: str | None, folder: Path) -> list[str]:
    """Unpack the source of a commit, and say in words of pip what to install.

    Args:
        commit: its hash, or the start of it.
        repository: folder or address; None for the checkout that the running lab lies in.
        folder: existing folder for the source.

    Raises:
        InputError: there is no repository, or it has no such commit.
        MachineError: git is not there, or fails.
    """
    found = _repository(repository, folder)
    git = ["git", "-C", str(found)]
    run_step([*git, "rev-parse", "--git-dir"], "install git, or name a clone of this lab by --repository")
    try:
        run_step([*git, "cat-file", "-e", f"{commit}^{{commit}}"])
    except MachineError:
        remedy = "run `git fetch --unshallow` there, or name a whole clone by --repository"
        raise InputError(str(found), f"has no commit {commit}", remedy) from None
    packed, source = folder / "source.tar", folder / "source"
    run_step([*git, "archive", "--format=tar", f"--output={packed}", commit])
    with tarfile.open(packed) as tar:
        tar.extractall(source, filter="data")
    (folder / "locked.txt").write_text("\n".join(_locked(source / "uv.lock")) + "\n", encoding="utf-8")
    return ["--constraint", str(folder / "locked.txt"), str(source)]


def run_step(words: list[str], remedy: str = "") -> None:
    """Run a step. Raises MachineError with the last line that it prints if it fails."""
    where = " ".join(words[:3])
    remedy = remedy or "check the network and the version of Python, and run the same command again"
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, timeout=_TIME_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MachineError(where, f"cannot be run ({error})", remedy) from None
    if done.returncode != 0:
        lines = (done.stderr + done.stdout).decode(errors="replace").strip().splitlines()
        last = lines[-1].strip() if lines else "no message"
        raise MachineError(where, f"ended with exit code {done.returncode}: {last}", remedy)


def _repository(named: str | None, folder: Path) -> Path:
    """Folder of the repository; that of an address is cloned."""
    if named is None:
        found = checkout()
        if found is None:
            remedy = "name a clone of it, or its address, by --repository"
            raise InputError("dslab systems install", "this lab runs from no clone of its repository", remedy)
        return found
    if Path(named).is_dir():
        return Path(named)
    run_step(["git", "clone", "--quiet", "--bare", "--", named, str(folder / "clone")])
    return folder / "clone"


def _locked(lock: Path) -> list[str]:
    """Every version in a file of uv as a line of pip, for the versions of Python that it is for."""
    packages = tomllib.loads(lock.read_text(encoding="utf-8"))["package"] if lock.exists() else []
    lines = []
    for package in (p for p in packages if "registry" in p["source"]):
        marker = " or ".join(f"({part})" for part in package.get("resolution-markers", ()))
        lines.append(f"{package['name']}=={package['version']}" + (f" ; {marker}" if marker else ""))
    return lines
