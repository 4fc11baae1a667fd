import pytest

from scan3d_twin.core.errors import FileError
from scan3d_twin.run.folder import claim_folder, find_free_folder, release_folder, write_file


def test_a_claimed_folder_exists_and_is_empty(tmp_path):
    folder = claim_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_an_empty_folder_may_be_claimed_again(tmp_path):
    assert claim_folder(claim_folder(tmp_path / "a")) == tmp_path / "a"


def test_a_folder_with_something_in_it_is_refused_and_left_alone(tmp_path):
    (tmp_path / "precious").write_text("x")
    with pytest.raises(FileError, match="is not empty"):
        claim_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


def test_a_folder_below_a_file_cannot_be_claimed(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match=r"cannot write to .*Not a directory"):
        claim_folder(tmp_path / "file" / "run")


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "sub" / "x.json"
    write_file(path, "long text that is there before")
    write_file(path, b"new")
    assert path.read_bytes() == b"new"
    assert [each.name for each in path.parent.iterdir()] == ["x.json"]


def test_writing_below_a_file_is_a_file_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write"):
        write_file(tmp_path / "file" / "x", "y")


def test_a_free_folder_does_not_exist_yet(tmp_path):
    assert find_free_folder(tmp_path / "r") == tmp_path / "r"
    (tmp_path / "r").mkdir()
    (tmp_path / "r-2").mkdir()
    assert find_free_folder(tmp_path / "r") == tmp_path / "r-3"


def test_only_an_empty_folder_is_released(tmp_path):
    for name in ("empty", "full"):
        (tmp_path / name).mkdir()
    (tmp_path / "full" / "x").write_text("x")
    release_folder(tmp_path / "empty")
    release_folder(tmp_path / "full")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]
