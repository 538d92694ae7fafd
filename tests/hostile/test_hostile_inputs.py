"""Whatever files, words, names and variables a command is given, it does its work or refuses with one line.

It ends soon, leaves nothing behind, and reads nothing else than was meant without a word.
"""

import re
from pathlib import Path

import pytest
from hostile_commands import ARGUMENTS, WORDS, commands, options_of
from hostile_examples import EVERYTHING, EXAMPLES
from hostile_mutations import mutations
from hostile_oracle import faults_of
from hypothesis import given
from hypothesis import strategies as st

from dslab import sim
from dslab.scenarios.segments import SEGMENT_KINDS

_NAMES = [word for word in WORDS if word.strip(".") and not {"/", "{"} & {*word} and len(word) < 256]
_RENDER, _DEGRADE = "export {in}/scenario/scenario.yaml --out {out}", "degrade {in}/tum --out {out}"
_READERS = [f"{path} {ARGUMENTS[path]}" for path in ("export", "run", "scenarios show", "experiment status")]
_GIVEN = st.sampled_from(sorted(commands()))
_EXAMPLES = [pytest.param(e.name, marks=pytest.mark.slow) if e.heavy else e.name for e in EXAMPLES.values()]


@pytest.mark.parametrize("name", _EXAMPLES)
def test_a_mutated_file_is_read_or_refused_with_one_line(name, lab, findings, hostile):
    example = EXAMPLES[name]

    @hostile(0.75 / len(EXAMPLES))
    @given(st.sampled_from(example.commands), mutations(example, lab.folder(example)))
    def mutate(command, mutation):
        outcome, faults = lab.judge(example, command, mutation)
        findings.add(name, mutation.kind, outcome, faults, f"{name}: {mutation!r}: dslab {command}")

    mutate()
    assert not findings.faults, findings.text()


@st.composite
def _option_words(draw):
    path = draw(_GIVEN)
    options = options_of(commands()[path])
    what = draw(st.sampled_from(("value", "value", "value", "alone", "argument", "unknown")))
    word = draw(st.sampled_from(WORDS))
    if what == "argument" or not options:
        return path, [word]
    option = "--hostile" if what == "unknown" else draw(st.sampled_from(options))
    return path, [option] if what == "alone" else [option, word]


def test_every_option_takes_any_word_or_refuses_it_with_one_line(lab, findings, hostile):
    @hostile(0.1)
    @given(_option_words())
    def call(words):
        path, more = words
        case = lab.run(EVERYTHING, f"{path} {ARGUMENTS.get(path, '')}", more=more)
        findings.add("options", path, case.outcome, case.faults, f"dslab {path} {more!r}")

    call()
    assert not findings.faults, findings.text()


@st.composite
def _segment_text(draw):
    kind = draw(st.sampled_from(sorted(SEGMENT_KINDS)))
    model = SEGMENT_KINDS[kind].model_fields
    fields = [name for name in model if name != "kind"]
    values = {name: draw(st.sampled_from(("0.5", "1", "8"))) for name in fields if model[name].is_required()}
    values |= {"start_s": "0.1", "duration_s": "0.2"}
    number = st.sampled_from(("0", "0.5", "1", "-1", "8", "1e9", "nan", "inf", "x", "", "true", "9" * 401))
    values |= draw(st.dictionaries(st.sampled_from(fields), number, max_size=2))
    parts = [f"{key}={value}" for key, value in values.items()]
    text = f"{kind}:{','.join(parts)}"
    junk = draw(
        st.sampled_from(("", "", "", "", "", "", ",", "=", ":", "\udcff", "[/]", "\n", "start_s=0", " "))
    )
    at = draw(st.integers(0, len(text)))
    return text[:at] + junk + text[at:]


def test_any_text_of_a_segment_is_applied_or_refused_with_one_line(lab, findings, hostile):
    @hostile(0.05)
    @given(_segment_text())
    def degrade(text):
        case = lab.run(EVERYTHING, _DEGRADE, more=["--segment", text])
        findings.add(
            "segments", text.split(":", maxsplit=1)[0], case.outcome, case.faults, f"--segment {text!r}"
        )

    degrade()
    assert not findings.faults, findings.text()


def test_any_name_of_input_and_output_works_or_is_refused_with_one_line(lab, findings, hostile):
    @hostile(0.05)
    @given(st.sampled_from(_READERS), st.sampled_from(_NAMES), st.sampled_from(_NAMES))
    def read(command, name, result):
        case = lab.run(EVERYTHING, command, given=name, result=result)
        findings.add(
            "names", command.split()[0], case.outcome, case.faults, f"{name!r}, {result!r}: dslab {command}"
        )

    read()
    assert not findings.faults, findings.text()


def _variables() -> list[str]:
    """The variables that the lab reads."""
    root = Path(sim.__file__).parent.parent
    sources = (
        path.read_text()
        for name in ("experiments", "scenarios", "sim", "slam")
        for path in (root / name).rglob("*.py")
    )
    return sorted({name for text in sources for name in re.findall(r"\bDSLAB_[A-Z_]+\b", text)})


@pytest.mark.slow
def test_any_value_of_a_variable_works_or_is_refused_with_one_line(lab, findings, hostile):
    others = (
        "TMPDIR",
        "XDG_CACHE_HOME",
        "PYTHONIOENCODING",
        "COLUMNS",
        "TERM",
        "NUMBA_CACHE_DIR",
        "NUMBA_NUM_THREADS",
    )
    encodings = st.sampled_from(("ascii", "latin-1", "utf-16"))
    names = st.sampled_from((*_variables(), *others))
    commands = (_RENDER, "scenarios list", *_READERS)

    @hostile(0.05)
    @given(st.sampled_from(commands), names, st.sampled_from(WORDS), encodings)
    def call(command, name, word, encoding):
        value = encoding if name == "PYTHONIOENCODING" else word
        case = lab.run(EVERYTHING, command, **{name: value})
        findings.add("variables", name, case.outcome, case.faults, f"{name}={value!r} dslab {command}")

    call()
    assert not findings.faults, findings.text()


@pytest.mark.slow
def test_any_limit_of_the_shell_lets_a_command_work_or_end_with_one_line(lab, findings, hostile):
    commands = (_RENDER, _DEGRADE + " --segment fog:start_s=0.1,duration_s=0.2", "scenarios list", *_READERS)
    limits = st.one_of(
        st.tuples(st.just("FSIZE"), st.integers(4096, 200_000)),
        st.tuples(st.just("NOFILE"), st.integers(3, 64)),
    )

    @hostile(0.03)
    @given(st.sampled_from(commands), limits)
    def call(command, limit):
        case = lab.run(EVERYTHING, command, limits=[limit])
        ended = case.ended
        said = ended.code == 1 and re.fullmatch("error: [^\n]+\n", ended.err)
        faults = [] if said else case.faults
        findings.add("limits", limit[0], case.outcome, faults, f"{limit}: dslab {command}")

    call()
    assert not findings.faults, findings.text()


def test_a_full_device_as_output_is_one_line(lab, findings):
    for command in ("scenarios list", "config show", "experiment schema", *_READERS):
        case = lab.run(EVERYTHING, command, stdout="/dev/full")
        ended = case.ended
        faults = [] if ended.code == 1 and re.fullmatch("error: [^\n]+\n", ended.err) else faults_of(ended)
        findings.add("full device", command, "exit code 1", faults, command)
    assert not findings.faults, findings.text()
