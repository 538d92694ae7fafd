"""Specs of claims' experiments from presets, files and folders."""

from pathlib import Path

from pydantic import ValidationError

from dslab.experiments.campaign.folder import SPEC_FILE
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.spec import MEASURED, ClaimSpec
from dslab.experiments.eq1.spec import distribution_faults, mixtures
from dslab.scenarios.errors import InputError, collect
from dslab.scenarios.families import in_order_of_lines
from dslab.scenarios.faults import all_faults, guess
from dslab.scenarios.input_files import is_folder, is_given
from dslab.scenarios.yaml_file import YamlFile, read_yaml

PRESET_DIR = Path(__file__).parent / "presets"


def claim_presets() -> list[str]:
    """Names of the experiments on claims in the package."""
    return sorted(path.stem for path in PRESET_DIR.glob("*.yaml"))


def is_claim(name_or_path: str | Path) -> bool:
    """True of a preset, spec file or folder whose spec names a kind, as no spec of Eq. 1 does."""
    if str(name_or_path) in claim_presets():
        return True
    path = Path(name_or_path)
    path = path / SPEC_FILE if is_folder(path) else path
    if path.suffix not in (".yaml", ".yml") or not is_given(path):
        return False
    return "kind" in _read(path).data


def load_claim(name_or_path: str | Path) -> ClaimSpec:
    """Load a spec by the name of a preset, or from a YAML file or the folder of an experiment.

    The first world of every condition is drawn, so that an invalid scenario is found before the run; not for
    a folder, whose rows can be read where the code at hand refuses its conditions or settings.

    Raises:
        InputError: it does not exist, or is no valid YAML or spec.
    """
    path = Path(name_or_path)
    if str(name_or_path) in claim_presets():
        path = PRESET_DIR / f"{name_or_path}.yaml"
    if is_folder(path):
        file = _read(path / SPEC_FILE)
        return _validated(file, MEASURED)
    file = _read(path)
    spec = _validated(file)
    faults = list(mixtures(spec, file))
    for condition in spec.cells:
        try:
            spec.draw(condition, 0, 0, file.where)
        except InputError as error:
            faults += error.faults
    collect(in_order_of_lines(path, faults), None)
    return spec


def _read(path: Path) -> YamlFile:
    return read_yaml(path, "experiment", f"a copy of a preset in {PRESET_DIR}")


def _validated(file: YamlFile, context: str | None = None) -> ClaimSpec:
    name = file.data.get("kind")
    if name not in KINDS:
        remedy = f"use {guess(str(name), [*KINDS])}one of {', '.join(KINDS)}"
        raise InputError(file.where(("kind",)), f"unknown kind {name!r}", remedy)
    model = KINDS[name].spec
    try:
        spec = model.model_validate(file.data, context=context)
    except ValidationError as error:
        raise all_faults(error, file.where, root=model) from None
    collect(distribution_faults(file), None)
    return spec
