"""The message about an unknown name: what was probably meant, and what there is."""

import pytest

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.planning import make_planner
from scan3d_twin.sim.scenes.load import load_scene


@pytest.mark.parametrize(
    ("find", "name", "near"),
    [
        (load_scene, "tree_boxes", "three_boxes"),
        (load_scene, "plain-wall", "plain_wall"),
        (make_planner, "siccp", "siicp"),
        (preset_options, "papier", "paper"),
    ],
)
def test_a_misspelt_name_suggests_the_right_one_and_lists_all(find, name, near):
    with pytest.raises(UnknownNameError) as caught:
        find(name)
    words = str(caught.value)
    assert f"{name!r}; did you mean {near}? Known: " in words
    assert near in words.partition("Known: ")[2].split(", ")


def test_a_name_like_no_other_only_lists_the_known_ones():
    assert str(UnknownNameError("world", "mars", ["typical", "harsh", "ideal"])) == (
        "no world 'mars'; known: harsh, ideal, typical"
    )
