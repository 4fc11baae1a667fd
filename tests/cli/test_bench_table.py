"""The table of an experiment folds to the width of a terminal, and loses nothing."""

import pytest

from scan3d_twin.cli.bench_table import fold_table

NAMES = ["scene", "variant", "runs", "success", "views", "worst error [mm]", "above ε"]


def table(variants, scenes=("three_boxes",)):
    rows = [
        [scene, name, "30 (1 failed, 2 lost)", f"100% [{k}%, 100%]", "5.0 [5.0, 5.0]",
         "3.9 [3.6, 4.1]", f"0.{k}% [0.0%, 0.7%]"]
        for scene in scenes
        for k, name in enumerate(variants)
    ]  # fmt: skip
    return [NAMES, *rows]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_line_is_wider_than_the_terminal(width):
    cells = table(["best", "paper-with-a-name-that-is-much-too-long-for-any-terminal" * 3])
    lines = fold_table(cells, width)
    assert max(map(len, lines)) <= width
    for row in cells:
        for cell in row[2:]:
            assert any(cell in line for line in lines)


def test_a_wide_terminal_has_one_block_a_scene():
    lines = fold_table(table(["best", "paper"], ("three_boxes", "sine_box")), 200)
    assert [line.split()[0] if line else "" for line in lines] == [
        "three_boxes", "variant", "best", "paper", "",
        "sine_box", "variant", "best", "paper",
    ]  # fmt: skip


def test_each_block_repeats_the_variants():
    lines = fold_table(table(["best", "paper"]), 60)
    blocks = [line for line in lines if line.startswith("variant")]
    assert len(blocks) > 1
    assert sum(line.startswith("best ") for line in lines) == len(blocks)
