import pytest

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.run import toml
from scan3d_twin.run.settings import build_settings
from scan3d_twin.run.toml import parse_toml, read_toml


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a" + ".a" * 100 + " = 1", "a key of over 64 dots"),
        ("[a" + ".a" * 100 + "]", "a key of over 64 dots"),
        ("x = {y = 1, a" + ".a" * 100 + " = 1}", "a key of over 64 dots"),
        ("a = " + "[" * 2000, "nested too deeply"),
        ("a = " + "9" * 5000, "is not valid TOML: Exceeds the limit"),
        ("a = ", "is not valid TOML: "),
    ],
)
def test_what_cannot_be_options_is_refused_in_one_line(text, words):
    with pytest.raises(FileError, match=words) as told:
        parse_toml(text, "my.toml")
    assert len(str(told.value).splitlines()) == 1
    assert str(told.value).startswith("my.toml")


def test_long_lists_and_texts_are_no_keys():
    text = f"x = [{', '.join(['0.5'] * 300)}]\nname = '''{'a sentence. ' * 40}'''\n"
    assert len(parse_toml(text, "my.toml")["x"]) == 300


def test_the_size_is_limited(tmp_path, monkeypatch):
    path = tmp_path / "my.toml"
    path.write_text("seed = 1\n" * 1)
    assert read_toml(path) == {"seed": 1}
    monkeypatch.setattr(toml, "MAX_SIZE", 4)
    with pytest.raises(FileError, match=r"my\.toml holds more than .* MB of TOML; if you trust it"):
        read_toml(path)


@pytest.mark.parametrize("value", [10**400, -(10**400), 2**63], ids=["huge", "-huge", "2**63"])
def test_numbers_beyond_all_reason_are_wrong_values(value):
    for options in ({"planning": {"epsilon": value}}, {"run": {"seed": value}}):
        with pytest.raises(ConfigError):
            build_settings([options])
