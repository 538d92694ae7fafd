"""The spec of variants: systems with settings of their own, run on the same frames."""

from typing import Any, Literal

from pydantic import Field, ValidationInfo, model_validator

from dslab.experiments.claims.spec import MEASURED, ClaimSpec
from dslab.experiments.claims.variants.deviations import ANY_CAMERA, deviation_variants
from dslab.experiments.claims.variants.quantities import QUANTITIES
from dslab.experiments.runs.slam_settings import SlamSettings, parse_slam_settings
from dslab.experiments.runs.systems.registry import OwnSystem, Registry
from dslab.scenarios.errors import InputError
from dslab.scenarios.strict import Strict


class Variant(Strict):
    """A system with settings over its own."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9+._-]*$", max_length=40)
    system: str = Field("base", min_length=1, description="a name of `dslab systems list`")
    settings: dict[str, Any] = Field(
        default_factory=dict, description="of the system, as in a settings file of `dslab run`"
    )
    against: str | None = Field(None, description="name of the variant that it is compared with")
    at: float | None = Field(None, description="its place on the axis of lines, such as seconds of buffer")

    @property
    def written(self) -> SlamSettings:
        """Its settings, checked."""
        return parse_slam_settings(self.settings, (), lambda at: self._field("settings", *map(str, at)))

    def _field(self, *at: str) -> str:
        return f"variant {self.name}: {'.'.join(at)}"

    @model_validator(mode="after")
    def _check_settings(self, info: ValidationInfo) -> "Variant":
        if info.context == MEASURED:  # by code that may have had other systems and settings
            return self
        try:
            system = Registry.open().find(self.system)
        except InputError as fault:
            raise InputError(self._field("system"), fault.problem, fault.remedy) from None
        if self.settings and not isinstance(system, OwnSystem):
            raise InputError(self._field("settings"), f"{self.system} takes none", "leave them out")
        if "mode" in self.settings:
            problem = "variants run in lockstep, that runs repeat"
            raise InputError(self._field("settings", "mode"), problem, "leave it out")
        if isinstance(system, OwnSystem):
            try:
                self.written.of(self.system, ANY_CAMERA)
            except InputError as fault:
                at = (
                    fault.where
                    if fault.where.startswith("variant ")
                    else self._field("settings", fault.where)
                )
                raise InputError(at, fault.problem, fault.remedy) from None
        return self


class VariantsSpec(ClaimSpec):
    """Systems with other settings on the same frames of every world."""

    kind: Literal["variants"]  # pyright: ignore[reportIncompatibleVariableOverride]
    variants: tuple[Variant, ...] = Field(min_length=1, max_length=200)
    measures: tuple[str, ...] = Field(
        ("failed", "broke", "path_share", "log_ate"),
        min_length=1,
        description="what variants are compared by, and what is drawn",
    )
    plot: Literal["forest", "lines", "histogram", "dots"] = "forest"
    axis: str = Field("", description="of lines: what `at` of the variants means, with its unit")
    most_variants: int = Field(12, ge=1, description="of one unit; more are cut into several")

    @model_validator(mode="before")
    @classmethod
    def _write_out(cls, data: Any) -> Any:
        """``deviations: undone`` or ``made`` stands for the variants of the table of deviations."""
        if not isinstance(data, dict) or "deviations" not in data:
            return data
        side = data["deviations"]
        if side not in ("undone", "made"):
            raise ValueError(f"deviations is {side!r}, give undone or made")
        rest = {name: value for name, value in data.items() if name != "deviations"}
        return rest | {"variants": [*rest.get("variants", ()), *deviation_variants(side)]}

    @model_validator(mode="after")
    def _check_variants(self) -> "VariantsSpec":
        names = [variant.name for variant in self.variants]
        for place, variant in enumerate(self.variants):
            if variant.name in names[:place]:
                raise ValueError(f"two variants are named {variant.name}, name each differently")
            if variant.against is not None and (
                variant.against not in names or variant.against == variant.name
            ):
                raise ValueError(
                    f"variant {variant.name}: there is no other one {variant.against!r}, correct it"
                )
            if self.plot == "lines" and variant.at is None:
                raise ValueError(f"variant {variant.name} has no place on the axis, give at")
        for measure in self.measures:
            if measure not in QUANTITIES:
                raise ValueError(f"measures: there is no {measure}, use {' or '.join(QUANTITIES)}")
        if self.lead_in_s <= 0 and self.degradations:
            raise ValueError("without a lead-in no map can break, give lead_in_s")
        return self

    def variant(self, name: str) -> Variant:
        """The variant of a name."""
        return next(variant for variant in self.variants if variant.name == name)

    @property
    def contrasts(self) -> tuple[tuple[str, str], ...]:
        """Names of the variants that are compared, with those that they are compared with."""
        return tuple((v.name, v.against) for v in self.variants if v.against is not None)
