"""The model's parameters as ``dslab belief fit`` has found them; where by stands in the file."""

import json
from functools import cache
from importlib.resources import files

from dslab.slam.belief.model import Parameters


@cache
def fitted() -> Parameters:
    """Those that the lab ships."""
    text = files("dslab.slam.belief").joinpath("data/fitted.json").read_text()
    return Parameters(
        **{k: tuple(v) if isinstance(v, list) else v for k, v in json.loads(text)["parameters"].items()}
    )
