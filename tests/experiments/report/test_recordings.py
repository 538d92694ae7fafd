"""The file of paths of an experiment's folder: whole, or one line that says so."""

import numpy as np
import pytest

from dslab.experiments.report.recordings import PATHS_FILE, add_paths, read_paths
from dslab.scenarios.errors import InputError


@pytest.mark.parametrize("content", [b"", b"PK", {"u.truth": np.zeros(3)}, {"u.truth": np.array(["x"])}])
def test_a_malformed_file_of_paths_is_an_input_error(tmp_path, content):
    file = tmp_path / PATHS_FILE
    assert read_paths(tmp_path) == {}
    add_paths(tmp_path, "u", {"truth": np.ones((2, 3), np.float32)})
    assert read_paths(tmp_path)["u"]["truth"].all()
    file.write_bytes(content) if isinstance(content, bytes) else np.savez(file, **content)
    for use in (read_paths, lambda folder: add_paths(folder, "v", {})):
        with pytest.raises(InputError, match=PATHS_FILE):
            use(tmp_path)
