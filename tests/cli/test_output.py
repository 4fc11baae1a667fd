"""Text from files on a terminal."""

from scan3d_twin.cli import main
from scan3d_twin.cli.output import say


def test_text_from_a_file_does_not_steer_the_terminal(capfd):
    """An escape sequence could hide lines, or change the title and the clipboard."""
    say("a\x1b]0;title\x07b\x9b2Jc\ttab\nline")
    assert capfd.readouterr().err == "a\ufffd]0;title\ufffdb\ufffd2Jc\ttab\nline\n"
    assert main(["sim", "--scene", "x\x1b[2J"]) == 2
    assert "\x1b" not in capfd.readouterr().err
