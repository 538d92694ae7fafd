"""Whatever a file holds, a command reads it or refuses it with one line, soon, and leaves nothing behind."""

import pytest
from hostile_examples import EXAMPLES
from hostile_mutations import mutations
from hypothesis import given
from hypothesis import strategies as st

_NAMES = [pytest.param(e.name, marks=pytest.mark.slow) if e.heavy else e.name for e in EXAMPLES.values()]


@pytest.mark.parametrize("name", _NAMES)
def test_a_mutated_file_is_read_or_refused_with_one_line(name, lab, findings, hostile):
    example = EXAMPLES[name]

    @hostile(0.75 / len(EXAMPLES))
    @given(st.sampled_from(example.commands), mutations(example, lab.folder(example)))
    def mutate(command, mutation):
        outcome, faults = lab.judge(example, command, mutation)
        findings.add(name, mutation.kind, outcome, faults, f"{name}: {mutation!r}: dslab {command}")

    mutate()
    assert not findings.faults, findings.text()
