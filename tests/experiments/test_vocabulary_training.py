"""Training of the vocabulary is deterministic, on frames of this project, with provenance."""

import pytest

from dslab.experiments import vocabulary
from dslab.experiments.cli.vocabulary import train_command
from dslab.experiments.vocabulary import FIRST_SEED, train, training_scenarios
from dslab.scenarios.errors import InputError
from dslab.scenarios.spec import Scenario
from dslab.slam.places.recognition import Vocabulary


def little_room() -> Scenario:
    camera = {"width_px": 160, "height_px": 120, "fx_px": 120, "fy_px": 120, "cx_px": 79.5, "cy_px": 59.5}
    world = {"kind": "room", "length_m": 5, "width_m": 5}
    return Scenario(name="little-room", duration_s=4, world=world, camera={**camera, "fps": 1})


@pytest.fixture(scope="module")
def trained():
    return train([little_room()], seeds_each=2, branching=4, levels=2)


@pytest.mark.slow
def test_training_is_deterministic(trained, tmp_path):
    again = train([little_room()], seeds_each=2, branching=4, levels=2)
    for name, made in (("a", trained), ("b", again)):
        made.save(tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_vocabulary_has_its_provenance(trained):
    facts = trained.provenance
    assert facts["frames"] == 8 and facts["seeds"] == [FIRST_SEED, FIRST_SEED + 1]
    assert facts["descriptors"] > 8 * 50
    assert Scenario(**facts["scenarios"][0]) == little_room()
    assert trained.n_words == 16


def test_the_training_set_has_every_world_and_no_two_frames_alike():
    scenarios = training_scenarios()
    kinds = {s.world.kind for s in scenarios}
    assert {"room", "corridor", "city", "motorway", "field", "warehouse"} <= kinds
    assert len({s.name for s in scenarios}) == len(scenarios)
    assert all(s.camera.fps == 1 and s.frame_count >= 30 for s in scenarios)


@pytest.mark.slow
def test_the_command_writes_it(monkeypatch, tmp_path):
    monkeypatch.setattr(vocabulary, "training_scenarios", lambda: [little_room()])
    train_command(tmp_path / "words.npz")
    facts = Vocabulary.load(tmp_path / "words.npz").provenance
    assert facts["frames"] == 4 * vocabulary.SEEDS_EACH and facts["branching"] == vocabulary.BRANCHING


def test_a_bad_path_of_a_vocabulary_is_bad_input(tmp_path):
    for place in (tmp_path / "absent" / "words.npz", tmp_path / "words.txt"):
        with pytest.raises(InputError):
            train_command(place)
