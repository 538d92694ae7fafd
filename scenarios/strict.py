"""The base of every part of a spec."""

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """Base of every part of a spec: frozen, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
